"""Decisions of track-oriented MHT: what the best hypothesis says of scans long past.

>>> import jax.numpy as jnp
>>> from jaxtrack.trackers import deciding, forest
>>> past = jnp.array([[[0], [1]], [[1], [2]]])  # two trees, two leaves, a scan
>>> trees = forest.Forest(jnp.zeros((2, 2)), None, None, past, None, None)
>>> print(deciding.agreeing(trees, jnp.array([0, -1]), num=3))
[[ True False]
 [ True  True]]

The first tree has detection 0 in the best hypothesis; the second is not in it, and
nobody else has decided on detections 1 and 2.

Reference: Kurien, "Issues in the design of practical multitarget tracking algorithms",
in Multitarget-Multisensor Tracking, ed. Bar-Shalom, 1990.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.linalg import safe_log
from jaxtrack.trackers import multiscan_choice, verdict
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.multiscan_choice import Choice
from jaxtrack.trackers.thinning import Thinning
from jaxtrack.types import Array


class Pruned(NamedTuple):
    """What a decision leaves: the first fields of a state, and where the trees were.

    Attributes:
        trees: N trees with L leaves.
        best: The leaf that the best hypothesis has of each, -1 for none, [N].
        sure: Which trees are in every hypothesis, [N] (bool).
        log_total: Log-weight of all hypotheses about these trees that were found.
        kept: Which of the trees before these are, [N].
    """

    trees: Forest
    best: Array
    sure: Array
    log_total: Array
    kept: Array


def decide(
    limits: Thinning,
    num_scans: int,
    trees: Forest,
    sure: Array,
    found: Choice,
    num_detections: int,
    awaited: Array | bool = False,
) -> Pruned:
    """Keeps what agrees with the best hypothesis about the window's first scan.

    A tree that is in the best hypothesis and was begun by then is sure from now on. One
    that is not lives on without the detections that others own.

    Args:
        limits: What to keep.
        num_scans: How many scans ago the window's first was.
        trees: N + K trees with L leaves, of num_scans + 1 scans.
        sure: Which of them are in every hypothesis, [N + K] (bool).
        found: The hypotheses.
        num_detections: K, of a scan.
        awaited: Which trees stay even if their targets are dead, before those that are
            as likely to be none, [N + K] (bool).
    """
    best, views = found.best, found.views
    agrees = agreeing(trees, best, num_detections) & (trees.log_score > -jnp.inf)
    there = verdict.exists(trees, views.leaf)
    prob = (jnp.exp(views.log_prob) * there).sum(0)
    score = jnp.where(agrees, trees.log_score, -jnp.inf)
    top = score.max(1)
    sure = (best >= 0) & (sure | (trees.age > num_scans))
    exists = jnp.where(agrees, trees.existence_prob, 0.0)
    alive = (score + safe_log(exists)).max(1)
    rank = jnp.where(sure, prob, jnp.maximum(prob, jax.nn.sigmoid(alive)))
    dead = jnp.where(sure, prob, exists.max(1)) <= limits.exist_threshold
    rank = jnp.where(awaited, jnp.maximum(rank, 0.5), rank)
    rank = jnp.where(agrees.any(1) & (awaited | ~dead), rank, -1.0)
    # In the order in which they were begun, so that a tree stays where it is.
    kept = jnp.sort(jax.lax.top_k(rank, limits.max_tracks)[1])
    held = rank[kept] >= 0
    # All hypotheses have a leaf of a sure tree: its best one counts as 0.
    shift = jnp.where(sure & (top > -jnp.inf), top, 0.0)
    score = score - shift[:, None]
    some = jax.tree.map(lambda x: x[kept], trees)
    some = some._replace(
        log_score=jnp.where(held[:, None], score[kept], -jnp.inf),
        existence_prob=jnp.where(held[:, None], exists[kept], 0.0),
        label=jnp.where(held, some.label, -1),
        age=jnp.where(held, some.age, 0),
    )
    stay = jnp.zeros(best.size, bool).at[kept].set(held)
    log_total = multiscan_choice.remaining(
        found, trees._replace(log_score=score), stay, sure
    )
    chosen = jnp.where(held, best[kept], -1)
    return Pruned(some, chosen, held & sure[kept], log_total, kept)


def agreeing(trees: Forest, best: Array, num: int) -> Array:
    """Tells which leaves the best hypothesis leaves possible, [N, L] (bool).

    A detection of the window's first scan belongs to the tree that has it in the best
    hypothesis, or else to the tree with the best leaf that has it.

    Args:
        trees: N trees with L leaves; the first of their scans is decided.
        best: The leaf that the best hypothesis has of each, -1 for none, [N].
        num: K, detections of a scan.
    """
    tree, first = jnp.arange(best.size), trees.past[:, :, 0]  # [N, L]
    decided = jnp.where(best >= 0, first[tree, jnp.maximum(best, 0)], -1)
    wants = first[:, :, None] == jnp.arange(num)[None, None]  # [N, L, K]
    claim = jnp.where(wants, trees.log_score[:, :, None], -jnp.inf).max(1)
    owns = decided[:, None] == jnp.arange(num)[None]
    claim = jnp.where((best >= 0)[:, None], -jnp.inf, claim)
    claim = jnp.where(owns, jnp.inf, claim)
    owner = jnp.argmax(claim, axis=0)  # [K]
    mine = (first < 0) | (owner[jnp.maximum(first, 0)] == tree[:, None])
    return jnp.where((best >= 0)[:, None], first == decided[:, None], mine)
