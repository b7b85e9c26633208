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
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.assign import clusters
from jaxtrack.assign.best import best
from jaxtrack.assign.lanes import lanes
from jaxtrack.types import Array

MAX_CLUSTER = 10
WIDTH = 64  # problems side by side, so that their tables stay in the cache


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
    found = best(log_score)
    # Where nothing is feasible, all tracks are missed at no price instead.
    missed = jnp.full(log_score.shape, -jnp.inf).at[:, -1].set(0.0)
    missed = missed.astype(log_score.dtype)
    scores = jnp.where(found.feasible, log_score, missed)
    prices = (
        jnp.where(found.feasible, found.track_price, 0.0),
        jnp.where(found.feasible, found.detection_price, 0.0),
    )
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
def _many(size: int):
    """Makes the solver of one problem from that of many."""
    return lanes(functools.partial(_solve, size, True), WIDTH)


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
        sizes = [*range(2, size, 2), size]
        branches = [functools.partial(_tabulate, bits) for bits in sizes]
        enough = (jnp.array(sizes) < order.size.max()).sum()
        raw = jax.lax.switch(enough, branches, weight, miss, spare, order)
    else:
        raw = _tabulate(size, weight, miss, spare, order)
    norm = raw.sum(1)
    counts = order.shared & (order.bit == 0)
    safe = jnp.where(counts, norm, 1.0)
    prices = jnp.where(order.fits, track_price, 0.0).sum(0)
    prices = prices + jnp.where(order.inside, detection_price, 0.0).sum(0)
    prob = jnp.where(
        order.fits[:, None], raw / jnp.where(norm > 0, norm, 1.0)[:, None], 0.0
    )
    return prob, jnp.log(safe).sum(0) + prices, order.fits


def _tabulate(
    num_bits: int, weight: Array, miss: Array, spare: Array, order: clusters.Steps
) -> Array:
    """Sums the weights of all joint events of a cluster that have a track in a column.

    Returns:
        Not normalised, [N, K + 1, R].
    """
    num_tracks, num_items, number = weight.shape
    if not num_items:
        return miss[:, None]

    def pick(table: Array, index: Array) -> Array:
        """Returns table [L, R] at an index [..., R]."""
        flat = jnp.take_along_axis(table, index.reshape(-1, number), axis=0)
        return flat.reshape(index.shape)

    member, there = order.member[:, :num_bits], order.there[:, :num_bits]
    flat = weight.reshape(-1, number)
    index = member * num_items + order.item[:, None]
    own = jnp.where(there, pick(flat, index), 0.0)  # [K, C, R]
    misses = jnp.where(there, pick(miss, member), 1.0)
    given = _Step(
        own, misses, pick(spare, order.item), order.used, order.first, order.last
    )
    pairs, lone = _forward(given, _backward(given))

    bit = jnp.minimum(order.bit, num_bits - 1)
    place = order.step[None] * num_bits + bit[:, None]  # [N, K, R]
    joined = (weight > 0) & order.fits[:, None]
    pair = jnp.where(joined, pick(pairs.reshape(-1, number), place), 0.0)
    place = jnp.maximum(order.end, 0) * num_bits + bit
    alone = pick(lone.reshape(-1, number), place)
    alone = jnp.where(order.shared, alone, miss)
    return jnp.concatenate([pair, alone[:, None]], 1)


class _Step(NamedTuple):
    """A detection; see `clusters.Steps`. With a leading axis, many.

    Attributes:
        weight: Of each bit, [C, R].
        miss: Weight of a miss of each bit, 1 for bits that are not there, [C, R].
        spare: Weight of the detection if no track takes it, [R].
        used: [R] (bool).
        first: [R] (bool).
        last: [R] (bool).
    """

    weight: Array
    miss: Array
    spare: Array
    used: Array
    first: Array
    last: Array


def _backward(steps: _Step) -> Array:
    """Returns the weight of all that may come after a step, [K, 2^C, R].

    It depends on the subset of tracks that have a detection by then.
    """

    def one(after: Array, step: _Step) -> tuple[Array, Array]:
        after = jnp.where(step.last[None], _closing(step.miss), after)
        before = after * step.spare[None]
        for bit, weight in enumerate(step.weight):
            _, high = _halves(after, bit)
            kept, held = _halves(before, bit)
            before = _join(kept + high * weight[None, None], held)
        return jnp.where(step.used[None], before, after), after

    _, num_bits, number = steps.weight.shape
    start = jnp.zeros((1 << num_bits, number), steps.weight.dtype)
    return jax.lax.scan(one, start, steps, reverse=True)[1]


def _forward(steps: _Step, after: Array) -> tuple[Array, Array]:
    """Sums over all subsets of tracks that have a detection before a step.

    Returns:
        Weight of all joint events in which the step's detection goes to a track, and of
        those in which the track has none (at a cluster's last step), both [K, C, R].
    """
    _, num_bits, number = steps.weight.shape
    empty = jnp.zeros((1 << num_bits, number), after.dtype).at[0].set(1.0)

    def one(before: Array, given: tuple[_Step, Array]) -> tuple[Array, tuple]:
        step, after = given
        before = jnp.where(step.first[None], empty, before)
        grown = before * step.spare[None]
        pairs = []
        for bit, weight in enumerate(step.weight):
            low, _ = _halves(before, bit)
            _, high = _halves(after, bit)
            pairs.append((low * high).sum((0, 1)) * weight)
            kept, held = _halves(grown, bit)
            grown = _join(kept, held + low * weight[None, None])
        lone = _lone(grown * after)
        before = jnp.where(step.used[None], grown, before)
        return before, (jnp.stack(pairs), lone)

    return jax.lax.scan(one, empty, (steps, after))[1]


def _closing(miss: Array) -> Array:
    """Returns the weight of a miss of all tracks that are not in a subset, [2^C, R]."""
    weight = jnp.ones_like(miss[:1])
    for one in miss:
        weight = jnp.concatenate([weight * one[None], weight])
    return weight


def _lone(weight: Array) -> Array:
    """Returns for each track the sum over the subsets without it, [C, R]."""
    sums = []
    while weight.shape[0] > 1:
        low, high = jnp.split(weight, 2)
        sums.append(low.sum(0))
        weight = low + high
    return jnp.stack(sums[::-1])


def _halves(subsets: Array, bit: int) -> tuple[Array, Array]:
    """Returns [2^C, R] without and with a track, both [2^(C - bit - 1), 2^bit, R]."""
    size, number = subsets.shape
    apart = subsets.reshape(size >> (bit + 1), 2, 1 << bit, number)
    return apart[:, 0], apart[:, 1]


def _join(without: Array, having: Array) -> Array:
    """Undoes `_halves`."""
    return jnp.stack([without, having], 1).reshape(-1, without.shape[-1])
