r"""Detections from CSV files: read once, checked cell by cell, projected to metres.

Example:
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "radar.csv"
    >>> _ = path.write_text("time,x,y,ship\n0,1,2,Ada\n2.5,3,4,Bob\n")
    >>> table = read_detections(path)
    >>> print(table.time, table.xy[1], table.other["ship"])
    [0.  2.5] [3. 4.] ['Ada' 'Bob']
"""

import importlib.util
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxtrack.data import geodesy
from jaxtrack.data.cells import read_cells, read_numbers, read_times, refuse
from jaxtrack.data.errors import DataError

HARBOUR_FILE = "python_example_data/NYHarbor_2020_06_30_first_hour.csv"

# What a column may be called; case does not matter, the first one found is taken.
ALIASES = {
    "time": ("time", "timestamp", "datetime", "basedatetime"),
    "x": ("x",),
    "y": ("y",),
    "lat": ("lat", "latitude"),
    "lon": ("lon", "lng", "longitude"),
}


class Table(NamedTuple):
    """The n detections of a file, in the order of time.

    Attributes:
        time: Seconds, [n]: as in the file, or after `start` if its times are ISO.
        xy: Positions in metres, [n, 2]; east and north of `origin` if the file has
            latitudes and longitudes.
        other: Every further column by its name, as text [n], for scoring; no tracker
            sees it.
        origin: (lat, lon) in degrees of the point (0, 0), None if the file has metres.
        start: The earliest time in ISO form (UTC), None if the file has seconds.
    """

    time: np.ndarray
    xy: np.ndarray
    other: dict[str, np.ndarray]
    origin: geodesy.Origin | None
    start: str | None


def read_detections(
    path: str | os.PathLike[str],
    columns: Mapping[str, str] | None = None,
    sort: bool = False,
    origin: geodesy.Origin | None = None,
) -> Table:
    """Reads the detections in a CSV file with a header.

    It needs a column time, in seconds or as ISO times, and x and y in metres, or lat
    and lon in degrees (x and y are taken if it has both pairs). Rows in messages are
    numbered as in a spreadsheet: the header is row 1.

    Args:
        path: The file.
        columns: Names of columns where they are not the usual ones, by what they hold
            (time, x, y, lat, lon), such as {"time": "Received"}.
        sort: Whether to sort by time; otherwise times that go backwards are an error.
        origin: (lat, lon) in degrees of the point (0, 0), by default the median point;
            without meaning for a file in metres.

    Returns:
        The table.

    Raises:
        DataError: If the file, a column or a cell is missing or wrong.
    """
    frame = read_cells(path)
    if not len(frame):
        raise DataError(
            f"{path} has no detections; it needs a header and one row for each."
        )
    names = _choose_columns(path, list(frame), columns or {})
    time, start = read_times(path, frame[names["time"]])
    if sort:
        order = np.argsort(time, kind="stable")
        frame, time = frame.iloc[order], time[order]
    backwards = np.diff(time, prepend=-np.inf) < 0.0
    why = "is earlier than the row before it; sort the file, or read it with sort=True"
    refuse(path, frame[names["time"]], backwards, why)

    first, second = [key for key in ALIASES if key in names and key != "time"]
    one = read_numbers(path, frame[names[first]])
    two = read_numbers(path, frame[names[second]])
    if first == "lat":
        _check_degrees(path, frame[names["lat"]], one, 90)
        _check_degrees(path, frame[names["lon"]], two, 180)
        one, two, origin = geodesy.to_local(one, two, origin)
    else:
        origin = None
    used = set(names.values())
    other = {name: frame[name].to_numpy(object) for name in frame if name not in used}
    return Table(time, np.stack([one, two], axis=1), other, origin, start)


def further_column(table: Table, name: str) -> np.ndarray:
    """Takes a further column of a table, such as who reported each detection.

    Args:
        table: A table from `read_detections`.
        name: The column's name; case matters only where it tells two columns apart.

    Returns:
        The cells as text, [n].

    Raises:
        DataError: If there is no such column.
    """
    close = [key for key in table.other if key.lower() == name.lower()]
    if not close:
        raise DataError(
            f"There is no further column {name!r}; choose one of "
            f"{', '.join(table.other) or 'none, as the file has no others'}."
        )
    return table.other[name if name in close else close[0]]


def harbour_path() -> pathlib.Path:
    """Finds the first hour of New York harbour's AIS in the package tracktable-data.

    AIS reports of 30 June 2020 with columns BaseDateTime, LON, LAT, MMSI and others.
    The package is located and not imported, as its import sets up logging.

    Returns:
        The path of the CSV file.

    Raises:
        DataError: If the package is not installed, or came without the file.
    """
    spec = importlib.util.find_spec("tracktable_data")
    for folder in (spec and spec.submodule_search_locations) or ():
        path = pathlib.Path(folder, HARBOUR_FILE)
        if path.is_file():
            return path
    raise DataError(
        "The harbour data are in the package tracktable-data, which was not found: "
        'pip install "jaxtrack[data]".'
    )


def _choose_columns(
    path: str | os.PathLike[str], found: Sequence[str], columns: Mapping[str, str]
) -> dict[str, str]:
    """Says which column holds the time and which two the position."""
    unknown = [key for key in columns if key not in ALIASES]
    if unknown:
        raise ValueError(
            f"columns has the key {unknown[0]!r}; use only {', '.join(ALIASES)}."
        )
    lower = {name.lower(): name for name in reversed(found)}
    names = {}
    for key, aliases in ALIASES.items():
        wanted = (columns[key],) if key in columns else aliases
        exact = [name for name in wanted if name in found]
        close = [lower[name.lower()] for name in wanted if name.lower() in lower]
        if exact or close:
            names[key] = (exact + close)[0]

    metres, degrees = {"x", "y"}, {"lat", "lon"}
    ask = degrees & set(columns) or not metres <= set(names) and degrees & set(names)
    pair = ("lat", "lon") if ask else ("x", "y")
    missing = [key for key in ("time", *pair) if key not in names]
    if missing:
        key = missing[0]
        name = columns.get(key, key)
        kind = "" if key == "time" else " for a position (x and y, or lat and lon)"
        remedy = f"rename one, or say which it is with columns={{{key!r}: ...}}"
        if len(found) == 1:
            remedy = "separate the columns by commas"
        raise DataError(
            f"{path} has no column {name!r}{kind}; it has {', '.join(found)}: {remedy}."
        )
    return {key: names[key] for key in ("time", *pair)}


def _check_degrees(
    path: str | os.PathLike[str], cells: Any, values: np.ndarray, limit: int
) -> None:
    """Refuses angles beyond a limit; AIS writes 91 and 181 for a missing position."""
    why = f"is outside -{limit} to {limit} degrees; correct the cell or remove the row"
    refuse(path, cells, np.abs(values) > limit, why)
