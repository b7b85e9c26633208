"""OSPA(2): the OSPA distance of two sets of tracks over a window of time.

The base distance of two tracks is the mean OSPA distance of what they are at the times
at which one of them is there: with d the Euclidean distance,

    base^q = mean, over times at which either exists, of min(d, c)^q if both exist and
             of c^q if only one does

and on it, with the same cut-off c, goes the OSPA distance of order p. The two orders
are the same unless told otherwise, as in the authors' code; other codes take q = 1. A
track that exists at no time of the window is none.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import ospa2
    >>> truth, alive = jnp.zeros((4, 1, 2)), jnp.ones((4, 1), bool)
    >>> halves = jnp.array([[1, 0], [1, 0], [0, 1], [0, 1]]) > 0  # broken in two
    >>> tracks = jnp.zeros((4, 2, 2))
    >>> print(ospa2.ospa2(truth, alive, tracks, halves, 10.0, order=1.0).distance)
    7.5

Reference: Beard, Vo and Vo, "A solution for large-scale multi-object tracking", IEEE
Trans. Signal Processing 68, 2020, section IV.
"""

import chex
import jax
import jax.numpy as jnp

from jaxtrack.metrics import assignment
from jaxtrack.metrics.ospa import Ospa, of_pairs
from jaxtrack.types import Array


def ospa2(
    truth: Array,
    truth_alive: Array,
    estimate: Array,
    estimate_alive: Array,
    cutoff: Array | float,
    order: Array | float = 2.0,
    inner_order: Array | float | None = None,
    weight: Array | None = None,
) -> Ospa:
    """Measures the OSPA(2) distance of two sets of tracks over all times given.

    Args:
        truth: [T, N, P].
        truth_alive: When each exists, [T, N] (bool).
        estimate: [T, L, P].
        estimate_alive: [T, L] (bool).
        cutoff: c, positive, in the unit of the points.
        order: p, at least 1 and finite.
        inner_order: q, of the mean over time; p if None.
        weight: Of each time in the mean, not negative, [T]; all alike if None.

    Returns:
        Three scalars; the localisation holds all that is within pairs of tracks.
    """
    inner_order = order if inner_order is None else inner_order
    assignment.check(cutoff, order)
    assignment.check(cutoff, inner_order)
    weight = jnp.ones(len(truth), truth.dtype) if weight is None else weight
    chex.assert_shape(weight, (len(truth),))
    distance = _base(
        truth, truth_alive, estimate, estimate_alive, weight, cutoff, inner_order
    )
    counts = (weight > 0)[:, None]
    exists = (truth_alive & counts).any(0), (estimate_alive & counts).any(0)
    pairs = assignment.pair(distance, *exists, cutoff, order)
    return of_pairs(pairs, cutoff, order)


def over_time(
    truth: Array,
    truth_alive: Array,
    estimate: Array,
    estimate_alive: Array,
    cutoff: Array | float,
    window: int,
    order: Array | float = 2.0,
    inner_order: Array | float | None = None,
) -> Ospa:
    """Measures, at each time, the OSPA(2) distance over the last `window` times.

    Args:
        truth: [T, N, P].
        truth_alive: [T, N] (bool).
        estimate: [T, L, P].
        estimate_alive: [T, L] (bool).
        cutoff: As of `ospa2`, and so are the orders.
        window: Number of times, this one included; at first there are fewer.
        order: See there.
        inner_order: See there.

    Returns:
        Three arrays [T].
    """
    if window < 1:
        raise ValueError(f"window is {window}; give at least 1.")
    before = (window - 1, 0), (0, 0)
    alive = jnp.pad(truth_alive, before), jnp.pad(estimate_alive, before)
    points = [jnp.pad(x, (*before, (0, 0))) for x in (truth, estimate)]

    def one(begin: Array) -> Ospa:
        sets = points[0], alive[0], points[1], alive[1]
        cut = [jax.lax.dynamic_slice_in_dim(x, begin, window) for x in sets]
        return ospa2(cut[0], cut[1], cut[2], cut[3], cutoff, order, inner_order)

    return jax.vmap(one)(jnp.arange(len(truth)))


def _base(
    truth: Array,
    truth_alive: Array,
    estimate: Array,
    estimate_alive: Array,
    weight: Array,
    cutoff: Array | float,
    inner_order: Array | float,
) -> Array:
    """Returns the distance of each pair of tracks, [N, L]."""
    distance = jax.vmap(assignment.distances)(
        jnp.where(truth_alive[..., None], truth, 0),
        jnp.where(estimate_alive[..., None], estimate, 0),
    )
    left, right = truth_alive[:, :, None], estimate_alive[:, None]
    close = left & right & (distance < cutoff)
    cost = (jnp.where(close, distance, 0) / cutoff) ** inner_order
    share = jnp.where(left | right, weight[:, None, None], 0)
    total = share.sum(0)
    mean = (share * jnp.where(close, cost, 1)).sum(0) / jnp.where(total > 0, total, 1)
    return cutoff * assignment.root(mean, inner_order)
