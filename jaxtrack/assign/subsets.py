"""Sums over subsets of the tracks of a cluster, one detection after another.

The dynamic programme behind `exact` and `sample`: one number for each of the 2^C
subsets of tracks, plain weights scaled so that none overflows. `backward` goes through
the steps of `clusters.steps` from the last, `forward` from the first.

All functions are for R problems, the last axis (see `jaxtrack.assign.lanes`).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import clusters, subsets
    >>> weight = jnp.full((2, 1, 1), 0.5)  # two tracks, one detection
    >>> order = clusters.steps(weight > 0, 2)
    >>> steps = subsets.steps(2, weight, jnp.ones((2, 1)), jnp.ones((1, 1)), order)
    >>> pairs, alone = subsets.forward(steps, subsets.backward(steps))
    >>> print(pairs[..., 0], alone[..., 0])
    [[0.5 0.5]] [[1.5 1.5]]
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign import clusters
from jaxtrack.types import Array


class Step(NamedTuple):
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


def steps(
    num_bits: int, weight: Array, miss: Array, spare: Array, order: clusters.Steps
) -> Step:
    """Gathers the weights that each step needs, [K, ..., R].

    Args:
        num_bits: C, at least the number of tracks in the largest cluster.
        weight: [N, K, R].
        miss: [N, R].
        spare: Of detections that no track takes, [K, R].
        order: Of `clusters.steps`.
    """
    _, num_items, number = weight.shape
    member, there = order.member[:, :num_bits], order.there[:, :num_bits]
    index = member * num_items + order.item[:, None]
    return Step(
        weight=jnp.where(there, pick(weight.reshape(-1, number), index), 0.0),
        miss=jnp.where(there, pick(miss, member), 1.0),
        spare=pick(spare, order.item),
        used=order.used,
        first=order.first,
        last=order.last,
    )


def pick(table: Array, index: Array) -> Array:
    """Returns the entries of a table [L, R] at an index [..., R]."""
    flat = jnp.take_along_axis(table, index.reshape(-1, index.shape[-1]), axis=0)
    return flat.reshape(index.shape)


def backward(steps: Step) -> Array:
    """Returns the weight of all that may come after a step, [K, 2^C, R].

    It depends on the subset of tracks that have a detection by then.
    """

    def one(after: Array, step: Step) -> tuple[Array, Array]:
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


def forward(steps: Step, after: Array, skips: bool = True) -> tuple[Array, Array]:
    """Sums over all subsets of tracks that have a detection before a step.

    Args:
        steps: [K, ...].
        after: Of `backward`.
        skips: Whether to leave out what is needed at the end of a cluster only, where
            no problem is at one. Slopes of many by `vmap` cannot: JAX has no transpose
            of the choice.

    Returns:
        Weight of all joint events in which the step's detection goes to a track, and of
        those in which the track has none (at a cluster's last step), both [K, C, R].
    """
    _, num_bits, number = steps.weight.shape
    empty = jnp.zeros((1 << num_bits, number), after.dtype).at[0].set(1.0)

    def one(before: Array, given: tuple[Step, Array]) -> tuple[Array, tuple]:
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
        # Apart, so that it is computed at the end of a cluster only, from what is done.
        needed = step.last.any() if skips else True
        lone = jax.lax.cond(needed, _lone, _none, grown, after)
        before = jnp.where(step.used[None], grown, before)
        return before, (jnp.stack(pairs), lone)

    return jax.lax.scan(one, empty, (steps, after))[1]


def _closing(miss: Array) -> Array:
    """Returns the weight of a miss of all tracks that are not in a subset, [2^C, R]."""
    weight = jnp.ones_like(miss[:1])
    for one in miss:
        weight = jnp.concatenate([weight * one[None], weight])
    return weight


def _lone(before: Array, after: Array) -> Array:
    """Returns for each track the sum over the subsets without it, [C, R]."""
    weight, sums = before * after, []
    while weight.shape[0] > 1:
        low, high = jnp.split(weight, 2)
        sums.append(low.sum(0))
        weight = low + high
    return jnp.stack(sums[::-1])


def _none(before: Array, after: Array) -> Array:
    """Returns zeros in the place of `_lone`."""
    size, number = before.shape
    return jnp.zeros((size.bit_length() - 1, number), before.dtype)


def _halves(subsets: Array, bit: int) -> tuple[Array, Array]:
    """Returns [2^C, R] without and with a track, both [2^(C - bit - 1), 2^bit, R]."""
    size, number = subsets.shape
    apart = subsets.reshape(size >> (bit + 1), 2, 1 << bit, number)
    return apart[:, 0], apart[:, 1]


def _join(without: Array, having: Array) -> Array:
    """Undoes `_halves`."""
    return jnp.stack([without, having], 1).reshape(-1, without.shape[-1])
