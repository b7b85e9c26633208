"""Tables and a picture of what `benchmarks.harbour_fit` found.

>>> from benchmarks import harbour_tables
>>> one = {"evidence": -2.0, "idf1": 0.8, "switches": 3, "gospa": 400.0}
>>> told = {"by hand": {"first half": one | {"missed": 7.0, "false": 2.5}}}
>>> print(harbour_tables.scores_table(told).splitlines()[-1])
| first half | by hand | -2.0 | 0.800 | 3 | 400 | 7.0 | 2.5 |
"""

from typing import Any

import numpy as np


def lists(arrays: dict[str, Any]) -> dict[str, Any]:
    """Returns arrays as lists, for JSON."""
    return {name: np.asarray(value).tolist() for name, value in arrays.items()}


def scores_table(scores: dict[str, dict[str, dict[str, float]]]) -> str:
    """Returns the table of scores in Markdown, by settings and where they are held."""
    columns = {
        "evidence a scan": ("evidence", ".1f"),
        "IDF1": ("idf1", ".3f"),
        "switches": ("switches", "d"),
        "GOSPA, m": ("gospa", ".0f"),
        "missed": ("missed", ".1f"),
        "false": ("false", ".1f"),
    }
    lines = [
        f"| in | settings | {' | '.join(columns)} |",
        "|---" * (len(columns) + 2) + "|",
    ]
    for place in dict.fromkeys(place for each in scores.values() for place in each):
        for name, each in scores.items():
            if place in each:
                cells = [f"{each[place][key]:{form}}" for key, form in columns.values()]
                lines.append(f"| {place} | {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def numbers_table(case: Any, found: dict[str, Any]) -> str:
    """Returns the table of what was found in Markdown.

    Args:
        case: A `harbour_fit.Case`.
        found: From `harbour_fit.fit`, by what it is called.
    """
    from jaxtrack.recorded import fitted

    modes = case.settings.modes
    resting = {"drift_std": [key for key, mode in modes.items() if mode.rest]}
    hand = lists(fitted.numbers(case.settings)._asdict())
    lines = [
        f"| | by hand | {' | '.join(found)} |",
        "|---" * (len(found) + 2) + "|",
    ]
    for key, value in hand.items():
        columns = [hand, *(one["numbers"] for one in found.values())]
        names = resting.get(key, list(modes)) if np.ndim(value) else [""]
        cells = [np.atleast_1d(one[key]) for one in columns]
        for i, name in enumerate(names):
            told = " | ".join(f"{float(one[i]):.3g}" for one in cells)
            lines.append(f"| `{key}` {name} | {told} |")
    return "\n".join(lines) + "\n"


def picture(case: Any, found: dict[str, Any], path: Any) -> None:
    """Draws the way of each fit: evidence, and every number against that by hand."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator, NullFormatter

    from jaxtrack import plot
    from jaxtrack.recorded import fitted

    hand = lists(fitted.numbers(case.settings)._asdict())
    looks = dict(zip(case.settings.modes, ("-", "--", ":"), strict=False))
    with matplotlib.rc_context(plot.STYLE):
        figure = Figure(figsize=(12, 5.4), layout="constrained")
        axes = list(figure.subplots(2, 5).flat)
        shown = []
        for (name, one), color in zip(found.items(), plot.COLORS, strict=False):
            shown.append(Line2D([], [], color=color, label=name))
            axes[0].plot(one["evidence"], color=color)
            for axis, (key, value) in zip(axes[1:], hand.items(), strict=True):
                way = np.array(one["history"][key]).reshape(len(one["evidence"]), -1)
                ratio = way / np.ravel(value)
                for each, look in zip(ratio.T, looks.values(), strict=False):
                    axis.plot(each, look, color=color)
        axes[0].set(title="evidence a scan", xlabel="step")
        for axis, key in zip(axes[1:], hand, strict=True):
            axis.set(title=key, xlabel="step", yscale="log")
            axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.yaxis.set_major_formatter("{x:g}")
            axis.yaxis.set_minor_formatter(NullFormatter())
        for name, look in looks.items():
            shown.append(Line2D([], [], color=plot.INK, ls=look, label=name))
        figure.suptitle("The way of each fit; numbers as multiples of those by hand")
        figure.legend(handles=shown, loc="outside lower center", ncols=len(shown))
        figure.savefig(path, dpi=110)
