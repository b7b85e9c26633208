"""Truth as rows, one for each time at which an identity is somewhere, and back.

Tables, text files and other libraries hold truth (and tracks) in this form. Nothing is
interpolated; reports that come at other times than the scans are for `scans.truth_at`.

Example:
    >>> ids, truth = truth_from_rows([0.0, 2.5, 2.5], ["b", "b", "a"], [[1], [2], [3]])
    >>> print(ids, truth.exists.tolist(), truth.state[1, :, 0])
    ['a' 'b'] [[False, True], [True, True]] [3. 2.]
"""

from typing import Any, NamedTuple

import numpy as np

from jaxtrack.data.errors import DataError
from jaxtrack.data.scans import MAX_SLOTS
from jaxtrack.scenarios.world import Truth


class Rows(NamedTuple):
    """Rows in the order of time, then of targets.

    Attributes:
        time: Seconds, [n].
        target: Which target, counted from 0, [n].
        state: [n, D].
    """

    time: np.ndarray
    target: np.ndarray
    state: np.ndarray


def truth_to_rows(truth: Truth) -> Rows:
    """Lists where each target is while it exists; times without targets are lost."""
    scan, target = np.nonzero(np.asarray(truth.exists))
    time = np.asarray(truth.time, float)[scan]
    return Rows(time, target, np.asarray(truth.state, float)[scan, target])


def truth_from_rows(
    time: Any, identity: Any, state: Any, times: Any = None
) -> tuple[np.ndarray, Truth]:
    """Sorts rows by time and identity.

    Args:
        time: Seconds, in any order, [n].
        identity: Who it is, numbers or texts, [n].
        state: [n, D].
        times: Those of the truth in rising order, [T]; by default those of the rows.

    Returns:
        The N identities in sorted order, and the truth as NumPy arrays in float64; the
        state is zero where the identity has no row.

    Raises:
        ValueError: If `times` do not rise.
        DataError: If an identity has two rows for one time, a row has a time that is
            not among `times`, a state is not finite, or all would not fit into memory.
    """
    time, state = np.asarray(time, float), np.asarray(state, float)
    ids, who = np.unique(np.asarray(identity), return_inverse=True)
    every = np.unique(time) if times is None else np.asarray(times, float)
    if len(every) * len(ids) > MAX_SLOTS:
        raise DataError(
            f"{len(every)} times of {len(ids)} identities do not fit into memory; cut "
            "the rows into shorter recordings."
        )
    _check(time, state, every)
    when = np.searchsorted(every, time)
    _, first, cell = np.unique(
        when * len(ids) + who, return_index=True, return_inverse=True
    )
    again = np.flatnonzero(first[cell] != np.arange(len(time)))
    if again.size:
        k = int(again[0])
        raise DataError(
            f"rows {first[cell[k]]} and {k}, counted from 0, are both of "
            f"{ids[who[k]]} at {time[k]:g} s; keep one of them."
        )
    placed = np.zeros((len(every), len(ids), state.shape[1]))
    exists = np.zeros((len(every), len(ids)), bool)
    placed[when, who], exists[when, who] = state, True
    # NumPy arrays, as 64 bits would be lost in jax's before float64 is switched on.
    return ids, Truth._make((placed, exists, every))


def _check(time: np.ndarray, state: np.ndarray, every: np.ndarray) -> None:
    """Refuses times without order and rows that cannot be placed."""
    back = np.diff(every) <= 0.0
    if back.any():
        k = int(np.argmax(back)) + 1
        raise ValueError(
            f"times[{k}] is {every[k]}, not after the one before it; sort the times."
        )
    wrong = ~np.isfinite(state).all(axis=1)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise DataError(
            f"row {k}, counted from 0, is {state[k]}; leave rows out that are not "
            "finite."
        )
    strange = ~np.isin(time, every)
    if strange.any():
        k = int(np.argmax(strange))
        raise DataError(
            f"row {k}, counted from 0, is of {time[k]:g} s, when there is no scan; "
            "interpolate it with scans.truth_at."
        )
