"""The command `jaxtrack follow`: errors of trackers that are told their targets.

>>> from jaxtrack.cli import follow
>>> table = follow.as_table("nobody, 0 runs", {})
>>> [column.header for column in table.columns][:2]
['tracker', 'RMS (m)']
"""

import json
import pathlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from jaxtrack.cli import common
from jaxtrack.cli.compare import parse_settings

if TYPE_CHECKING:
    from jaxtrack.study.follow import Followed


def follow(
    scenario: Annotated[str, typer.Argument(help="One that tells its targets.")],
    trackers: Annotated[
        str | None, typer.Option(help="Names, with commas between; else all.")
    ] = None,
    runs: Annotated[
        int, typer.Option(parser=common.whole, metavar="R", help="Simulated runs.")
    ] = 100,
    seed: Annotated[
        int, typer.Option(parser=common.whole, metavar="S", help="Of the random data.")
    ] = 0,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE; may be repeated.")
    ] = None,
    out: Annotated[pathlib.Path, typer.Option(help="Where the results go.")] = (
        pathlib.Path("out")
    ),
) -> None:
    """Follow known targets through many runs, for their own tracks' errors.

    Runs in which targets are taken for each other in the end count in the association
    and are left out of the errors. Writes follow.json, errors.png and association.png.
    """
    common.need("matplotlib")
    common.start_jax(64)
    import numpy as np

    from jaxtrack import scenarios
    from jaxtrack.study import chart
    from jaxtrack.study.follow import follow as follow_runs

    with common.bad_input(ValueError):
        given = {
            name: values[0] for name, values in parse_settings(settings or []).items()
        }
        made = scenarios.make(scenario, **given)
        names = common.names(trackers) if trackers is not None else list(made.trackers)
        check(made, names, runs)
    common.writable(out)
    followed = {name: follow_runs(made, name, runs, seed) for name in names}
    told_apart = {name: without_swapped(one) for name, one in followed.items()}
    time = np.asarray(made.world.truth.time)
    chart.errors_chart(told_apart, time).savefig(out / "errors.png")
    chart.association_chart(followed, time).savefig(out / "association.png")
    summary = {
        name: {**summarise(told_apart[name]), "swapped": share_swapped(one)}
        for name, one in followed.items()
    }
    (out / "follow.json").write_text(json.dumps(summary, indent=2) + "\n")
    Console(width=100).print(as_table(f"{scenario}, {runs} runs", summary))
    typer.echo(f"Wrote follow.json, errors.png, association.png in {out}.")


def check(scenario: Any, names: Sequence[str], runs: int) -> None:
    """Raises a ValueError for what cannot be followed."""
    if runs < 1:
        raise ValueError(f"runs is {runs}; give at least 1")
    for name in names:
        if name not in scenario.trackers:
            known = ", ".join(scenario.trackers)
            raise ValueError(f"{scenario.name} has no tracker {name!r}; it has {known}")
        params = scenario.trackers[name][1]
        if getattr(params, "start", None) is None:
            raise ValueError(
                f"{name} in {scenario.name} is not told its targets; use `jaxtrack "
                "compare`, or gomes-crossing or manoeuvre-digraph"
            )
    if float(scenario.world.clutter.rate) > 0:
        raise ValueError(
            f"{scenario.name} has false detections, among which nobody knows whose is "
            "whose; use `jaxtrack compare`"
        )


def without_swapped(followed: "Followed") -> "Followed":
    """Returns the errors of the runs in which no targets are taken for each other."""
    import numpy as np

    from jaxtrack.study.follow import swapped

    told_apart = ~np.asarray(swapped(followed))[:, None, None]
    tracked = np.asarray(followed.errors.tracked) & told_apart
    return followed._replace(errors=followed.errors._replace(tracked=tracked))


def share_swapped(followed: "Followed") -> float:
    """Returns in which share of the runs targets are taken for each other."""
    import numpy as np

    from jaxtrack.study.follow import swapped

    return float(np.asarray(swapped(followed)).mean())


def summarise(followed: "Followed") -> dict[str, float]:
    """Returns what follow.json says of a tracker's errors."""
    import numpy as np

    from jaxtrack.metrics import errors

    found = followed.errors
    position = np.asarray(errors.rms(found.position, found.tracked))
    velocity = np.asarray(errors.rms(found.velocity, found.tracked))
    return {
        "position_rms": float(position.mean()),
        "velocity_rms": float(velocity.mean()),
        "position_peak": float(position.max()),
        "active_modes": float(np.asarray(followed.num_active).mean()),
    }


def as_table(title: str, summary: Mapping[str, Mapping[str, float]]) -> Table:
    """Returns the summary as a table of text."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("tracker")
    for column in ("RMS (m)", "RMS (m/s)", "peak (m)", "active modes", "swapped"):
        table.add_column(column, justify="right")
    for name, one in summary.items():
        table.add_row(*row(name, one))
    return table


def row(name: str, summary: Mapping[str, float]) -> tuple[str, ...]:
    """Returns a line of the table."""
    return (
        name,
        f"{summary['position_rms']:.2f}",
        f"{summary['velocity_rms']:.2f}",
        f"{summary['position_peak']:.1f}",
        f"{summary['active_modes']:.1f}",
        f"{100 * summary['swapped']:.1f} %",
    )
