"""Tracks under one label as alternatives for one target: merged, and reported once.

A missed and an updated track of the same target carry one label. Where each lies within
the other's covariance they are one track; where not, the label is reported if its
tracks exist with enough probability all together, at the likeliest of them.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import alternatives
    >>> from jaxtrack.trackers.bernoulli import Tracks
    >>> split = Tracks(jnp.array([0.4, 0.3, 0.2]), None, jnp.array([5, 5, 8]),
    ...                jnp.full(3, -1))
    >>> print(alternatives.heirs(split, threshold=0.6))
    [ True False False]
"""

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.types import Array, Gaussian, Target

MOST = 8  # tracks under one label that a track is compared with


def merge(target: Target, tracks: Tracks, threshold: float) -> Tracks:
    """Merges tracks under one label that lie within each other's covariance.

    The likeliest track leads and takes in those that are free; their probabilities
    add up, to 1 at most, and their beliefs collapse into one.

    Args:
        target: How one target is filtered.
        tracks: N tracks, likeliest first.
        threshold: Squared Mahalanobis distance, by the covariance of either.

    Returns:
        N tracks, likeliest first; the slots of those taken in are empty.
    """
    prob, num = tracks.existence_prob, tracks.label.size
    belief = jax.vmap(target.moments)(tracks.belief)
    lower = jax.vmap(linalg.cholesky)(belief.cov)
    rivals = min(MOST, num)

    def near(leader: Array) -> tuple[Array, Array]:
        mine = jnp.where(tracks.label == tracks.label[leader], prob, 0.0)
        weight, slot = jax.lax.top_k(mine, rivals)
        gap = belief.mean[slot] - belief.mean[leader][None]
        ahead = _square(gap, jnp.broadcast_to(lower[leader][None], lower[slot].shape))
        far = jnp.maximum(ahead, _square(gap, lower[slot]))
        return slot, (weight > 0) & (far <= threshold)

    slot, close = jax.vmap(near)(jnp.arange(num))

    def lead(leader: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        taken, member = carry
        free = (prob[leader] > 0) & ~taken[leader]
        mine = free & (close[leader] & ~taken[slot[leader]])
        mine = jnp.where(slot[leader] == leader, free, mine)
        taken = taken.at[slot[leader]].set(taken[slot[leader]] | mine)
        return taken, member.at[leader].set(mine)

    start = jnp.zeros(num, bool), jnp.zeros((num, rivals), bool)
    _, member = jax.lax.fori_loop(0, num, lead, start)
    weight = jnp.where(member, prob[slot], 0.0)
    merged = Tracks(
        existence_prob=jnp.minimum(weight.sum(1), 1.0),
        belief=jax.vmap(_collapse, (None, None, 0, 0))(target, tracks, weight, slot),
        label=tracks.label,
        alias=tracks.alias,
    )
    order = jnp.argsort(-merged.existence_prob)
    return jax.tree.map(lambda x: x[order], merged)


def heirs(tracks: Tracks, threshold: float) -> Array:
    """Says which tracks to report: the likeliest of each label that exists enough.

    Args:
        tracks: N tracks, likeliest first.
        threshold: Probability of a label's tracks, all together, above which it is
            reported.

    Returns:
        [N] (bool).
    """
    exists = tracks.existence_prob > 0
    same = (
        (tracks.label[:, None] == tracks.label[None]) & exists[:, None] & exists[None]
    )
    together = jnp.where(same, tracks.existence_prob[None], 0.0).sum(1)
    slot = jnp.arange(exists.size)
    likelier = (same & (slot[None] < slot[:, None])).any(1)
    return (together > threshold) & ~likelier


def _collapse(target: Target, tracks: Tracks, weight: Array, slot: Array) -> Gaussian:
    members = jax.tree.map(lambda x: x[slot], tracks.belief)
    return target.collapse(linalg.safe_log(weight), members)


def _square(gap: Array, lower: Array) -> Array:
    """Returns squared Mahalanobis distances: gap [G, D], lower [G, D, D]."""
    white = jax.vmap(linalg.solve_lower)(lower, gap)
    return (white * white).sum(1)
