"""Times of a clock to seconds after a start, and back.

Seconds are what the library counts in; a clock's times are `datetime64` or `datetime`,
in UTC. Within 26 days of the start a time in nanoseconds comes back as it was, within
40 years a time in microseconds.

Example:
    >>> times = np.array(["2020-06-30T12:00:01", "2020-06-30T12:00:00.5"], "M8[ms]")
    >>> seconds, start = seconds_after(times)
    >>> print(seconds, start)
    [0.5 0. ] 2020-06-30T12:00:00.500
    >>> to_stamps(seconds, start, "ms")[0]
    np.datetime64('2020-06-30T12:00:01.000')
"""

import datetime
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

from jaxtrack.data.errors import DataError

Unit = Literal["s", "ms", "us", "ns"]
UNITS: tuple[Unit, ...] = ("s", "ms", "us", "ns")
PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


def seconds_after(stamps: Any, start: str | None = None) -> tuple[np.ndarray, str]:
    """Counts the seconds of a clock's times after a start.

    Args:
        stamps: `datetime64` [n] in UTC; see `as_stamps` for objects.
        start: ISO time (UTC) of second 0, by default the earliest.

    Returns:
        Seconds [n], and the start in ISO form (that of 1970 if there is no time).

    Raises:
        DataError: If a time is missing (NaT), or the start is no time.
    """
    stamps = np.asarray(stamps, "datetime64[ns]")
    if np.isnat(stamps).any():
        k = int(np.argmax(np.isnat(stamps)))
        raise DataError(f"time[{k}] is missing (NaT); give it, or leave the row out.")
    if start is None:
        began = stamps.min() if stamps.size else np.datetime64(0, "ns")
    else:
        began = _start(start)
    seconds = (stamps - began).astype(np.int64) / PER_SECOND["ns"]
    return seconds, _iso(began)


def to_stamps(seconds: Any, start: str, unit: Unit = "ns") -> np.ndarray:
    """Undoes `seconds_after`.

    Args:
        seconds: After the start, [n].
        start: ISO time (UTC) of second 0.
        unit: What the times are rounded to.

    Returns:
        `datetime64` of that unit, [n].

    Raises:
        DataError: If the start is no time.
    """
    ticks = np.rint(np.asarray(seconds, float) * PER_SECOND[unit]).astype(np.int64)
    return (_start(start) + ticks.astype(f"m8[{unit}]")).astype(f"M8[{unit}]")


def as_stamps(times: Iterable[datetime.datetime]) -> np.ndarray:
    """Makes `datetime64[us]` [n] of `datetime`s; those with a time zone go to UTC."""
    utc = datetime.UTC
    naive = [x.astimezone(utc).replace(tzinfo=None) if x.tzinfo else x for x in times]
    return np.array(naive, "datetime64[us]")


def _start(start: str) -> np.datetime64:
    """Reads the time of second 0."""
    try:
        parsed = datetime.datetime.fromisoformat(start)
        # Only NumPy knows nanoseconds, and only Python time zones.
        zoned = parsed.tzinfo is not None
        return np.datetime64(as_stamps([parsed])[0] if zoned else start, "ns")
    except ValueError as error:
        raise DataError(
            f"start is {start!r}; give an ISO time such as 2020-06-30T12:00:00."
        ) from error


def _iso(began: np.datetime64) -> str:
    """Writes a time with as many digits as it needs."""
    enough = [x for x in UNITS if began.astype(f"M8[{x}]") == began]
    return str(began.astype(f"M8[{enough[0]}]"))
