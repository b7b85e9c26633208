"""Pairs the members of two masked sets of points exactly, for `ospa` and `gospa`.

The solver is `optax.assignment.hungarian_algorithm`: exact, cubic in the number of
slots, jitted. Both metrics charge a pair min(d, c)^p, d the Euclidean distance and c
the cut-off, and both are least under the same pairing: as many pairs as the smaller
set has members, with the least sum of min(d, c)^p.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import assignment
    >>> print(assignment.best(jnp.array([[4.0, 1.0], [2.0, 0.0]])))
    [1 0]
"""

import math
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import optax

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


def best(cost: Array) -> Array:
    """Finds the assignment with the least total cost, exactly.

    The answer is a choice, so no gradient flows through it; that of the sum of the
    chosen costs is right wherever the best assignment is unique.

    Args:
        cost: Finite costs, [N, L] with N <= L.

    Returns:
        The column of each row, [N], all different.
    """
    num_rows, num_columns = cost.shape
    if num_rows > num_columns:
        raise ValueError(
            f"cost has {num_rows} rows and {num_columns} columns; transpose it, as "
            f"every row needs a column of its own."
        )
    rows, columns = optax.assignment.hungarian_algorithm(jax.lax.stop_gradient(cost))
    return jnp.zeros(num_rows, columns.dtype).at[rows].set(columns)


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

    both = truth_exists[:, None] & estimate_exists[None]
    distance = distances(
        jnp.where(truth_exists[:, None], truth, 0),
        jnp.where(estimate_exists[:, None], estimate, 0),
    )

    # Each truth has a column of its own that stands for "no partner", at the price of
    # the cut-off; all that is not close costs more, so the solver does not dwell on it.
    alone = jnp.eye(num_truth, num_estimate + num_truth, num_estimate, dtype=bool)
    close = jnp.pad(both & (distance < cutoff), ((0, 0), (0, num_truth)))
    distance = jnp.pad(distance, ((0, 0), (0, num_truth)))
    distance = jnp.where(close, distance, cutoff)
    # In units of the cut-off, so that float32 carries any scale.
    relative = (distance / cutoff) ** order
    column = best(jnp.where(close, relative, jnp.where(alone, 1.0, 2.0)))

    row = jnp.arange(num_truth)
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
