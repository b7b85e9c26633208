"""GOSPA: localisation error plus a price for every missed and every false target.

With alpha = 2, the only choice that separates missed from false targets,

    distance^p = min over pairings of
                 sum of d^p over the pairs + c^p / 2 (num_missed + num_false)

where d is the Euclidean distance, c the cut-off, p the order, and a pair is a truth
and an estimate nearer than c. Unlike OSPA it is not divided by the number of targets.
The solver is exact: see `jaxtrack.metrics.assignment`.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import gospa
    >>> truth = jnp.array([[0.0, 0.0], [50.0, 0.0]])
    >>> estimate = jnp.array([[3.0, 4.0]])
    >>> yes = jnp.array([True, True])
    >>> score = gospa.gospa(truth, yes, estimate, yes[:1], cutoff=10)
    >>> print(score.localisation, score.missed, score.num_missed, score.num_false)
    25.0 50.0 1 0

Reference: Rahmathullah, Garcia-Fernandez and Svensson, "Generalized optimal
sub-pattern assignment metric", Int. Conf. on Information Fusion, 2017, definition 1
and proposition 1.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.metrics import assignment
from jaxtrack.types import Array


class Gospa(NamedTuple):
    """A GOSPA distance and its parts: distance^p = localisation + missed + false.

    The parts are kept to the p-th power, so that they add up; only the distance has
    the unit of the points.

    Attributes:
        distance: In the unit of the points.
        localisation: Sum of d^p over the pairs.
        missed: c^p / 2 for every missed target.
        false: c^p / 2 for every false target.
        num_missed: Truths without a partner (int).
        num_false: Estimates without a partner (int).
    """

    distance: Array
    localisation: Array
    missed: Array
    false: Array
    num_missed: Array
    num_false: Array


class Rmse(NamedTuple):
    """A root mean square error of position, and over how many pairs it is taken.

    Attributes:
        error: In the unit of the points; 0 if there is no pair.
        num_pairs: Pairs nearer than the cut-off (int). Weigh by it when averaging.
    """

    error: Array
    num_pairs: Array


def gospa(
    truth: Array,
    truth_exists: Array,
    estimate: Array,
    estimate_exists: Array,
    cutoff: Array | float,
    order: Array | float = 2.0,
) -> Gospa:
    """Measures the GOSPA distance of two masked sets of points, alpha = 2.

    Padding, and the order of slots, change nothing. Gradients are finite, also where
    points coincide; the assignment counts as constant in them.

    Args:
        truth: [N, P].
        truth_exists: Which slots hold a truth, [N] (bool).
        estimate: [L, P].
        estimate_exists: Which slots hold an estimate, [L] (bool).
        cutoff: c, positive, in the unit of the points.
        order: p, at least 1 and finite.

    Returns:
        Six scalars.
    """
    pairs = assignment.match(
        truth, truth_exists, estimate, estimate_exists, cutoff, order
    )
    num_missed = pairs.num_truth - pairs.close.sum()
    num_false = pairs.num_estimate - pairs.close.sum()

    # In units of the cut-off up to the root, so that float32 carries any scale.
    relative = (jnp.where(pairs.close, pairs.distance / cutoff, 0) ** order).sum()
    total = relative + (num_missed + num_false).astype(relative.dtype) / 2
    price = jnp.asarray(cutoff, relative.dtype) ** order
    return Gospa(
        distance=cutoff * assignment.root(total, order),
        localisation=price * relative,
        missed=price / 2 * num_missed,
        false=price / 2 * num_false,
        num_missed=num_missed,
        num_false=num_false,
    )


def rmse(
    truth: Array,
    truth_exists: Array,
    estimate: Array,
    estimate_exists: Array,
    cutoff: Array | float,
) -> Rmse:
    """Measures the root mean square distance of the pairs that GOSPA makes at p = 2.

    Missed and false targets do not count, so it goes with a count of them.

    Args:
        truth: [N, P].
        truth_exists: Which slots hold a truth, [N] (bool).
        estimate: [L, P].
        estimate_exists: Which slots hold an estimate, [L] (bool).
        cutoff: Truth and estimate at this distance or more are no pair.

    Returns:
        Two scalars.
    """
    pairs = assignment.match(truth, truth_exists, estimate, estimate_exists, cutoff, 2)
    num_pairs = pairs.close.sum()
    square = jnp.where(pairs.close, pairs.distance**2, 0).sum()
    error = assignment.root(square / jnp.maximum(num_pairs, 1), 2)
    return Rmse(error, num_pairs)
