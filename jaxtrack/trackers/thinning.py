"""What trackers that follow hypotheses throw away after a scan, and what they merge.

    >>> from jaxtrack.trackers import thinning
    >>> thinning.check(thinning.Thinning(8, prune_threshold=2.0, exist_threshold=1e-4))
    Traceback (most recent call last):
    ...
    ValueError: prune_threshold is 2.0; give a probability, e.g. 0.001

Reference: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979, section VI.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import global_hypotheses, verdict
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.global_hypotheses import Hypotheses
from jaxtrack.types import Array, Target


class Thinning(NamedTuple):
    """What to keep.

    Attributes:
        max_tracks: Trees kept, those most likely to be a target that is still there.
        prune_threshold: Hypotheses of less probability go.
        exist_threshold: A track goes from a hypothesis where its target exists with
            less probability.
        merge_threshold: Leaves of a tree become one where the squared Mahalanobis
            distance of their states is less; 0 for never.
    """

    max_tracks: int
    prune_threshold: float
    exist_threshold: float
    merge_threshold: float = 0.0


def check(limits: Thinning) -> None:
    """Raises a ValueError for settings that make no sense."""
    check_share("prune_threshold", limits.prune_threshold)
    check_share("exist_threshold", limits.exist_threshold)
    if not 0 <= limits.merge_threshold < math.inf:
        raise ValueError(
            f"merge_threshold is {limits.merge_threshold}; give a squared distance, "
            "e.g. 1, or 0 for none"
        )


def check_sizes(sizes: dict[str, int]) -> None:
    """Raises a ValueError for a capacity that has room for nobody."""
    for name, size in sizes.items():
        if size < 1:
            raise ValueError(f"{name} is {size}; give at least 1")


def check_share(name: str, share: float) -> None:
    """Raises a ValueError for what is no probability below 1."""
    if not 0 <= share < 1:
        raise ValueError(f"{name} is {share}; give a probability, e.g. 0.001")


def thin(
    target: Target, limits: Thinning, trees: Forest, hypotheses: Hypotheses
) -> tuple[Forest, Hypotheses, Array]:
    """Drops what is unlikely and merges what is alike.

    Args:
        target: How one target is filtered.
        limits: What to keep.
        trees: N trees with L leaves.
        hypotheses: H.

    Returns:
        The `max_tracks` likeliest trees, the hypotheses about them, normalised, and the
        expected number of targets that went with the others.
    """
    hypotheses = global_hypotheses.prune(hypotheses, limits.prune_threshold)
    if limits.merge_threshold:
        trees, hypotheses = merge_leaves(
            target, limits.merge_threshold, trees, hypotheses
        )
    prob = jnp.exp(hypotheses.log_weight)[:, None]
    some, leaf, _, lost = strongest(limits, trees, hypotheses.leaf, prob)
    merged = global_hypotheses.merge(Hypotheses(hypotheses.log_weight, leaf))
    return some, merged, lost


def strongest(
    limits: Thinning, trees: Forest, leaf: Array, prob: Array
) -> tuple[Forest, Array, Array, Array]:
    """Keeps the trees most likely to be a target that is still there.

    Args:
        limits: What to keep.
        trees: N trees with L leaves.
        leaf: Which one each hypothesis has of each tree, -1 for none, [H, N].
        prob: Of the hypotheses, about each tree or all, [H, N] or [H, 1].

    Returns:
        `max_tracks` trees, their leaves, [H, max_tracks], which they were,
        [max_tracks], and the expected number of targets that went with the others.
    """
    there = verdict.exists(trees, leaf)
    still = jnp.where(there > limits.exist_threshold, leaf, -1)
    number = (prob * there).sum(0)
    fading = jnp.where(still < 0, there, 0.0)
    held = (still >= 0).any(0)
    likely, kept = jax.lax.top_k(jnp.where(held, number, -1.0), limits.max_tracks)
    lost = jnp.where(held, number, 0.0).sum() - jnp.maximum(likely, 0.0).sum()
    lost = jnp.maximum(lost, 0.0) + (prob * fading).sum()
    some = jax.tree.map(lambda x: x[kept], trees)
    gone = likely < 0
    some = some._replace(
        log_score=jnp.where(gone[:, None], -jnp.inf, some.log_score),
        existence_prob=jnp.where(gone[:, None], 0.0, some.existence_prob),
        label=jnp.where(gone, -1, some.label),
        age=jnp.where(gone, 0, some.age),
    )
    return some, still[:, kept], kept, lost


def merge_leaves(
    target: Target, threshold: float, trees: Forest, hypotheses: Hypotheses
) -> tuple[Forest, Hypotheses]:
    """Makes one of the leaves of a tree whose states are alike (Reid, section VI).

    Args:
        target: How one target is filtered.
        threshold: Squared Mahalanobis distance.
        trees: N trees with L leaves.
        hypotheses: H.
    """
    size = trees.log_score.shape[1]
    places = jnp.arange(size)
    prob = jnp.exp(hypotheses.log_weight)
    has = hypotheses.leaf[:, :, None] == places[None, None]
    weight = jnp.where(has, prob[:, None, None], 0.0).sum(0)  # [N, L]

    def tree(log_weight: Array, one: Forest) -> tuple:
        moments = jax.vmap(target.moments)(one.belief)
        given = mixture.Mixture(log_weight, moments.mean, moments.cov)
        group = mixture.clusters(given, threshold, size)
        mine = jnp.where(
            places[:, None] == group[None], log_weight[None], -jnp.inf
        )  # [group, leaf]
        share = jnp.exp(jax.vmap(mixture.log_normalise)(mine))
        # Beliefs are about targets that still exist.
        alive = mine + safe_log(one.existence_prob)[None]
        gone = (alive == -jnp.inf).all(1, keepdims=True)
        alive = jnp.where(gone, mine, alive)
        belief = jax.vmap(target.collapse, (0, None))(alive, one.belief)
        exists = (share * one.existence_prob[None]).sum(1)
        heaviest = jnp.argmax(mine, axis=1)
        filled = (mine > -jnp.inf).any(1)
        score = jnp.where(filled, one.log_score[heaviest], -jnp.inf)
        exists = jnp.where(filled, exists, 0.0)
        return group, (score, exists, belief, one.past[heaviest])

    group, made = jax.vmap(tree)(safe_log(weight), trees)
    at = jnp.arange(len(group))[None]
    leaf = jnp.where(
        hypotheses.leaf >= 0, group[at, jnp.maximum(hypotheses.leaf, 0)], -1
    )
    leaf = leaf.astype(hypotheses.leaf.dtype)
    score, exists, belief, past = made
    merged = Forest(score, exists, belief, past, trees.label, trees.age)
    return merged, hypotheses._replace(leaf=leaf)
