"""Recordings of unequal length, as one stack.

The shorter ones are filled up at the end with their last scan, again and again, and
scans with empty slots. At these a tracker stays where it was before the last scan, so
that what it tells of them, which does not count, is what it told of that one.

    >>> import numpy as np
    >>> from jaxtrack.learn import recordings
    >>> from jaxtrack.types import Scan
    >>> long, short = (
    ...     Scan(np.ones((t, k, 2)), np.ones((t, k), bool), np.ones(t))
    ...     for t, k in ((5, 1), (3, 2))
    ... )
    >>> scans, _, length = recordings.stack([long, short], truth=None)
    >>> print(scans.detections.shape, length, scans.valid[0, 0])
    (2, 5, 2, 2) [5 3] [ True False]
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.learn import sizes
from jaxtrack.types import Array, PyTree, Scan, Tracker


def stack(scans: PyTree, truth: PyTree) -> tuple[PyTree, PyTree, np.ndarray | None]:
    """Stacks a list of recordings; anything else comes back as it is.

    Args:
        scans: A list of recordings [T_r], or what `fit` takes else.
        truth: A list of arrays [T_r] as well, or None.

    Returns:
        Scans and truth, with leading axes [R, T], and how many scans of each recording
        there are, [R]; None where all have the same number.

    Raises:
        ValueError: A list without recordings, a truth that is no such list, or
            recordings that differ in more than scans and slots.
    """
    if not _several(scans):
        return scans, truth, None
    if not scans:
        raise ValueError("scans is an empty list; give at least one recording")
    if truth is not None and not (_several(truth) and len(truth) == len(scans)):
        what = f"{len(truth)}" if _several(truth) else f"a {type(truth).__name__}"
        raise ValueError(
            f"scans is a list of {len(scans)} recordings, and the truth is {what}; "
            "give a list of as many"
        )
    truths = truth if truth is not None else [None] * len(scans)
    length = [
        _length(number, *pair)
        for number, pair in enumerate(zip(scans, truths, strict=True))
    ]
    joined = _join("scans", scans, max(length))
    told = None if truth is None else _join("truth", truth, max(length))
    return joined, told, np.array(length) if len(set(length)) > 1 else None


def stopped(tracker: Tracker, length: Array) -> Tracker:
    """Returns a tracker that does not get past the last scan of a recording.

    Args:
        tracker: Any.
        length: How many scans there are.
    """

    def init(params: PyTree, key: Array) -> PyTree:
        return jnp.zeros((), int), tracker.init(params, key)

    def step(params: PyTree, state: PyTree, scan: Scan) -> tuple[PyTree, Any]:
        done, before = state
        after, told = tracker.step(params, before, scan)
        more = done + 1 < length
        kept = jax.tree.map(lambda x, y: jnp.where(more, x, y), after, before)
        return (done + 1, kept), told

    return Tracker(init, step)


def _several(given: Any) -> bool:
    """Returns whether it is a list, and no Scan, which is a tuple as well."""
    return type(given) in (list, tuple)


def _length(number: int, scans: PyTree, truth: PyTree) -> int:
    """Returns how many scans a recording has."""
    try:
        has_more, _, total = sizes.recordings(scans, truth)
    except ValueError as error:
        raise ValueError(f"recording {number} of the list: {error}") from None
    if has_more:
        raise ValueError(
            f"recording {number} of the list has an axis of recordings, too; give each "
            "with a leading [T]"
        )
    for scan in filter(_is_scan, jax.tree.leaves(scans, is_leaf=_is_scan)):
        slots = np.shape(scan.valid)
        if len(slots) != 2 or np.shape(scan.detections)[:2] != slots:
            raise ValueError(
                f"recording {number} of the list has detections of shape "
                f"{np.shape(scan.detections)} and valid of shape {slots}; give "
                "[T, K, Z] and [T, K]"
            )
    return total


def _join(name: str, recordings: Sequence[PyTree], total: int) -> PyTree:
    """Stacks recordings, each filled up to so many scans."""
    alike = [jax.tree.structure(each) for each in recordings]
    if len(set(alike)) > 1:
        other = next(i for i, each in enumerate(alike) if each != alike[0])
        raise ValueError(
            f"{name} of recording {other} are {alike[other]}, and of recording 0 "
            f"{alike[0]}; give all the same"
        )
    roomy = _widen(recordings)
    first = _shapes(roomy[0])
    for number, each in enumerate(roomy):
        if _shapes(each) != first:
            raise ValueError(
                f"{name} of recording {number} hold arrays of shapes {_shapes(each)} a "
                f"scan, and of recording 0 {first}; give all the same but for T and K"
            )

    def fill(*arrays: Any) -> np.ndarray:
        return np.stack([_last_again(np.asarray(x), total) for x in arrays])

    return jax.tree.map(fill, *roomy)


def _widen(recordings: Sequence[PyTree]) -> list[PyTree]:
    """Gives scans of the same sensor the same number of slots."""
    parts = [jax.tree.flatten(each, is_leaf=_is_scan) for each in recordings]
    wide = [_same_slots(column) for column in zip(*(x for x, _ in parts), strict=True)]
    if not wide:  # nothing in it
        return list(recordings)
    tree = parts[0][1]
    return [jax.tree.unflatten(tree, row) for row in zip(*wide, strict=True)]


def _same_slots(each: Sequence[Any]) -> Sequence[Any]:
    """Adds empty slots to scans, and nothing to anything else."""
    if not _is_scan(each[0]):
        return each
    most = max(np.shape(scan.valid)[1] for scan in each)

    def widen(x: Any) -> np.ndarray:
        more = most - np.shape(x)[1]
        return np.pad(x, [(0, 0), (0, more)] + [(0, 0)] * (np.ndim(x) - 2))

    return [
        scan._replace(detections=widen(scan.detections), valid=widen(scan.valid))
        for scan in each
    ]


def _last_again(array: np.ndarray, total: int) -> np.ndarray:
    more = total - len(array)
    return np.concatenate([array, np.repeat(array[-1:], more, axis=0)])


def _shapes(tree: PyTree) -> list[tuple[int, ...]]:
    return [np.shape(x)[1:] for x in jax.tree.leaves(tree)]


def _is_scan(x: Any) -> bool:
    return isinstance(x, Scan)
