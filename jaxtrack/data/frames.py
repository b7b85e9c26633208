"""Detections and truth to pandas tables, and back; for tracks see `data.tables`.

    frame = detections_frame(scans)                       # a row for each detection
    scans, start = scans_from_frame(frame)
    frame = truth_frame(truth, ("x", "vx", "y", "vy"))    # a row for each existence
    ids, truth, start = truth_from_frame(frame, ("x", "vx", "y", "vy"))

The column time has seconds, ISO texts, or a clock's times (`datetime64`; with a time
zone they go to UTC). A scan that saw nothing is a row with a time and no coordinates
(NaN), so that it is not lost. A table of `tables.tracks_table` is read by
`truth_from_frame` with identity="label".

Example:
    >>> from jaxtrack.data.scans import group_scans
    >>> scans = group_scans([0.0, 0.0, 2.5], [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    >>> frame = detections_frame(scans, start="2020-06-30T12:00:00")
    >>> print(frame.to_string(index=False))
                       time   x   y
    2020-06-30 12:00:00.000 1.0 2.0
    2020-06-30 12:00:00.000 3.0 4.0
    2020-06-30 12:00:02.500 5.0 6.0
    >>> again, start = scans_from_frame(frame)
    >>> print(again.scan.valid.sum(1), again.time, start)
    [2 1] [0.  2.5] 2020-06-30T12:00:00
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxtrack.data import clock
from jaxtrack.data.cells import read_times, refuse
from jaxtrack.data.errors import DataError, import_pandas
from jaxtrack.data.rows import truth_from_rows, truth_to_rows
from jaxtrack.data.scans import Scans, fill_scans
from jaxtrack.scenarios.world import Truth

SOURCE = "the table"  # in messages


def detections_frame(
    scans: Scans, names: Sequence[str] = ("x", "y"), start: str | None = None
) -> Any:
    """Lists the detections, scan by scan, in the order of their slots.

    Args:
        scans: T scans.
        names: What was measured, for the columns (Z).
        start: The ISO time of second 0 (UTC); makes the times `datetime64[ns]`.

    Returns:
        A pandas DataFrame with columns time and `names`.
    """
    pandas = import_pandas()
    valid = np.asarray(scans.scan.valid)
    measured = np.asarray(scans.scan.detections, float)
    _check_names(names, measured.shape[-1])
    shown = valid.copy()
    shown[~valid.any(axis=1), :1] = True
    scan, slot = np.nonzero(shown)
    rows = np.where(valid[scan, slot, None], measured[scan, slot], np.nan)
    time = _time_column(np.asarray(scans.time, float)[scan], start)
    return pandas.DataFrame({"time": time, **dict(zip(names, rows.T, strict=True))})


def scans_from_frame(
    frame: Any,
    names: Sequence[str] = ("x", "y"),
    max_detections: int | None = None,
    first_interval: float | None = None,
    start: str | None = None,
) -> tuple[Scans, str | None]:
    """Makes a scan of the detections of each time; for windows see `group_scans`.

    Args:
        frame: A pandas DataFrame in the order of time.
        names: The columns with what was measured (Z).
        max_detections: See `fill_scans`.
        first_interval: See `fill_scans`.
        start: The ISO time of second 0 (UTC), by default the earliest; without meaning
            for a table in seconds.

    Returns:
        The scans, whose `row` counts the rows of the table from 0; and the start, None
        if the table has seconds.

    Raises:
        DataError: If a column is missing or there twice, a time goes backwards, a
            coordinate is infinite, or a row has some of its coordinates.
    """
    _check_columns(frame, ("time", *names))
    time, start = _read_clock(frame["time"], start)
    why = "is earlier than the row before it; sort the table by time"
    refuse(SOURCE, frame["time"], np.diff(time, prepend=-np.inf) < 0.0, why)
    measured = _read_columns(frame, names)
    blank = np.isnan(measured)
    for name, own in zip(names, blank.T, strict=True):
        why = f"stands beside coordinates; give all of {', '.join(names)}, or none"
        refuse(SOURCE, frame[name], own & ~blank.all(axis=1), why)

    every, scan_of = np.unique(time, return_inverse=True)
    there = np.flatnonzero(~blank.all(axis=1))
    scans = fill_scans(
        scan_of[there], measured[there], every, first_interval, max_detections
    )
    row = np.where(scans.row >= 0, np.append(there, -1)[scans.row], -1)
    return scans._replace(row=row), start


def truth_frame(
    truth: Truth, names: Sequence[str], ids: Any = None, start: str | None = None
) -> Any:
    """Lists where each target is while it exists, in the order of time.

    Args:
        truth: T scans of N targets.
        names: The components of the state, for the columns (D).
        ids: What the targets are called, [N]; by default 0, 1, ...
        start: The ISO time of second 0 (UTC); makes the times `datetime64[ns]`.

    Returns:
        A pandas DataFrame with columns time, target and `names`; times without targets
        and targets that never exist are not in it.
    """
    pandas = import_pandas()
    rows = truth_to_rows(truth)
    _check_names(names, rows.state.shape[-1], ("time", "target"))
    who = rows.target if ids is None else np.asarray(ids)[rows.target]
    columns = {"time": _time_column(rows.time, start), "target": who}
    return pandas.DataFrame(columns | dict(zip(names, rows.state.T, strict=True)))


def truth_from_frame(
    frame: Any,
    names: Sequence[str],
    identity: str = "target",
    times: Any = None,
    start: str | None = None,
) -> tuple[np.ndarray, Truth, str | None]:
    """Reads truth, or tracks, from a table with a row for each existence.

    Args:
        frame: A pandas DataFrame, its rows in any order.
        names: The columns with the state (D).
        identity: The column that tells who it is, by numbers or texts.
        times: Of the scans in seconds, [T]; by default those in the table.
        start: The ISO time of second 0 (UTC), by default the earliest; without meaning
            for a table in seconds.

    Returns:
        The N identities in sorted order, the truth, and the start, None if the table
        has seconds.

    Raises:
        DataError: If a column is missing or there twice, a cell is not finite, an
            identity has two rows for one time, or a row has a time that is not among
            `times`.
    """
    _check_columns(frame, ("time", identity, *names))
    time, start = _read_clock(frame["time"], start)
    state = _read_columns(frame, names)
    for name, values in zip(names, state.T, strict=True):
        why = "is not a finite number; correct the cell or remove the row"
        refuse(SOURCE, frame[name], np.isnan(values), why)
    who = frame[identity]
    why = "is no identity; give one or remove the row"
    refuse(SOURCE, who, who.isna().to_numpy(), why)
    who = who.to_numpy(str) if who.dtype.kind not in "biuf" else who.to_numpy()
    ids, truth = truth_from_rows(time, who, state, times)
    return ids, truth, start


def _time_column(seconds: np.ndarray, start: str | None) -> np.ndarray:
    """Gives seconds, or the times of a clock."""
    return seconds if start is None else clock.to_stamps(seconds, start)


def _read_clock(cells: Any, start: str | None) -> tuple[np.ndarray, str | None]:
    """Reads seconds, texts or a clock's times as seconds."""
    if cells.dtype.kind == "M":
        refuse(SOURCE, cells, cells.isna().to_numpy(), "is no time; give it")
        naive = cells.dt.tz_convert(None) if cells.dt.tz is not None else cells
        return clock.seconds_after(naive.to_numpy(), start)
    if cells.dtype.kind in "iuf":
        seconds = cells.to_numpy(float)
        why = "is not a finite number of seconds; correct it or remove the row"
        refuse(SOURCE, cells, ~np.isfinite(seconds), why)
        return seconds, None
    if not len(cells):
        return np.zeros(0), None
    return read_times(SOURCE, cells.astype(str), start)


def _read_columns(frame: Any, names: Sequence[str]) -> np.ndarray:
    """Reads numbers [n, len(names)]; NaN where a cell is missing."""
    pandas = import_pandas()
    columns = []
    for name in names:
        cells = frame[name]
        values = pandas.to_numeric(cells, errors="coerce").to_numpy(
            float, na_value=np.nan
        )
        wrong = np.isinf(values) | np.isnan(values) & cells.notna().to_numpy()
        why = "is not a finite number; correct the cell or remove the row"
        refuse(SOURCE, cells, wrong, why)
        columns.append(values)
    return np.stack(columns, axis=1)


def _check_names(
    names: Sequence[str], size: int, taken: tuple[str, ...] = ("time",)
) -> None:
    """Refuses names that are not one for each column, or of two columns."""
    every = [*taken, *names]
    if again := [name for name in names if every.count(name) > 1]:
        raise ValueError(
            f"names has {', '.join(names)}, but {again[0]!r} would name two columns; "
            "give each a name of its own."
        )
    if len(names) != size:
        raise ValueError(
            f"names has {', '.join(names)}, but there are {size} components; give a "
            "name for each."
        )


def _check_columns(frame: Any, names: Sequence[str]) -> None:
    """Refuses a table that lacks a column, or has two of one name."""
    if again := [name for name in names if list(frame).count(name) > 1]:
        raise DataError(
            f"{SOURCE} has several columns {again[0]!r}; keep one of them, or rename "
            "the others."
        )
    missing = [name for name in names if name not in frame]
    if missing:
        has = ", ".join(map(str, frame)) or "none"
        raise DataError(
            f"{SOURCE} has no column {missing[0]!r}; it has {has}: rename one, or say "
            "which it is."
        )
