"""Children of all global hypotheses together, where only a few trees are contested.

A tree that no detection is near is missed in every child, and a detection that is near
no tree begins one, or is false, in every child. The others are the contested ones:
among them the heaviest joint events of all hypotheses are found in one search.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import global_hypotheses, offspring
    >>> start = jnp.array([True, True])
    >>> parents = global_hypotheses.first(2, start, jnp.dtype("float32"))
    >>> score = jnp.array([[[2.0, -jnp.inf, 0.0]], [[-jnp.inf, -jnp.inf, -1.0]]])
    >>> made = offspring.follow(parents, score, None, jnp.zeros(2), 2, max_contested=1)
    >>> print(made.log_weight, made.column.tolist(), made.taken.tolist())
    [ 1. -1.] [[0, 2], [2, 2]] [[True, False], [False, False]]

Reference: Garcia-Fernandez, Williams, Granstrom and Svensson, "Poisson multi-Bernoulli
mixture filter: direct derivation and implementation", IEEE Trans. Aerospace and
Electronic Systems 54(4), 2018, section VI.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.assign.k_best_of_many import Found, k_best_of_many
from jaxtrack.trackers.global_hypotheses import Hypotheses
from jaxtrack.types import Array


class Offspring(NamedTuple):
    """The children that were found, heaviest first, each a parent and a joint event.

    Attributes:
        log_weight: [E].
        parent: [E].
        column: Which detection each tree has; K if its target is missed or not there,
            K + 1 if the child says that it is not there, [E, N].
        taken: Which detections old trees have, [E, K] (bool).
        log_total: Log-weight of all that were found.
        log_left: About that of all that were not.
        log_loss: How much likelier than the best of them one may be that was not.
        dropped: Expected number of detections that were not given to their trees, for
            want of room among the contested ones.
    """

    log_weight: Array
    parent: Array
    column: Array
    taken: Array
    log_total: Array
    log_left: Array
    log_loss: Array
    dropped: Array


class _Contest(NamedTuple):
    """Which trees and detections are contested.

    Attributes:
        tree: [C].
        detection: [D].
        dropped: See `Offspring`.
    """

    tree: Array
    detection: Array
    dropped: Array


def follow(
    parents: Hypotheses,
    log_score: Array,
    log_absent: Array | None,
    log_new: Array,
    max_children: int,
    max_contested: int | None = None,
    find: Callable[..., Found] = k_best_of_many,
) -> Offspring:
    """Finds the heaviest children of all hypotheses.

    Args:
        parents: H, of N trees.
        log_score: Of every leaf, [N, L, K + 1].
        log_absent: Log-probability that its target is not there, where hypotheses are
            to say so, [N, L]; then a miss is that of a target that is there.
        log_new: What a detection counts that no old tree has, [K].
        max_children: E.
        max_contested: Room for contested trees, and for detections; None for all.
        find: As `k_best_of_many`: (scores, weights, max_children, ways=) -> Found.
    """
    num_trees, _, num_columns = log_score.shape
    last, live = num_columns - 1, parents.leaf >= 0
    contest = _contest(log_score, log_new, max_contested)
    held = jnp.zeros(num_trees, bool).at[contest.tree].set(True)
    tree, known = jnp.arange(num_trees)[None], jnp.maximum(parents.leaf, 0)
    missed = jnp.where(live & ~held[None], log_score[tree, known, last], 0.0).sum(1)
    scores = _scores(parents, log_score, log_absent, log_new, contest)
    found = find(
        scores,
        parents.log_weight + missed,
        max_children,
        ways=1 if log_absent is None else 2,
    )
    code = jnp.concatenate([contest.detection, jnp.array([last, last + 1])])
    some = code[found.column].astype(jnp.int32)  # [E, C]
    none = jnp.full((max_children, num_trees), last, jnp.int32)
    best = jnp.where(found.log_weight[0] > -jnp.inf, found.log_weight[0], 0.0)
    return Offspring(
        log_weight=found.log_weight,
        parent=found.problem,
        column=none.at[:, contest.tree].set(some),
        taken=(some[:, :, None] == jnp.arange(last)[None, None]).any(1),
        log_total=mixture.total(found.log_weight),
        log_left=found.log_left,
        log_loss=jnp.maximum(found.log_lost - best, 0.0),
        dropped=contest.dropped,
    )


def _contest(log_score: Array, log_new: Array, room: int | None) -> _Contest:
    """Finds which trees and detections matter most to each other."""
    num_trees, _, num_columns = log_score.shape
    zero = jnp.zeros((), log_score.dtype)
    if room is None or room >= max(num_trees, num_columns - 1):
        return _Contest(jnp.arange(num_trees), jnp.arange(num_columns - 1), zero)
    fixed = jax.lax.stop_gradient(log_score)
    new = jax.lax.stop_gradient(log_new)
    possible = fixed[..., :-1] > -jnp.inf
    gain = fixed[..., :-1] - new[None, None] - fixed[..., -1:]
    gain = jnp.where(possible, gain, -jnp.inf).max(1)  # [N, K]
    tree_gain = gain.max(1)
    detection_gain = gain.max(0)
    trees = jax.lax.top_k(tree_gain, min(room, num_trees))[1]
    detections = jax.lax.top_k(detection_gain, min(room, num_columns - 1))[1]
    lost = jax.nn.sigmoid(tree_gain).at[trees].set(0.0).sum()
    lost = lost + jax.nn.sigmoid(detection_gain).at[detections].set(0.0).sum()
    return _Contest(trees, detections, lost)


def _scores(
    parents: Hypotheses,
    log_score: Array,
    log_absent: Array | None,
    log_new: Array,
    contest: _Contest,
) -> Array:
    """Returns what each hypothesis says of the contested, [H, C, D + W]."""
    some, last = log_score[contest.tree], log_score.shape[2] - 1
    hit = some[:, :, contest.detection] - log_new[contest.detection][None, None]
    table = jnp.concatenate([hit, some[:, :, last:]], axis=2)
    nothing = jnp.full(table.shape[2], -jnp.inf, table.dtype).at[-1].set(0.0)
    if log_absent is not None:
        table = jnp.concatenate([table, log_absent[contest.tree][..., None]], axis=2)
        nothing = jnp.append(nothing, -jnp.inf)
    leaf = parents.leaf[:, contest.tree]
    tree = jnp.arange(contest.tree.size)[None]
    own = table[tree, jnp.maximum(leaf, 0)]
    return jnp.where((leaf >= 0)[..., None], own, nothing[None, None])
