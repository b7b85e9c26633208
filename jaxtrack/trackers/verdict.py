"""What some weighted hypotheses about all targets tell the user.

The best hypothesis says which tracks to report and where; all of them together say how
likely each track is, how many targets to expect, and whether the best one is to be
trusted: with an entropy near 0 and a wide gap to the second the association was easy
and one hypothesis would have done; where many are level, no display of one is right.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import verdict
    >>> sure, torn = jnp.log(jnp.array([1.0, 0.0])), jnp.log(jnp.array([0.5, 0.5]))
    >>> print(verdict.entropy(sure), verdict.entropy(torn).round(3), verdict.gap(torn))
    0.0 0.693 0.0

Reference: Chong, Mori and Reid, "Forty years of multiple hypothesis tracking", Journal
of Advances in Information Fusion 14(2), 2019, sections III and VII.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.trackers.forest import Forest
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
        log_prob: Of each hypothesis that was kept; -inf for none, [H].
        entropy: Of these probabilities.
        gap: How much likelier the best is than the second, the log of a ratio.
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
    log_prob: Array
    entropy: Array
    gap: Array


def entropy(log_prob: Array) -> Array:
    """Returns the entropy of some probabilities [H], in nats."""
    there = log_prob > -jnp.inf
    return -jnp.where(
        there, jnp.exp(log_prob) * jnp.where(there, log_prob, 0.0), 0
    ).sum()


def gap(log_prob: Array) -> Array:
    """Returns how much likelier the best is than the second; inf if it is alone."""
    best = jnp.argmax(log_prob)
    others = jnp.where(jnp.arange(log_prob.size) == best, -jnp.inf, log_prob)
    return log_prob[best] - others.max()


def exists(forest: Forest, leaf: Array) -> Array:
    """Returns how likely each tree's target is to exist, in each hypothesis.

    Args:
        forest: N trees.
        leaf: Which one each hypothesis has of each tree, -1 for none, [H, N].
    """
    known = jnp.maximum(leaf, 0)
    tree = jnp.arange(leaf.shape[1])[None]
    return jnp.where(leaf >= 0, forest.existence_prob[tree, known], 0.0)


def report(
    target: Target,
    forest: Forest,
    leaf: Array,
    log_prob: Array,
    hidden: Array,
    threshold: float,
    log_evidence: Array,
    dropped: Array,
) -> Estimate:
    """Reports the best hypothesis, and how sure it is.

    Args:
        target: How one target is filtered.
        forest: N trees.
        leaf: Which one each hypothesis has of each tree, -1 for none, [H, N].
        log_prob: Of each hypothesis, [H].
        hidden: Expected number of undetected targets.
        threshold: Probability of still being there above which a track is reported.
        log_evidence: Log-density of the scan.
        dropped: Expected number of targets that the capacities threw away.
    """
    prob = jnp.exp(log_prob)
    there = exists(forest, leaf)
    existence_prob = (prob[:, None] * there).sum(0)
    best = leaf[jnp.argmax(log_prob)]
    column = jnp.arange(forest.log_score.shape[1])
    share = jnp.where(leaf[:, :, None] == column[None, None], prob[:, None, None], 0.0)
    shown = jnp.where(best >= 0, best, jnp.argmax(share.sum(0), axis=1))
    belief = jax.tree.map(
        lambda x: jax.vmap(lambda tree, at: tree[at])(x, shown), forest.belief
    )
    moments = jax.vmap(target.moments)(belief)
    number = there.sum(1)  # given each hypothesis
    mean = (prob * number).sum()
    within = (prob * (there * (1 - there)).sum(1)).sum()
    return Estimate(
        mean=moments.mean,
        cov=moments.cov,
        label=forest.label,
        exists=there[jnp.argmax(log_prob)] > threshold,
        existence_prob=existence_prob,
        mode_prob=jax.vmap(target.modes)(belief),
        effective_size=jax.vmap(target.effective_size)(belief),
        num_mean=mean + hidden,
        num_var=within + (prob * (number - mean) ** 2).sum() + hidden,
        log_evidence=log_evidence,
        dropped=dropped,
        log_prob=log_prob,
        entropy=entropy(log_prob),
        gap=gap(log_prob),
    )
