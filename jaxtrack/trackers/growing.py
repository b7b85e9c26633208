"""Track trees through a scan: leaves followed by detections, and trees begun.

>>> import jax.numpy as jnp
>>> from jaxtrack.trackers import growing
>>> growing.Grown._fields
('trees', 'parent', 'lost')

Reference: Kurien, "Issues in the design of practical multitarget tracking algorithms",
in Multitarget-Multisensor Tracking, ed. Bar-Shalom, 1990.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.trackers import arrivals, forest, undetected
from jaxtrack.trackers.association import Sighting
from jaxtrack.trackers.forest import Forest
from jaxtrack.types import Array, Scan, Target


class Grown(NamedTuple):
    """Trees after a scan.

    Attributes:
        trees: N trees with L leaves.
        parent: The old leaf of each leaf, [N, L] (int).
        lost: Share of each tree's weight that was not followed, [N].
    """

    trees: Forest
    parent: Array
    lost: Array


def grow(
    target: Target,
    params: Any,
    prune_threshold: float,
    trees: Forest,
    sight: Sighting,
    scan: Scan,
    best: Array,
    sure: Array,
    log_absent: Array | None = None,
) -> Grown:
    """Follows leaves by detections, and keeps the likeliest L of each tree.

    Only those are corrected. That the best hypothesis goes on with nothing detected is
    always among them, as the first, so that there is one that is possible.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        prune_threshold: Leaves of less weight than this share of their tree's go.
        trees: N trees with L leaves, predicted.
        sight: The scan as they see it.
        scan: K detections.
        best: The leaf that the best hypothesis has of each tree, -1 for none, [N].
        sure: Which trees are in every hypothesis, [N] (bool).
        log_absent: If leaves say whether a target is there: that it is not, [N, L].
    """
    none = sight.log_score.shape[2] - 1
    step = sight.log_score  # [N, L, K + 1], or K + 2
    if log_absent is not None:
        step = jnp.concatenate([step, log_absent[:, :, None]], axis=2)
    score = trees.log_score[:, :, None] + step
    size, columns = score.shape[1:]
    every = score.reshape(len(score), -1)
    tree = jnp.arange(best.size)
    nothing = none + jnp.argmax(score[tree, jnp.maximum(best, 0), none:], axis=1)
    last = jnp.where(best >= 0, best * columns + nothing, -1)
    safe = jnp.arange(every.shape[1])[None] == last[:, None]
    rank = jnp.where(safe & (every > -jnp.inf), jnp.inf, every)
    found, at = jax.lax.top_k(rank, size)
    nothing = jnp.where(sure, -jnp.inf, 0.0)
    floor = jnp.maximum(every.max(1), nothing) + jnp.log(prune_threshold)
    there = (found > -jnp.inf) & (found >= floor[:, None])
    parent, column = jnp.divmod(at, columns)
    seen = jnp.minimum(column, none)
    grown = forest.follow(target, params, trees, sight, scan, parent, seen, there)
    if log_absent is not None:
        gone = column > none
        kept = jnp.take_along_axis(every, at, axis=1)
        grown = grown._replace(
            log_score=jnp.where(there, kept, -jnp.inf),
            existence_prob=jnp.where(gone, 0.0, grown.existence_prob),
        )
    total = jax.vmap(mixture.total)
    held, all_of_it = total(grown.log_score), total(every)
    known = all_of_it > -jnp.inf
    share = jnp.where(known, held, 0.0) - jnp.where(known, all_of_it, 0.0)
    lost = jnp.where(known, -jnp.expm1(jnp.minimum(share, 0.0)), 0.0)
    return Grown(grown, parent, lost)


def forget_ends(trees: Forest) -> Forest:
    """Makes one leaf of a tree's that differ only in when its target ended.

    Args:
        trees: N trees with L leaves, which say whether a target is there.

    Returns:
        The same, where the first of these leaves has the weight of all.
    """
    gone = (trees.log_score > -jnp.inf) & (trees.existence_prob == 0)
    alike = (trees.past[:, :, None] == trees.past[:, None]).all(3)  # [N, L, L]
    alike = alike & gone[:, :, None] & gone[:, None]
    all_of_them = jnp.where(alike, trees.log_score[:, :, None], -jnp.inf)
    total = jax.vmap(mixture.total)(all_of_them)
    first = jnp.argmax(alike, axis=2) == jnp.arange(gone.shape[1])[None]
    together = jnp.where(first, total, -jnp.inf)
    return trees._replace(log_score=jnp.where(gone, together, trees.log_score))


def plant(
    bernoulli: bool,
    max_begun: int | None,
    trees: Forest,
    firsts: undetected.Firsts,
    next_label: Array,
) -> tuple[Forest, Array, Array]:
    """Begins a tree with each detection.

    Args:
        bernoulli: Whether that the detection is false is part of what the tree says,
            as a probability that there is no target, and no hypothesis of its own.
        max_begun: Trees begun at most, those likeliest to be a target; None for all.
        trees: N.
        firsts: K first detections.
        next_label: The first free label.

    Returns:
        All trees, the next free label, and the expected number of targets with whose
        detections none was begun.
    """
    first = firsts.log_score
    possible = first > -jnp.inf
    exists = jnp.where(possible, jax.nn.sigmoid(jnp.where(possible, first, 0.0)), 0.0)
    detection, lost = jnp.arange(first.size), jnp.zeros_like(firsts.found)
    if max_begun is not None and max_begun < first.size:
        detection = jnp.sort(jax.lax.top_k(exists, max_begun)[1])
        lost = jnp.maximum(exists.sum() - exists[detection].sum(), 0.0)
    some = firsts._replace(
        log_score=first[detection],
        belief=jax.tree.map(lambda x: x[detection], firsts.belief),
    )
    if not bernoulli:
        return *forest.plant(trees, some, next_label, None, detection), lost
    weight = jnp.where(possible, arrivals.log_new(firsts), -jnp.inf)[detection]
    some = some._replace(log_score=weight)
    return *forest.plant(trees, some, next_label, exists[detection], detection), lost
