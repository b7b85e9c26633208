"""Detections, tracks and ground truth to Stone Soup's objects, and back.

    seen = scans_from_detections(simulator)    # (timestamp, set of Detection) pairs
    for timestamp, detections in detections_from_scans(scans, start): ...
    tracks = tracks_from_estimates(estimates, scans.time, start)
    ids, truth, start = truth_from_paths(ground_truth_paths)

Their timestamps have microseconds and ours are seconds after a start (in UTC). State
vectors become plain numbers; where their order differs (Stone Soup measures a bearing
before a range, we after it), `index` tells which of their entries are ours, in our
order. (https://stonesoup.readthedocs.io)

Example:
    >>> import datetime
    >>> from stonesoup.types.detection import Detection
    >>> noon = datetime.datetime(2020, 6, 30, 12)
    >>> later = noon + datetime.timedelta(seconds=2.5)
    >>> pairs = [(noon, {Detection([3.0, 4.0], timestamp=noon)}), (later, set())]
    >>> seen = scans_from_detections(pairs)
    >>> print(seen.scans.scan.valid.sum(1), seen.scans.time, seen.start)
    [1 0] [0.  2.5] 2020-06-30T12:00:00
"""

import datetime
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxtrack.data import clock
from jaxtrack.data.errors import DataError, import_stonesoup
from jaxtrack.data.rows import truth_from_rows, truth_to_rows
from jaxtrack.data.scans import Scans, fill_scans
from jaxtrack.data.tables import reported
from jaxtrack.scenarios.world import Truth
from jaxtrack.types import PyTree

Timed = tuple[datetime.datetime, Iterable[Any]]


class Seen(NamedTuple):
    """What was read of Stone Soup's detections.

    Attributes:
        scans: T scans, whose `row` counts `detections` from 0.
        start: The ISO time of second 0 (UTC).
        detections: The objects themselves, which know where they come from.
    """

    scans: Scans
    start: str
    detections: list[Any]


def scans_from_detections(
    pairs: Iterable[Timed],
    index: Sequence[int] | None = None,
    start: str | None = None,
    max_detections: int | None = None,
) -> Seen:
    """Makes a scan of the detections of each timestamp.

    As sets have no order, the slots of a scan are filled in rising order of what was
    measured, by its first value, then by its second.

    Args:
        pairs: (timestamp, set of detections), as detectors and simulators yield them,
            in the order of time; an empty set is an empty scan. Detections may be
            `Detection`, `TrueDetection` or `Clutter`.
        index: Which entries of a state vector are measured, in our order (Z); by
            default all.
        start: The ISO time of second 0 (UTC), by default the first timestamp.
        max_detections: See `fill_scans`.

    Returns:
        Scans, start and the objects.

    Raises:
        ValueError: If `index` goes beyond the state vectors.
        DataError: If timestamps are not in order, no detection tells how many values
            are measured, state vectors differ in size, or a value is not finite.
    """
    listed = [(stamp, list(some)) for stamp, some in pairs]
    seconds, start = _seconds([stamp for stamp, _ in listed], start)
    backwards = np.diff(seconds) <= 0.0
    if backwards.any():
        k = int(np.argmax(backwards)) + 1
        raise DataError(
            f"timestamp {k}, {listed[k][0]}, is not after the one before it; sort the "
            "pairs, and join those of one time."
        )
    objects = [x for _, some in listed for x in some]
    scan_of = np.repeat(np.arange(len(listed)), [len(some) for _, some in listed])
    measured = _vectors(objects, index)
    order = np.lexsort((*measured.T[::-1], scan_of))
    objects = [objects[k] for k in order]
    scans = fill_scans(
        scan_of[order], measured[order], seconds, max_detections=max_detections
    )
    return Seen(scans, start, objects)


def detections_from_scans(
    scans: Scans,
    start: str,
    index: Sequence[int] | None = None,
    sources: Any = None,
    measurement_model: Any = None,
) -> list[tuple[datetime.datetime, set[Any]]]:
    """Makes Stone Soup's detections of each scan.

    Args:
        scans: T scans.
        start: The ISO time of second 0 (UTC).
        index: Where what was measured goes in a state vector (Z).
        sources: The `GroundTruthPath` that each detection comes from, or None where it
            is clutter, [T, K]; makes them `TrueDetection` and `Clutter` in place of
            `Detection`.
        measurement_model: Stone Soup's model, for every detection.

    Returns:
        (timestamp, set of detections) for each scan.
    """
    kinds = import_stonesoup("types.detection")
    valid = np.asarray(scans.scan.valid)
    vectors = _placed(np.asarray(scans.scan.detections, float), index)

    def one(t: int, k: int, timestamp: datetime.datetime) -> Any:
        given = {"timestamp": timestamp, "measurement_model": measurement_model}
        if sources is None:
            return kinds.Detection(vectors[t, k], **given)
        if sources[t][k] is None:
            return kinds.Clutter(vectors[t, k], **given)
        return kinds.TrueDetection(
            vectors[t, k], groundtruth_path=sources[t][k], **given
        )

    times = _timestamps(scans.time, start)
    return [
        (now, {one(t, int(k), now) for k in np.flatnonzero(valid[t])})
        for t, now in enumerate(times)
    ]


def tracks_from_estimates(estimates: PyTree, time: Any, start: str) -> set[Any]:
    """Makes a `Track` of each label, with a `GaussianState` where it is reported.

    Args:
        estimates: Estimates of a tracker with a leading T: mean [T, N, D], cov
            [T, N, D, D], label [T, N], exists [T, N].
        time: Seconds, the end of each scan, [T].
        start: The ISO time of second 0 (UTC).

    Returns:
        The tracks, whose ids are the labels as texts.
    """
    states = import_stonesoup("types.state")
    kinds = import_stonesoup("types.track")
    times = _timestamps(time, start)
    mean, cov = (np.asarray(x, float) for x in (estimates.mean, estimates.cov))
    found: dict[str, list[Any]] = {}
    for t, n, label in zip(*map(np.ndarray.tolist, reported(estimates)), strict=True):
        state = states.GaussianState(mean[t, n], cov[t, n], timestamp=times[t])
        found.setdefault(str(label), []).append(state)
    return {kinds.Track(some, id=label) for label, some in found.items()}


def paths_from_truth(truth: Truth, start: str, ids: Any = None) -> set[Any]:
    """Makes a `GroundTruthPath` of each target.

    Args:
        truth: T scans of N targets.
        start: The ISO time of second 0 (UTC).
        ids: What the targets are called, [N]; by default 0, 1, ...

    Returns:
        The paths, whose ids are texts; a target that never exists has none.
    """
    kinds = import_stonesoup("types.groundtruth")
    rows = truth_to_rows(truth)
    names = np.arange(np.shape(truth.exists)[1]) if ids is None else np.asarray(ids)
    found: dict[int, list[Any]] = {}
    times = _timestamps(rows.time, start)
    for n, state, now in zip(rows.target.tolist(), rows.state, times, strict=True):
        found.setdefault(n, []).append(kinds.GroundTruthState(state, timestamp=now))
    return {kinds.GroundTruthPath(some, id=str(names[n])) for n, some in found.items()}


def truth_from_paths(
    paths: Iterable[Any],
    index: Sequence[int] | None = None,
    start: str | None = None,
    timestamps: Sequence[datetime.datetime] | None = None,
) -> tuple[np.ndarray, Truth, str]:
    """Reads ground truth, or tracks, whose means are taken.

    Of several states of a path at one time, as a track has them before and after an
    update, the last one counts.

    Args:
        paths: `GroundTruthPath`s or `Track`s.
        index: Which entries of a state vector are the state, in our order (D); by
            default all.
        start: The ISO time of second 0 (UTC), by default the earliest timestamp.
        timestamps: Those of the scans in order, [T]; by default those of the paths.

    Returns:
        The N ids in sorted order, the truth, and the start.

    Raises:
        ValueError: If `index` goes beyond the state vectors.
        DataError: If a path has a timestamp that is not among those given, there is no
            state at all, states differ in size, or one is not finite.
    """
    last = {(path.id, x.timestamp): x for path in paths for x in path.states}
    stamps = [stamp for _, stamp in last]
    if timestamps is not None and start is None:
        start = _seconds(timestamps, None)[1]
    seconds, start = _seconds(stamps, start)
    times = None if timestamps is None else _seconds(timestamps, start)[0]
    names = np.array([name for name, _ in last], str)
    state = _vectors(list(last.values()), index)
    return *truth_from_rows(seconds, names, state, times), start


def _seconds(
    stamps: Sequence[datetime.datetime], start: str | None
) -> tuple[np.ndarray, str]:
    """Counts the seconds of timestamps, none of which may be missing."""
    if None in stamps:
        raise DataError(
            f"timestamp {stamps.index(None)}, counted from 0, is None; give each state "
            "the time that it is of."
        )
    return clock.seconds_after(clock.as_stamps(stamps), start)


def _timestamps(seconds: Any, start: str) -> list[datetime.datetime]:
    """Makes timestamps of seconds."""
    return clock.to_stamps(seconds, start, "us").tolist()


def _vectors(states: Sequence[Any], index: Sequence[int] | None) -> np.ndarray:
    """Takes the chosen entries of state vectors, [n, Z]."""
    if not states:
        if index is None:
            raise DataError(
                "There is no state to tell how many values there are; give index."
            )
        return np.zeros((0, len(index)))
    each = [np.asarray(x.state_vector, float).ravel() for x in states]
    sizes = [len(x) for x in each]
    if len(set(sizes)) > 1:
        k = next(k for k, size in enumerate(sizes) if size != sizes[0])
        raise DataError(
            f"The state vector at {states[k].timestamp} has {sizes[k]} entries, but "
            f"that at {states[0].timestamp} has {sizes[0]}; read one kind at a time."
        )
    rows = np.array(each)
    if index is not None:
        if not all(0 <= i < sizes[0] for i in index):
            raise ValueError(
                f"index is {tuple(index)}, but a state vector has {sizes[0]} entries; "
                f"give numbers from 0 to {sizes[0] - 1}."
            )
        rows = rows[:, list(index)]
    wrong = ~np.isfinite(rows).all(axis=1)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise DataError(
            f"The state vector {rows[k]} at {states[k].timestamp} is not finite; leave "
            "it out."
        )
    return rows


def _placed(measured: np.ndarray, index: Sequence[int] | None) -> np.ndarray:
    """Undoes the choice of entries that `_vectors` makes."""
    if index is None:
        return measured
    if sorted(index) != list(range(measured.shape[-1])):
        raise ValueError(
            f"index is {tuple(index)}; give each of 0 to {measured.shape[-1] - 1} once."
        )
    return measured[..., np.argsort(index)]
