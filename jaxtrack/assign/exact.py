"""Exact association probabilities, by dynamic programming over subsets of tracks.

The detections are gone through one at a time, with one number for every subset of
tracks: the summed weight of all ways to give the detections so far to just these. That
takes K C 2^C steps where enumeration takes (K + 1)^C. C is not the number of all
tracks: tracks that share no detection, directly or through others, do not touch each
other, so each cluster of tracks starts anew, and C is the size of the largest.

The dual prices of the best joint event are taken off the scores first. No joint event
then weighs more than 1, and the best one 1 exactly, so the sums are made of plain
numbers that neither overflow nor vanish.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import exact
    >>> log_score = jnp.log(jnp.array([[1.0, 1.0], [1.0, 1.0]]))  # one detection
    >>> table = exact.exact(log_score)
    >>> print(jnp.round(table.prob, 3), jnp.round(jnp.exp(table.log_norm)))
    [[0.333 0.667]
     [0.333 0.667]] 3.0

A track too many for its cluster is never approximated here: it is marked.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.assign import clusters, subsets
from jaxtrack.assign.best import solvable
from jaxtrack.assign.lanes import lanes
from jaxtrack.types import Array

MAX_CLUSTER = 10
SIZES = 3, 6  # of smaller tables, where these are enough
WIDTH = 64  # problems whose tables are filled side by side, so that they stay in cache


class Exact(NamedTuple):
    """Sums over all joint events.

    Attributes:
        prob: Probability of each column for each track, [N, K + 1]; zero rows for
            tracks that are not `exact` or if nothing is feasible.
        log_norm: Log of the summed weight of all joint events of the tracks that are
            `exact`; -inf if nothing is feasible.
        exact: Whether the track's cluster was small enough, [N] (bool).
        feasible: Whether a joint event of positive weight exists (bool).
    """

    prob: Array
    log_norm: Array
    exact: Array
    feasible: Array


def exact(log_score: Array, max_cluster: int = MAX_CLUSTER) -> Exact:
    """Sums over all joint events, exactly, cluster by cluster.

    The derivatives are those of the exact sums, to any order; by a score of -inf they
    are zero.

    Args:
        log_score: [N, K + 1], the miss last, -inf where impossible.
        max_cluster: C, tracks in a cluster at most; each one more doubles the work and
            the memory, K 2^C numbers.

    Raises:
        ValueError: The largest cluster is not from 1 to 20.
    """
    if not 1 <= max_cluster <= 20:
        raise ValueError(f"max_cluster is {max_cluster}; give 1 to 20")
    size = min(max_cluster, log_score.shape[0])
    scores, found = solvable(log_score)
    prices = found.track_price, found.detection_price
    prob, log_norm, fits = _marginals(size, scores, *prices)
    return Exact(
        prob=jnp.where(found.feasible, prob, 0.0),
        log_norm=jnp.where(found.feasible, log_norm, -jnp.inf),
        exact=fits,
        feasible=found.feasible,
    )


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _marginals(
    size: int, log_score: Array, track_price: Array, detection_price: Array
) -> tuple[Array, Array, Array]:
    """Returns `prob`, `log_norm` and `exact` of what is feasible."""
    return _many(size)(log_score, track_price, detection_price)


@_marginals.defjvp
def _(size: int, primals: tuple, tangents: tuple) -> tuple:
    """Differentiates: the log-norm by its probabilities, and these by their sums."""
    log_score, *prices = primals
    slope = tangents[0]
    prob, log_norm, fits = _marginals(size, *primals)

    def again(log_score: Array) -> Array:
        one = (x[..., None] for x in (log_score, *prices))
        return _solve(size, False, *one)[0][..., 0]

    prob_slope = jax.jvp(again, (log_score,), (slope,))[1]
    norm_slope = jnp.where(prob > 0, prob * slope, 0.0).sum()
    none = np.zeros(fits.shape, jax.dtypes.float0)
    return (prob, log_norm, fits), (prob_slope, norm_slope, none)


@functools.cache
def _many(size: int) -> Callable[..., tuple[Array, Array, Array]]:
    """Makes the solver of one problem from that of many."""
    return lanes(functools.partial(_solve, size, True), 1024)


def _solve(
    size: int, adapt: bool, log_score: Array, track_price: Array, detection_price: Array
) -> tuple[Array, Array, Array]:
    """Sums over the joint events of R problems.

    Args:
        size: C.
        adapt: Whether to go down to the size of the largest cluster there is.
        log_score: [N, K + 1, R].
        track_price: [N, R].
        detection_price: [K, R].
    """
    weight = jnp.exp(log_score[:, :-1] - track_price[:, None] - detection_price[None])
    miss = jnp.exp(log_score[:, -1] - track_price)
    spare = jnp.exp(-detection_price)
    order = clusters.steps(weight > 0, size)
    if adapt:
        raw = _sorted(size, order.size, (weight, miss, spare, order))
    else:
        raw = _tabulate(size, False, weight, miss, spare, order)
    norm = raw.sum(1)
    counts = order.shared & (order.bit == 0)
    safe = jnp.where(counts, norm, 1.0)
    prices = jnp.where(order.fits, track_price, 0.0).sum(0)
    prices = prices + jnp.where(order.inside, detection_price, 0.0).sum(0)
    prob = jnp.where(
        order.fits[:, None], raw / jnp.where(norm > 0, norm, 1.0)[:, None], 0.0
    )
    return prob, jnp.log(safe).sum(0) + prices, order.fits


def _sorted(size: int, largest: Array, problem: tuple) -> Array:
    """Calls `_tabulate`, for problems of small clusters with smaller tables.

    Args:
        size: C.
        largest: Size of each problem's largest cluster, [R].
        problem: Its arguments but the first.
    """
    sizes = [bits for bits in SIZES if bits < size] + [size]
    branches = [functools.partial(_tabulate, bits, True) for bits in sizes]

    def block(largest: Array, problem: tuple) -> Array:
        enough = (jnp.array(sizes) < largest.max()).sum()
        return jax.lax.switch(enough, branches, *problem)

    number = largest.size
    if number <= WIDTH:
        return block(largest, problem)
    # Alike ones side by side; the last block is filled up with the largest again.
    place = jnp.argsort(largest)
    count = -(-number // WIDTH)
    place = jnp.pad(place, (0, count * WIDTH - number), mode="edge")

    def one(chosen: Array) -> Array:
        return block(*jax.tree.map(lambda x: x[..., chosen], (largest, problem)))

    raw = jnp.moveaxis(jax.lax.map(one, place.reshape(count, WIDTH)), 0, -2)
    raw = raw.reshape(*raw.shape[:-2], count * WIDTH)
    return raw[..., jnp.argsort(place[:number])]


def _tabulate(
    num_bits: int,
    skips: bool,
    weight: Array,
    miss: Array,
    spare: Array,
    order: clusters.Steps,
) -> Array:
    """Sums the weights of all joint events of a cluster that have a track in a column.

    Returns:
        Not normalised, [N, K + 1, R].
    """
    if not spare.size:
        return miss[:, None]
    given = subsets.steps(num_bits, weight, miss, spare, order)
    pairs, lone = subsets.forward(given, subsets.backward(given), skips)

    number = weight.shape[-1]
    bit = jnp.minimum(order.bit, num_bits - 1)
    place = order.step[None] * num_bits + bit[:, None]  # [N, K, R]
    joined = (weight > 0) & order.fits[:, None]
    pair = jnp.where(joined, subsets.pick(pairs.reshape(-1, number), place), 0.0)
    place = jnp.maximum(order.end, 0) * num_bits + bit
    alone = subsets.pick(lone.reshape(-1, number), place)
    alone = jnp.where(order.shared, alone, miss)
    return jnp.concatenate([pair, alone[:, None]], 1)
