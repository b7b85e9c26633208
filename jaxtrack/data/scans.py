"""From rows of detections to scans, and from rows of known identity to the truth.

    scans = group_scans(table.time, table.xy, period=10.0)
    ids, position, exists = truth_at(table.time, table.xy, names, scans.time, 60.0)

Example:
    >>> scans = group_scans([0.0, 0.0, 2.5], [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    >>> print(scans.time, scans.scan.interval)
    [0.  2.5] [2.5 2.5]
    >>> print(scans.row)
    [[ 0  1]
     [ 2 -1]]
"""

import warnings
from typing import Any, NamedTuple

import numpy as np

from jaxtrack.data.errors import DataError
from jaxtrack.types import Scan

MAX_SLOTS = 50_000_000  # of all scans together: 1.6 GB with three measured values


class Scans(NamedTuple):
    """T scans of a recording.

    Attributes:
        scan: A `Scan` of NumPy arrays in float64: detections [T, K, Z], valid [T, K],
            interval [T] in seconds.
        time: The end of each scan in seconds, [T].
        row: Which detection fills the slot, counted from 0; -1 in an empty one, [T, K].
        dropped: How many detections found no slot, [T].
    """

    scan: Scan
    time: np.ndarray
    row: np.ndarray
    dropped: np.ndarray


def group_scans(
    time: Any,
    xy: Any,
    period: float | None = None,
    max_detections: int | None = None,
    ages: bool = False,
    max_empty: int = 10,
) -> Scans:
    """Groups detections into scans.

    Without a period, detections with the same time are a scan. With one, a scan is a
    window of that many seconds, the first beginning at the first detection, and a
    window without detections is an empty scan. After `max_empty` of those in a row, the
    rest of the gap becomes part of the interval before the next detections, so that a
    gap of years costs no memory and a track that was lost has ended.

    The first scan's interval is the period, or the median of the other intervals (1 s
    if there is no other).

    Args:
        time: Seconds, in order, [n].
        xy: What was measured, [n, Z].
        period: Length of a window in seconds, or None.
        max_detections: Number of slots K; by default the largest scan's. A fuller scan
            keeps its first K detections, with a warning.
        ages: Whether to append to each detection its age: the seconds from its time to
            the end of its scan, in [0, period].
        max_empty: How many empty scans may follow each other.

    Returns:
        The scans; empty slots hold zeros.

    Raises:
        DataError: If there is no detection, the times are not finite and in order, or
            the scans would not fit into memory.
    """
    time, xy = np.asarray(time, float), np.asarray(xy, float)
    _check(time, xy, period, max_detections, max_empty)
    window, end = _windows(time, period)
    scan_of, scan_time = _number_scans(window, end, period, max_empty)

    if ages:
        xy = np.concatenate([xy, (scan_time[scan_of] - time)[:, None]], axis=1)
    return fill_scans(scan_of, xy, scan_time, period, max_detections)


def fill_scans(
    scan_of: Any,
    measured: Any,
    scan_time: Any,
    first_interval: float | None = None,
    max_detections: int | None = None,
) -> Scans:
    """Puts detections into the slots of the scans they belong to.

    Args:
        scan_of: The scan of each detection, counted from 0, in any order, [n]. Those
            of one scan fill its slots in the order in which they are given.
        measured: What was measured, [n, Z].
        scan_time: The end of each scan in seconds, [T].
        first_interval: Seconds before the first scan, by default the median of the
            other intervals (1 s if there is no other).
        max_detections: Number of slots K; by default the largest scan's, and at least
            1. A fuller scan keeps its first K detections, with a warning.

    Returns:
        The scans; empty slots hold zeros.

    Raises:
        ValueError: If a detection is of a scan that there is not.
        DataError: If the scans would not fit into memory.
    """
    scan_of, measured = np.asarray(scan_of, int), np.asarray(measured, float)
    scan_time = np.asarray(scan_time, float)
    num_scans = len(scan_time)
    strange = scan_of[(scan_of < 0) | (scan_of >= num_scans)]
    if strange.size:
        raise ValueError(
            f"scan_of has {strange[0]}, but there are {num_scans} scans; count them "
            "from 0."
        )
    count = np.bincount(scan_of, minlength=num_scans)
    size = max_detections or int(count.max(initial=1))
    if num_scans * size > MAX_SLOTS:
        raise DataError(
            f"{num_scans} scans of {size} slots do not fit into memory; set a smaller "
            "max_detections, or another period."
        )
    order = np.argsort(scan_of, kind="stable")
    slot = np.empty_like(order)
    slot[order] = np.arange(len(order)) - (np.cumsum(count) - count)[scan_of[order]]
    kept = slot < size
    row = np.full((num_scans, size), -1)
    row[scan_of[kept], slot[kept]] = np.flatnonzero(kept)
    _warn_of_dropped(count, size, scan_time)

    # A detection more, as an array of none cannot be indexed.
    padded = np.concatenate([measured, np.zeros((1, measured.shape[1]))])
    rest = np.diff(scan_time)
    first = first_interval or (np.median(rest) if len(rest) else 1.0)
    interval = np.append(first, rest)[:num_scans]
    # NumPy arrays, as 64 bits would be lost in jax's before float64 is switched on.
    return Scans(
        Scan._make((padded[row], row >= 0, interval)),
        scan_time,
        row,
        np.maximum(count - size, 0),
    )


def truth_at(
    time: Any, xy: Any, identity: Any, scan_times: Any, max_gap: float = np.inf
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Interpolates the reports of each identity at the times of the scans.

    A target exists from its first to its last report, except inside gaps between two of
    its reports that are longer than `max_gap`. Rows without identity (blank text) are
    left out; of several reports at one time the first is taken.

    Args:
        time: Seconds, in any order, [m].
        xy: Positions in metres, [m, 2].
        identity: Who reported, [m].
        scan_times: Seconds, [T].
        max_gap: Longest gap in seconds to interpolate across.

    Returns:
        The n identities in sorted order [n], positions [T, n, 2] (finite everywhere)
        and whether the target exists [T, n].
    """
    time, xy = np.asarray(time, float), np.asarray(xy, float)
    identity, at = np.asarray(identity), np.asarray(scan_times, float)
    ids, who = np.unique(identity.astype(str), return_inverse=True)
    named = [n for n in range(len(ids)) if ids[n].strip()]
    position = np.zeros((len(at), len(named), xy.shape[1]))
    exists = np.zeros((len(at), len(named)), bool)
    for n, code in enumerate(named):
        rows = np.flatnonzero(who == code)
        stamps, first = np.unique(time[rows], return_index=True)
        places = xy[rows[first]]
        for axis in range(xy.shape[1]):
            position[:, n, axis] = np.interp(at, stamps, places[:, axis])
        after = np.searchsorted(stamps, at, side="left").clip(max=len(stamps) - 1)
        before = np.searchsorted(stamps, at, side="right").clip(min=1) - 1
        inside = (at >= stamps[0]) & (at <= stamps[-1])
        exists[:, n] = inside & (stamps[after] - stamps[before] <= max_gap)
    return ids[named], position, exists


def _check(
    time: np.ndarray,
    xy: np.ndarray,
    period: float | None,
    max_detections: int | None,
    max_empty: int,
) -> None:
    """Refuses settings and times that make no scans."""
    if period is not None and not 0.0 < period < np.inf:
        raise ValueError(f"period is {period}; give seconds above 0, or None.")
    if max_detections is not None and max_detections < 1:
        raise ValueError(
            f"max_detections is {max_detections}; give 1 or more, or None."
        )
    if max_empty < 0:
        raise ValueError(f"max_empty is {max_empty}; give 0 or more.")
    if time.ndim != 1 or xy.ndim != 2 or len(time) != len(xy):
        raise ValueError(
            f"time has shape {time.shape} and xy {xy.shape}; give [n] and [n, Z]."
        )
    if not len(time):
        raise DataError("There are no detections to group; give at least one.")
    wrong = ~np.isfinite(time) | (np.diff(time, prepend=time[0]) < 0.0)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise DataError(
            f"time[{k}] is {time[k]}, not finite or earlier than the one before; sort "
            "the detections by time."
        )


def _windows(time: np.ndarray, period: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Gives each detection the number of its window [n] and that window's end [n]."""
    if period is None:
        return np.unique(time, return_inverse=True)[1], time
    # A hair is added so that k * period / period never rounds down to k - 1.
    window = np.floor((time - time[0]) / period + 1e-9)
    return window, time[0] + (window + 1.0) * period


def _number_scans(
    window: np.ndarray, end: np.ndarray, period: float | None, max_empty: int
) -> tuple[np.ndarray, np.ndarray]:
    """Counts empty windows in: the scan of each detection [n], each scan's end [T]."""
    occupied, first, group = np.unique(window, return_index=True, return_inverse=True)
    empty = np.minimum(np.diff(occupied) - 1.0, max_empty).astype(int)
    place = np.arange(len(occupied)) + np.append(0, np.cumsum(empty))
    # An empty scan ends one period after the scan before it, which may be empty too.
    scan = np.arange(place[-1] + 1)
    leader = np.searchsorted(place, scan, side="right") - 1
    behind = (scan - place[leader]) * (period or 0.0)
    return place[group], end[first][leader] + behind


def _warn_of_dropped(count: np.ndarray, size: int, scan_time: np.ndarray) -> None:
    """Says how many detections found no slot, and where most did."""
    lost = np.maximum(count - size, 0)
    if lost.any():
        worst = int(np.argmax(count))
        warnings.warn(
            f"{lost.sum()} of {count.sum()} detections were dropped in "
            f"{np.count_nonzero(lost)} scans, as max_detections is {size}; the fullest "
            f"scan, at {scan_time[worst]:g} s, has {count[worst]}; "
            "raise max_detections to keep all.",
            stacklevel=4,
        )
