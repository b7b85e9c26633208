"""Pairs the members of two masked sets exactly, for `ospa`, `gospa` and `ospa2`.

The solver is `jaxtrack.assign.best`. Both metrics charge a pair min(d, c)^p, d the
Euclidean distance and c the cut-off, and both are least under the same pairing: as many
pairs as the smaller set has members, with the least sum of min(d, c)^p.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import assignment
    >>> left, right = jnp.array([[0.0], [3.0]]), jnp.array([[4.0], [1.0]])
    >>> both = jnp.array([True, True])
    >>> print(assignment.match(left, both, right, both, 10.0, 2.0).distance)
    [1. 1.]
"""

import math
from typing import NamedTuple

import chex
import jax.numpy as jnp

from jaxtrack.assign.best import best
from jaxtrack.types import Array


class Pairs(NamedTuple):
    """The best pairing of N truth slots with L estimate slots.

    Attributes:
        distance: Of each truth slot to its partner, [N]; the cut-off where not `close`.
        close: Both partners exist and are nearer than the cut-off, [N] (bool).
        num_truth: How many truths exist.
        num_estimate: How many estimates exist.
    """

    distance: Array
    close: Array
    num_truth: Array
    num_estimate: Array


def distances(left: Array, right: Array) -> Array:
    """Returns the Euclidean distances [N, L] of points [N, P] from points [L, P].

    The gradient at coincident points is zero.
    """
    gap = left[:, None] - right[None]
    square = (gap * gap).sum(-1)
    apart = square != 0
    return jnp.where(apart, jnp.sqrt(jnp.where(apart, square, 1)), 0)


def match(
    truth: Array,
    truth_exists: Array,
    estimate: Array,
    estimate_exists: Array,
    cutoff: Array | float,
    order: Array | float,
) -> Pairs:
    """Pairs two masked sets of points at least total min(distance, cutoff)^order.

    What stands in an empty slot changes nothing. A point that is not finite is as far
    from all others as the cut-off.

    Args:
        truth: [N, P].
        truth_exists: [N] (bool).
        estimate: [L, P].
        estimate_exists: [L] (bool).
        cutoff: Positive, in the unit of the points.
        order: At least 1.

    Returns:
        The pairs, ordered by truth slot.
    """
    check(cutoff, order)
    (num_truth, dim), num_estimate = truth.shape, estimate.shape[0]
    chex.assert_shape(truth_exists, (num_truth,))
    chex.assert_shape(estimate, (num_estimate, dim))
    chex.assert_shape(estimate_exists, (num_estimate,))

    distance = distances(
        jnp.where(truth_exists[:, None], truth, 0),
        jnp.where(estimate_exists[:, None], estimate, 0),
    )
    return pair(distance, truth_exists, estimate_exists, cutoff, order)


def pair(
    distance: Array,
    truth_exists: Array,
    estimate_exists: Array,
    cutoff: Array | float,
    order: Array | float,
) -> Pairs:
    """Pairs two masked sets of anything, of which all distances are known.

    Args:
        distance: [N, L].
        truth_exists: [N] (bool).
        estimate_exists: [L] (bool).
        cutoff: Positive, in the unit of the distance.
        order: At least 1.

    Returns:
        The pairs, ordered by truth slot.
    """
    both = truth_exists[:, None] & estimate_exists[None]
    # What is not close stays without a partner, at the price of the cut-off: 1 in
    # units of it, in which float32 carries any scale.
    close = both & (distance < cutoff)
    relative = jnp.where(close, (jnp.where(close, distance, 0) / cutoff) ** order, 1)
    price = jnp.where(close, -relative, -jnp.inf)
    column = best(jnp.pad(price, ((0, 0), (0, 1)), constant_values=-1)).column

    row = jnp.arange(len(distance))
    close = jnp.pad(close, ((0, 0), (0, 1)))
    distance = jnp.where(close, jnp.pad(distance, ((0, 0), (0, 1))), cutoff)
    return Pairs(
        distance=distance[row, column],
        close=close[row, column],
        num_truth=truth_exists.sum(),
        num_estimate=estimate_exists.sum(),
    )


def root(power: Array, order: Array | float) -> Array:
    """Returns power ** (1 / order), with gradient zero (not infinite) at zero."""
    positive = power > 0
    return jnp.where(positive, jnp.where(positive, power, 1) ** (1 / order), 0)


def check(cutoff: Array | float, order: Array | float) -> None:
    """Raises ValueError for a cut-off or an order that no metric has.

    Only Python numbers are looked at; inside traced code nothing raises.
    """
    if isinstance(cutoff, (int, float)) and not 0 < cutoff < math.inf:
        raise ValueError(f"cutoff is {cutoff}; it must be positive and finite.")
    if isinstance(order, (int, float)) and not 1 <= order < math.inf:
        raise ValueError(f"order is {order}; it must be at least 1 and finite.")
