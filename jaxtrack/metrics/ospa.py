"""OSPA: how far a set of estimates is from the set of true positions, in metres.

With n <= m the sizes of the two sets, the smaller first (the metric is symmetric),

    distance^p = (min over pairings of sum min(d, c)^p + c^p (m - n)) / m

where d is the Euclidean distance of a pair, c the cut-off and p the order. The
assignment is made on min(d, c)^p, as the metric is defined, not on d. The solver is
exact: see `jaxtrack.metrics.assignment`.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import ospa
    >>> truth = jnp.array([[0.0, 0.0], [3.0, 0.0]])
    >>> estimate = jnp.array([[3.2, 0.0], [6.0, 0.0]])
    >>> both = jnp.array([True, True])
    >>> distance = ospa.ospa(truth, both, estimate, both, cutoff=10).distance
    >>> print(f"{distance:.3f}")
    3.102

Reference: Schuhmacher, Vo and Vo, "A consistent metric for performance evaluation of
multi-object filters", IEEE Trans. Signal Processing 56(8), 2008, eq. 3 and 4 and
section III-C.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.metrics import assignment
from jaxtrack.types import Array


class Ospa(NamedTuple):
    """An OSPA distance and its parts: distance^p = localisation^p + cardinality^p.

    Attributes:
        distance: From 0 to the cut-off, in the unit of the points.
        localisation: The part due to errors of position within pairs.
        cardinality: The part due to the difference in number.
    """

    distance: Array
    localisation: Array
    cardinality: Array


def ospa(
    truth: Array,
    truth_exists: Array,
    estimate: Array,
    estimate_exists: Array,
    cutoff: Array | float,
    order: Array | float = 2.0,
) -> Ospa:
    """Measures the OSPA distance of two masked sets of points.

    Padding, and the order of slots, change nothing. Two empty sets are at distance 0,
    an empty set and any other at the cut-off. Gradients are finite, also where points
    coincide; the assignment counts as constant in them.

    Args:
        truth: [N, P].
        truth_exists: Which slots hold a truth, [N] (bool).
        estimate: [L, P].
        estimate_exists: Which slots hold an estimate, [L] (bool).
        cutoff: c, positive, in the unit of the points.
        order: p, at least 1 and finite.

    Returns:
        Three scalars.
    """
    pairs = assignment.match(
        truth, truth_exists, estimate, estimate_exists, cutoff, order
    )
    return of_pairs(pairs, cutoff, order)


def of_pairs(
    pairs: assignment.Pairs, cutoff: Array | float, order: Array | float
) -> Ospa:
    """Measures the OSPA distance of two sets that are paired.

    Args:
        pairs: From `jaxtrack.metrics.assignment`, with the same cut-off and order.
        cutoff: c.
        order: p.

    Returns:
        Three scalars.
    """
    larger = jnp.maximum(pairs.num_truth, pairs.num_estimate)
    smaller = jnp.minimum(pairs.num_truth, pairs.num_estimate)

    num_far = smaller - pairs.close.sum()
    relative = jnp.where(pairs.close, pairs.distance / cutoff, 0)
    share = 1 / jnp.maximum(larger, 1).astype(relative.dtype)
    localisation = share * ((relative**order).sum() + num_far)
    cardinality = share * (larger - smaller)
    return Ospa(
        distance=cutoff * assignment.root(localisation + cardinality, order),
        localisation=cutoff * assignment.root(localisation, order),
        cardinality=cutoff * assignment.root(cardinality, order),
    )
