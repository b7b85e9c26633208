"""Places of detections in one flat table: what all solvers over several scans share.

>>> import jax.numpy as jnp
>>> from jaxtrack.assign.multiscan import slots
>>> log_score = jnp.array([[3.0, 0.0]])  # a tree with two leaves
>>> given = slots.slots(log_score, jnp.array([[[0, 1], [-1, -1]]]), 2)
>>> print(given.place.tolist())  # two detections a scan, then none
[[[0, 4], [2, 5]]]
>>> price = slots.flat(jnp.array([[1.0, 0.0], [0.0, 0.5]]))
>>> print(slots.after_paying(given, price))
[[1.5 0. ]]
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.types import Array

ROUNDING = 4.0  # errors of a sum


class Slots(NamedTuple):
    """A problem made ready: every detection has a place in one flat table.

    Attributes:
        log_score: [N, L], -inf where impossible, finite otherwise.
        place: Of each leaf's detections, [N, L, S], in a table of S (K + 1) numbers;
            the last of each scan's K + 1 stands for none.
        there: Whether a tree has a leaf, [N] (bool).
    """

    log_score: Array
    place: Array
    there: Array


def slots(log_score: Array, detection: Array, num_detections: int) -> Slots:
    """Makes a problem ready.

    Args:
        log_score: [N, L].
        detection: [N, L, S].
        num_detections: K, detections of a scan at most.
    """
    known = (detection < num_detections).all(-1)
    score = jnp.where(known & (jnp.abs(log_score) < jnp.inf), log_score, -jnp.inf)
    column = jnp.where((detection >= 0) & known[..., None], detection, num_detections)
    first = jnp.arange(detection.shape[-1]) * (num_detections + 1)
    place = (column + first[None, None]).astype(jnp.int32)
    return Slots(score, place, (score > -jnp.inf).any(1))


def flat(price: Array) -> Array:
    """Returns prices [S, K] as a table [S (K + 1)], in which to use none is free."""
    return jnp.pad(price, ((0, 0), (0, 1))).reshape(-1)


def unflat(table: Array, num_detections: int) -> Array:
    """Returns a table [S (K + 1)] as [S, K]."""
    return table.reshape(-1, num_detections + 1)[:, :-1]


def after_paying(given: Slots, table: Array) -> Array:
    """Returns the scores of leaves less the prices of their detections, [N, L]."""
    return given.log_score - table[given.place].sum(-1)


def used(given: Slots, share: Array, table: Array) -> Array:
    """Adds the shares of leaves [N, L] up over their detections: a table like `table`.

    The places of no detection stay zero.
    """
    num_scans = given.place.shape[-1]
    many = jnp.broadcast_to(share[..., None], given.place.shape)
    total = jnp.zeros_like(table).at[given.place].add(many)
    return total.reshape(num_scans, -1).at[:, -1].set(0).reshape(-1)


def gained(given: Slots, table: Array) -> Array:
    """Returns the bound that holds at these prices, none of which is negative."""
    best = after_paying(given, table).max(1, initial=-jnp.inf)
    return jnp.where(given.there, best, 0.0).sum() + table.sum()


def rounding(given: Slots) -> Array:
    """Returns by how much two sums of each tree's best score may differ by rounding."""
    best = jnp.where(given.there, given.log_score.max(1, initial=-jnp.inf), 0.0)
    return ROUNDING * jnp.finfo(best.dtype).eps * jnp.abs(best).sum()


def judge(given: Slots, leaf: Array, num_places: int) -> tuple[Array, Array]:
    """Returns the sum of scores of leaves [N], and whether they are feasible."""
    chosen = jnp.maximum(leaf, 0)[:, None]
    score = jnp.take_along_axis(given.log_score, chosen, axis=1)[:, 0]
    place = jnp.take_along_axis(given.place, chosen[..., None], axis=1)[:, 0]
    count = jnp.zeros(num_places, jnp.int32).at[place].add((leaf >= 0)[:, None])
    num_scans = place.shape[-1]
    once = (count.reshape(num_scans, -1)[:, :-1] <= 1).all()
    every = jnp.where(leaf >= 0, score > -jnp.inf, ~given.there).all()
    feasible = once & every
    total = jnp.where(feasible & (leaf >= 0), score, 0.0).sum()
    return jnp.where(feasible, total, -jnp.inf), feasible


def scan_matrix(given: Slots, worth: Array, num_detections: int, scan: int) -> Array:
    """Returns each tree's best worth with each detection of a scan, [N, K + 1].

    The last column is that without any of them; an empty tree has a 0 there.
    """
    column = given.place[..., scan] - scan * (num_detections + 1)
    trees = jnp.arange(len(worth))[:, None]
    matrix = jnp.full((len(worth), num_detections + 1), -jnp.inf, worth.dtype)
    matrix = matrix.at[trees, column].max(worth)
    return matrix.at[:, -1].set(jnp.where(given.there, matrix[:, -1], 0.0))


def leaves_in(
    given: Slots, worth: Array, num_detections: int, scan: int, column: Array
) -> Array:
    """Returns each tree's best leaf that uses a detection [N] of a scan, K for none."""
    there = given.place[..., scan] - scan * (num_detections + 1) == column[:, None]
    return jnp.argmax(jnp.where(there, worth, -jnp.inf), axis=1)
