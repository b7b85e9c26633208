"""The picture of a recording: a map, its busiest corner, and that corner over time.

Each label has a colour; where a track was not reported for some scans its line is thin.
The figure is matplotlib's, without pyplot: `picture.chart(result, table).savefig(...)`.

    >>> import numpy as np
    >>> from jaxtrack.recorded import picture
    >>> paths = {4: picture.Path(np.arange(3.0), np.array([[0, 0], [5, 0], [9.0, 0]]))}
    >>> print(picture.busiest(paths, side=4.0).round(1))
    [ 2.5 -2. ]
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxtrack import plot
from jaxtrack.data.files import Table
from jaxtrack.recorded.tracking import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ZOOM = 6.0  # how much larger the corner is than the map
STEPS = 24  # places tried for it, along each axis


class Path(NamedTuple):
    """A reported track: time [n] in seconds, position [n, 2] in metres."""

    time: np.ndarray
    position: np.ndarray


def chart(
    result: Result, table: Table, truth: np.ndarray | None = None, title: str = ""
) -> "Figure":
    """Draws a recording.

    Args:
        result: From `tracking.track`.
        table: The detections that were tracked.
        truth: Identity of each detection as text [n], to be drawn in grey; or None.
        title: Above the figure.
    """
    import matplotlib
    from matplotlib.figure import Figure

    tracks = paths(result)
    reports = {} if truth is None else _reports(table, truth)
    low, high = table.xy.min(0), table.xy.max(0)
    side = max(float((high - low).max()) / ZOOM, 1.0)
    corner = busiest(tracks, side)
    unit, scale = ("km", 1e3) if side * ZOOM > plot.FAR else ("m", 1.0)
    with matplotlib.rc_context(plot.STYLE):
        figure = Figure(figsize=(14.0, 8.0), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.35, 1.0))
        whole = figure.add_subplot(grid[:, 0])
        zoom = figure.add_subplot(grid[0, 1])
        over = figure.add_subplot(grid[1, 1])
        for axes, width in ((whole, 1.0), (zoom, 1.6)):
            _draw_map(axes, table, tracks, reports, scale, width)
            axes.set(aspect="equal", xlabel=f"x ({unit})", ylabel=f"y ({unit})")
        zoom.set_xlim(corner[0] / scale, (corner[0] + side) / scale)
        zoom.set_ylim(corner[1] / scale, (corner[1] + side) / scale)
        zoom.set_title("Where most moves")
        whole.indicate_inset_zoom(zoom, edgecolor=plot.INK)
        _draw_times(over, table, tracks, corner, side, scale)
        over.set(xlabel=_clock(table), ylabel=f"y ({unit})", title="The same over time")
        figure.suptitle(title, x=0.01, ha="left")
        _explain(figure, bool(reports))
    return figure


def paths(result: Result) -> dict[int, Path]:
    """Takes the track of each label, wherever it is reported."""
    scan, slot = np.nonzero(result.estimates.exists)
    label = result.estimates.label[scan, slot]
    index = list(result.motion.position_index[:2])
    place = result.estimates.mean[scan, slot][:, index]
    time = result.scans.time[scan]
    mine = {int(one): label == one for one in np.unique(label)}
    return {one: Path(time[rows], place[rows]) for one, rows in mine.items()}


def busiest(tracks: dict[int, Path], side: float) -> np.ndarray:
    """Finds the square in which the tracks go the farthest, all together.

    Args:
        tracks: Of each label.
        side: Of the square, m.

    Returns:
        Its lower left corner, [2].
    """
    middle, length = [np.zeros((0, 2))], [np.zeros(0)]
    for path in tracks.values():
        # The way over some scans, to which the noise of what rests adds little.
        lag = min(5, len(path.time) - 1)
        if lag > 0:
            ahead, behind = path.position[lag:], path.position[:-lag]
            middle.append((ahead + behind) / 2)
            length.append(np.hypot(*(ahead - behind).T))
    where, way = np.concatenate(middle), np.concatenate(length)
    if not way.sum() > 0:
        everything = [path.position for path in tracks.values()]
        centre = np.median(np.concatenate([np.zeros((0, 2)), *everything]), axis=0)
        return np.nan_to_num(centre) - side / 2
    best, corner = -1.0, np.zeros(2)
    low, high = where.min(0) - side / 2, where.max(0) - side / 2
    for x in np.linspace(low[0], high[0], STEPS):
        for y in np.linspace(low[1], high[1], STEPS):
            inside = ((where >= (x, y)) & (where < (x + side, y + side))).all(1)
            if way[inside].sum() > best:
                best, corner = way[inside].sum(), np.array([x, y])
    return corner


def _reports(table: Table, truth: np.ndarray) -> dict[str, Path]:
    """Takes what each identity reported."""
    names = np.asarray(truth).astype(str)
    mine = {name: names == name for name in np.unique(names) if name.strip()}
    return {name: Path(table.time[rows], table.xy[rows]) for name, rows in mine.items()}


def _draw_map(
    axes: "Axes",
    table: Table,
    tracks: dict[int, Path],
    reports: dict[str, Path],
    scale: float,
    width: float,
) -> None:
    """Draws detections, the truth and the tracks, each with a dot at its end."""
    axes.plot(*(table.xy / scale).T, ".", color=plot.FAINT, alpha=0.5, ms=2.5, mew=0)
    for path in reports.values():
        axes.plot(*(path.position / scale).T, "-", color="#bbbbbb", lw=2.4 * width)
    for label, path in tracks.items():
        color = _color(label)
        for place, look in _pieces(path):
            axes.plot(*(place[:, 1:] / scale).T, color=color, lw=width * look)
        axes.plot(*path.position[-1] / scale, "o", color=color, ms=2.2 * width)


def _draw_times(
    axes: "Axes",
    table: Table,
    tracks: dict[int, Path],
    corner: np.ndarray,
    side: float,
    scale: float,
) -> None:
    """Draws the second coordinate over time, of what is in the corner."""

    def inside(place: np.ndarray) -> np.ndarray:
        return np.all((place >= corner) & (place < corner + side), axis=1)

    seen = inside(table.xy)
    dots = table.time[seen] / 60, table.xy[seen, 1] / scale
    axes.plot(*dots, ".", color=plot.FAINT, alpha=0.6, ms=3, mew=0)
    for label, path in tracks.items():
        if inside(path.position).any():
            for place, look in _pieces(path):
                shown = inside(place[:, 1:])[:, None]
                y = np.where(shown, place[:, 2:] / scale, np.nan)
                axes.plot(place[:, 0] / 60, y, color=_color(label), lw=1.3 * look)
    axes.set_ylim(corner[1] / scale, (corner[1] + side) / scale)


def _pieces(path: Path) -> list[tuple[np.ndarray, float]]:
    """Returns what to draw of a path as (time, x, y) [n, 3], each with a line width."""
    rows = np.column_stack([path.time, path.position])
    gaps = np.diff(path.time)
    usual = 1.5 * gaps.min() if len(gaps) else 0.0
    solid = np.insert(rows, 1 + np.flatnonzero(gaps > usual), np.nan, axis=0)
    return [(rows, 0.35), (solid, 1.0)]


def _color(label: int) -> Any:
    return plot.COLORS[label % len(plot.COLORS)]


def _clock(table: Table) -> str:
    since = "" if table.start is None else f" since {table.start.replace('T', ' ')} UTC"
    return f"minutes{since}"


def _explain(figure: "Figure", truth: bool) -> None:
    """Puts a legend below."""
    from matplotlib.lines import Line2D

    blue = plot.COLORS[0]
    handles = [
        Line2D([], [], marker=".", ls="", color=plot.FAINT, label="detections"),
        Line2D([], [], color=blue, lw=1.6, label="tracks, coloured by label"),
        Line2D([], [], color=blue, lw=0.5, label="not reported in between"),
        Line2D([], [], color=blue, marker="o", ms=4, ls="", label="last reported here"),
    ]
    if truth:
        grey = Line2D([], [], color="#bbbbbb", lw=3, label="truth")
        handles.insert(1, grey)
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
