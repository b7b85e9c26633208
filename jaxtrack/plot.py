"""Pictures in the style of the house; every function returns a matplotlib `Figure`.

Nothing touches pyplot or a screen: a notebook shows the figure, a script saves it with
`figure.savefig("tracks.png")`.

    >>> import jax
    >>> from jaxtrack import plot, scenarios
    >>> scenario = scenarios.make("yuan2013-linear")
    >>> truth, scans = scenario.simulate(jax.random.key(0))
    >>> figure = plot.tracks(truth, scans, None, scenario.world.motion)
    >>> figure.axes[0].get_xlabel()
    'x (m)'
"""

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind readers tell apart, the darker ones first.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ("--", "-.", ":")  # where the colours begin anew
INK, FAINT = "#222222", "#8a8a8a"
STYLE: dict[Any, Any] = {
    "font.size": 10.0,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.edgecolor": "#666666",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.dpi": 150,
    "figure.dpi": 110,
}
FAR = 2e4  # metres across, from which on maps are in kilometres
SIGMAS = 2.0
BANDS = {"error": "mean ± 2 standard errors", "quantiles": "10 to 90 % of the runs"}


def tracks(
    truth: Any,
    scans: Any,
    estimates: Any,
    motion: Any,
    sensor: Any = None,
    every: int = 5,
    title: str = "",
) -> "Figure":
    """Draws one run as a map.

    Truth is solid, with a ring where a target is born and a cross where it goes; tracks
    are dashed, a colour for each label, with 2-sigma ellipses; detections are faint.
    Of three position axes the first two are drawn.

    Args:
        truth: A `Truth`, or None where there is none to show.
        scans: Scans with a leading T.
        estimates: A tracker's `Estimate` with a leading T, or None.
        motion: A motion model, asked only where positions stand.
        sensor: Places the detections, if they are not positions already.
        every: Scans from one ellipse of a track to the next.
        title: Above the map.
    """
    import matplotlib
    from matplotlib.figure import Figure

    index = list(motion.position_index[:2])
    seen = _positions(scans, sensor)
    paths = [] if truth is None else list(_paths(truth, index))
    unit, scale = _unit([seen, *(path for _, path in paths)])
    with matplotlib.rc_context(STYLE):
        figure = Figure(layout="constrained")
        axes = figure.add_subplot(aspect="equal", title=title)
        axes.plot(*(seen / scale).T, ".", color=FAINT, alpha=0.5, ms=3, mew=0)
        _draw_truth(axes, [path / scale for _, path in paths])
        limits = axes.axis()
        figure.set_size_inches(_size(limits))
        for n, (label, path) in enumerate(_labelled(estimates, index)):
            color = COLORS[n % len(COLORS)]
            dashes = DASHES[n // len(COLORS) % len(DASHES)]
            axes.plot(*(path / scale).T, dashes, color=color, lw=1.7, zorder=3)
            _draw_ellipses(axes, estimates, label, index, every, scale, color)
        axes.axis(limits)
        axes.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})")
        _explain(figure, truth is not None, estimates is not None)
    return figure


def over_time(
    dataset: "xarray.Dataset", variable: str = "ospa", band: str = "error"
) -> "Figure":
    """Draws a score over time: a curve for each tracker, a panel for each setting.

    With a number of targets goes the true number, black.

    Args:
        dataset: Of `engine.monte_carlo`.
        variable: One of its scores, such as ospa, num_reported or num_expected.
        band: `error`, the mean and twice its standard error; or `quantiles`, the mean
            and the range from 10 to 90 % of the runs.

    Raises:
        ValueError: An unknown variable or band.
    """
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    if variable not in dataset or "time" not in dataset[variable].dims:
        raise ValueError(f"{variable!r} is no score; give one of {_scores(dataset)}")
    if band not in BANDS:
        raise ValueError(f"band is {band!r}; give one of {', '.join(BANDS)}")
    settings = dataset["setting"].values
    columns = min(len(settings), 3)
    rows = math.ceil(len(settings) / columns)
    with matplotlib.rc_context(STYLE):
        width, height = (
            (8.0, 4.2) if columns == 1 else (4.0 * columns, 3.0 * rows + 0.5)
        )
        figure = Figure(figsize=(width, height), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes in grid.flat[len(settings) :]:
            axes.remove()
        for axes, setting in zip(grid.flat, settings, strict=False):
            _draw_scores(axes, dataset.sel(setting=setting), variable, band)
            if len(settings) > 1:
                axes.set_title(str(setting))
        _name_axes(grid, dataset, variable)
        if "scenario" in dataset.attrs:
            about = f"{dataset.attrs['scenario']}, {dataset.sizes['run']} runs"
            figure.suptitle(about, x=0.01, ha="left")
        handles, _ = grid[0, 0].get_legend_handles_labels()
        handles.append(Patch(color=FAINT, alpha=0.3, lw=0, label=BANDS[band]))
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _positions(scans: Any, sensor: Any) -> np.ndarray:
    """Returns where all detections of all scans lie, [n, 2]."""
    valid = np.asarray(scans.valid)
    detections = np.asarray(scans.detections)[valid]
    if sensor is not None and hasattr(sensor, "locate") and len(detections):
        detections = np.asarray(jax.vmap(lambda z: sensor.locate(z).mean)(detections))
    return detections[:, :2]


def _paths(truth: Any, index: list[int]) -> Iterator[tuple[int, np.ndarray]]:
    """Yields each target's positions while it is there, [n, 2]."""
    state, exists = np.asarray(truth.state), np.asarray(truth.exists)
    for n in range(exists.shape[1]):
        if exists[:, n].any():
            yield n, state[exists[:, n], n][:, index]


def _labelled(estimates: Any, index: list[int]) -> Iterator[tuple[int, np.ndarray]]:
    """Yields each track's positions [T, 2], NaN where it is not reported."""
    if estimates is None:
        return
    mean, label = np.asarray(estimates.mean), np.asarray(estimates.label)
    exists = np.asarray(estimates.exists)
    for one in np.unique(label[exists]):
        mine = exists & (label == one)
        path = np.full((len(mine), 2), np.nan)
        path[mine.any(1)] = mean[np.nonzero(mine)][:, index]
        yield int(one), path


def _draw_truth(axes: "Axes", paths: list[np.ndarray]) -> None:
    ring = {"mfc": "white", "mec": INK, "mew": 1.3, "ms": 7, "zorder": 4}
    for path in paths:
        axes.plot(*path.T, "-", color=INK, lw=1.1, zorder=2)
        axes.plot(*path[0], "o", **ring)
        axes.plot(*path[-1], "x", color=INK, mew=1.5, ms=6, zorder=4)


def _draw_ellipses(
    axes: "Axes",
    estimates: Any,
    label: int,
    index: list[int],
    every: int,
    scale: float,
    color: str,
) -> None:
    """Draws a track's 2-sigma ellipses, counted from its first scan."""
    from matplotlib.patches import Ellipse

    mine = np.asarray(estimates.exists) & (np.asarray(estimates.label) == label)
    for t, slot in np.argwhere(mine)[::every]:
        cov = np.asarray(estimates.cov[t, slot])[np.ix_(index, index)] / scale**2
        centre = np.asarray(estimates.mean[t, slot])[index] / scale
        size, turn = np.linalg.eigh(cov)
        width, height = 2 * SIGMAS * np.sqrt(np.maximum(size, 0))
        angle = math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
        look: dict[str, Any] = {
            "fc": (color, 0.25),
            "ec": color,
            "lw": 1,
            "zorder": 2.5,
        }
        axes.add_patch(Ellipse(tuple(centre), width, height, angle=angle, **look))


def _explain(figure: "Figure", truth: bool, estimates: bool) -> None:
    """Puts a legend below the map."""
    from matplotlib.lines import Line2D

    dots: dict[str, Any] = {"ls": "", "mec": INK, "mew": 1.3}
    handles = [Line2D([], [], marker=".", ls="", color=FAINT, label="detections")]
    if truth:
        handles += [
            Line2D([], [], color=INK, lw=1.1, label="truth"),
            Line2D([], [], marker="o", mfc="white", ms=7, label="born", **dots),
            Line2D([], [], marker="x", ms=6, label="gone", **dots),
        ]
    if estimates:
        blue = COLORS[0]
        name = "tracks, a colour each"
        ring: dict[str, Any] = {
            "marker": "o",
            "ms": 9,
            "mfc": (blue, 0.25),
            "mec": blue,
        }
        handles += [
            Line2D([], [], ls="--", lw=1.7, color=blue, label=name),
            Line2D([], [], ls="", label=f"their {SIGMAS:g}-sigma ellipses", **ring),
        ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)


def _draw_scores(
    axes: "Axes", dataset: "xarray.Dataset", variable: str, band: str
) -> None:
    """Draws one panel."""
    dataset = dataset.dropna("time", how="all", subset=[variable])
    time = dataset["time"].values
    if variable in ("num_reported", "num_expected"):
        true = dataset["num_true"].values[0].mean(0)
        axes.step(time, true, where="mid", color=INK, lw=1.2, label="true number")
    for n, tracker in enumerate(dataset["tracker"].values):
        color = COLORS[n % len(COLORS)]
        runs = dataset[variable].sel(tracker=tracker).values
        mean, low, high = _band(runs, band)
        axes.plot(time, mean, color=color, lw=1.6, label=str(tracker))
        axes.fill_between(time, low, high, color=color, alpha=0.22, lw=0)


def _band(runs: np.ndarray, band: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the mean of runs [R, T] and a band about it, each [T]."""
    mean = runs.mean(0)
    if band == "quantiles":
        low, high = np.quantile(runs, (0.1, 0.9), axis=0)
        return mean, low, high
    error = runs.std(0, ddof=1) / math.sqrt(len(runs)) if len(runs) > 1 else 0 * mean
    return mean, mean - 2 * error, mean + 2 * error


def _name_axes(grid: Any, dataset: "xarray.Dataset", variable: str) -> None:
    about = dataset[variable].attrs
    unit = f" ({about['units']})" if about.get("units") else ""
    for axes in grid[:, 0]:
        axes.set_ylabel(about.get("long_name", variable) + unit)
        axes.set_ylim(bottom=0 if float(dataset[variable].min()) >= 0 else None)
    for axes in grid.flat:
        axes.margins(x=0.01)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")


def _size(limits: tuple[float, float, float, float]) -> tuple[float, float]:
    """Returns width and height of a figure, inches, for a map with these limits."""
    left, right, low, high = limits
    shape = min(max((high - low) / (right - left), 0.35), 1.6)
    width = 6.0 / max(shape, 1.0)
    return max(width + 1.0, 5.5), width * shape + 1.3


def _unit(places: Iterable[np.ndarray]) -> tuple[str, float]:
    """Returns the unit of a map and its length in metres."""
    everything = np.concatenate([place.reshape(-1, 2) for place in places])
    wide = len(everything) > 0 and np.ptp(everything, axis=0).max() > FAR
    return ("km", 1e3) if wide else ("m", 1.0)


def _scores(dataset: "xarray.Dataset") -> str:
    return ", ".join(str(n) for n, x in dataset.data_vars.items() if "time" in x.dims)
