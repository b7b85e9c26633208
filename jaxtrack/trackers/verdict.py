"""What some weighted hypotheses about all targets tell the user.

The best hypothesis says which tracks to report and where; all of them together say how
likely each track is, how many targets to expect, and whether the best one is to be
trusted: with an entropy near 0 and no second near the best the association was easy and
one hypothesis would have done; where many are level, no display of one is right.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import verdict
    >>> sure, torn = jnp.log(jnp.array([1.0, 0.0])), jnp.log(jnp.array([0.5, 0.5]))
    >>> print(verdict.runner_up(sure), f"{verdict.entropy(torn):.3f}")
    0.0 0.693

Reference: Chong, Mori and Reid, "Forty years of multiple hypothesis tracking", Journal
of Advances in Information Fusion 14(2), 2019, sections III and VII.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.retrodiction import Retrodiction
from jaxtrack.trackers.trajectories import Paths
from jaxtrack.types import Array, Target


class Estimate(NamedTuple):
    """What a scan taught, for the user.

    Attributes:
        mean: In the best hypothesis, or in the tree's likeliest leaf if it has none
            there, [N, D].
        cov: [N, D, D].
        label: Which target it is, [N] (int).
        exists: The best hypothesis has it, and it is still there, [N] (bool).
        existence_prob: Over all hypotheses, [N].
        mode_prob: [N, M].
        effective_size: How many equally weighted particles each belief is worth; 0
            where it is no sample, [N].
        num_mean: Expected number of targets, undetected ones included.
        num_var: Variance of that number.
        log_evidence: Log-density of the scan given the past.
        dropped: Expected number of targets, or parts of them, that found no room.
        hypothesis_prob: Of the likeliest hypotheses, best first, [H].
        entropy: Of the probabilities of all hypotheses that were found, in nats.
        runner_up: How likely the second best is for each unit of the best: 0 if there
            is none, 1 if they are level.
        log_loss: How much likelier than the best of them one may be that was not
            found, the log of a ratio; 0 if there is none.
        retrodicted: Where the targets were some scans ago, if that was asked for.
        paths: Where they were in the last scans, if that was asked for.
    """

    mean: Array
    cov: Array
    label: Array
    exists: Array
    existence_prob: Array
    mode_prob: Array
    effective_size: Array
    num_mean: Array
    num_var: Array
    log_evidence: Array
    dropped: Array
    hypothesis_prob: Array
    entropy: Array
    runner_up: Array
    log_loss: Array
    retrodicted: Retrodiction | None = None
    paths: Paths | None = None


class Views(NamedTuple):
    """What may be, cluster by cluster; clusters are independent of each other.

    Attributes:
        leaf: Of each tree, in the hypotheses about its cluster, -1 for none, [H, N].
        log_prob: Of these hypotheses; equal in all trees of a cluster, [H, N].
        label: Which cluster each tree is in, by its first tree, [N] (int).
    """

    leaf: Array
    log_prob: Array
    label: Array


def joint(leaf: Array, log_prob: Array) -> Views:
    """Returns hypotheses [H, N] about all trees as those of a single cluster."""
    rows = jnp.broadcast_to(log_prob[:, None], leaf.shape)
    return Views(leaf, rows, jnp.zeros(leaf.shape[1], int))


def entropy(log_prob: Array) -> Array:
    """Returns the entropy of some probabilities [H], in nats."""
    there = log_prob > -jnp.inf
    safe = jnp.where(there, log_prob, 0.0)
    return -jnp.where(there, jnp.exp(safe) * safe, 0.0).sum()


def runner_up(log_prob: Array) -> Array:
    """Returns how likely the second best [H] is for each unit of the best."""
    best = jnp.argmax(log_prob)
    others = jnp.where(jnp.arange(log_prob.size) == best, -jnp.inf, log_prob)
    return jnp.exp(others.max(initial=-jnp.inf) - log_prob[best])


def leaves(forest: Forest, views: Views) -> tuple[Array, Array]:
    """Returns the leaf of the best hypothesis of each tree, and the one to show.

    Args:
        forest: N trees.
        views: What may be.

    Returns:
        [N], -1 for none; and [N], the likeliest where the best hypothesis has none.
    """
    row, tree = jnp.argmax(views.log_prob, axis=0), jnp.arange(views.label.size)
    best = views.leaf[row, tree]
    column = jnp.arange(forest.log_score.shape[1])
    has = views.leaf[:, :, None] == column[None, None]
    share = jnp.where(has, jnp.exp(views.log_prob)[:, :, None], 0.0).sum(0)
    return best, jnp.where(best >= 0, best, jnp.argmax(share, axis=1))


def exists(forest: Forest, leaf: Array) -> Array:
    """Returns how likely each tree's target is to exist, in each hypothesis.

    Args:
        forest: N trees.
        leaf: Which one each hypothesis has of each tree, -1 for none, [H, N].
    """
    known = jnp.maximum(leaf, 0)
    tree = jnp.arange(leaf.shape[1])[None]
    return jnp.where(leaf >= 0, forest.existence_prob[tree, known], 0.0)


def variance(there: Array, views: Views) -> Array:
    """Returns the variance of the number of targets in the trees.

    Args:
        there: How likely each target is to exist, in each hypothesis, [H, N].
        views: What may be.
    """
    prob = jnp.exp(views.log_prob)
    within = (prob * there * (1 - there)).sum()
    same = views.label[:, None] == views.label[None]
    number = jnp.where(same[None], there[:, :, None], 0.0).sum(1)  # in the cluster
    mean = (prob * number).sum(0)
    between = (prob * (number - mean[None]) ** 2).sum(0)
    return within + jnp.where(_leads(views), between, 0.0).sum()


def _leads(views: Views) -> Array:
    """Returns which trees are the first of their cluster, [N] (bool)."""
    return views.label == jnp.arange(views.label.size)


def report(
    target: Target,
    forest: Forest,
    views: Views,
    hypothesis_prob: Array,
    hidden: Array,
    threshold: float,
    log_evidence: Array,
    dropped: Array,
    log_loss: Array | float = 0.0,
    choice: tuple[Array, Array] | None = None,
) -> Estimate:
    """Reports the best hypothesis, and how sure it is.

    Args:
        target: How one target is filtered.
        forest: N trees.
        views: What may be.
        hypothesis_prob: Of the likeliest hypotheses about all trees together, [H].
        hidden: Expected number of undetected targets.
        threshold: Probability of still being there above which a track is reported.
        log_evidence: Log-density of the scan.
        dropped: Expected number of targets that the capacities threw away.
        log_loss: How much likelier than the best of them one may be.
        choice: Another hypothesis to report, in views of a single cluster, and which
            trees of it, [N] (bool); see `estimators`.
    """
    prob = jnp.exp(views.log_prob)
    there = exists(forest, views.leaf)
    existence_prob = (prob * there).sum(0)
    row, tree = jnp.argmax(views.log_prob, axis=0), jnp.arange(views.label.size)
    _, shown = leaves(forest, views)
    reported = there[row, tree] > threshold
    if choice is not None:
        own, reported = views.leaf[choice[0]], choice[1]
        shown = jnp.where(own >= 0, own, shown)
    belief = jax.tree.map(lambda x: x[tree, shown], forest.belief)
    moments = jax.vmap(target.moments)(belief)
    first = _leads(views)
    seconds = jax.vmap(runner_up, in_axes=1)(views.log_prob)
    entropies = jax.vmap(entropy, in_axes=1)(views.log_prob)
    return Estimate(
        mean=moments.mean,
        cov=moments.cov,
        label=forest.label,
        exists=reported,
        existence_prob=existence_prob,
        mode_prob=jax.vmap(target.modes)(belief),
        effective_size=jax.vmap(target.effective_size)(belief),
        num_mean=existence_prob.sum() + hidden,
        num_var=variance(there, views) + hidden,
        log_evidence=log_evidence,
        dropped=dropped,
        hypothesis_prob=hypothesis_prob,
        entropy=jnp.where(first, entropies, 0.0).sum(),
        runner_up=jnp.where(first, seconds, 0.0).max(initial=0.0),
        log_loss=jnp.asarray(log_loss, prob.dtype),
    )
