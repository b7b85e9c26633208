"""Branch and bound on what prices leave undecided.

At given prices every leaf has a loss, by how much it is worth less than the best leaf
of its tree. A selection that is better than the one known loses less, all in all, than
the gap between bound and score: most leaves are out at once, and what remains is
searched tree by tree, depth first, each tree's least loss first. Trees of different
clusters share nothing, so clusters are searched one after another, and only those that
have a gap. A search that comes to its end has found the best selection; one that runs
out of nodes tells how much better another may be.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import branching, greedy, problem
    >>> log_score = jnp.array([[3.0, 2.0], [3.0, 1.0], [4.0, 0.0]])
    >>> detection = jnp.array([[[0], [1]], [[1], [2]], [[0], [-1]]])
    >>> given = problem.Problem(log_score, detection)
    >>> found = greedy.greedy(given, num_detections=3)
    >>> print(found.leaf, found.log_score, found.log_bound)
    [0 0 1] 6.0 10.0
    >>> found = branching.branch(given, 3, found)
    >>> print(found.leaf, found.log_score, f"{found.log_bound:.3f}")
    [1 1 0] 7.0 7.000

Reference: Land and Doig, "An automatic method of solving discrete programming
problems", Econometrica 28(3), 1960.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.multiscan.problem import Answer, Problem, answer, label
from jaxtrack.assign.multiscan.slots import (
    Slots,
    after_paying,
    flat,
    rounding,
    slots,
)
from jaxtrack.types import Array


class _Levels(NamedTuple):
    """The trees of a cluster in the order of the search, and their leaves by loss.

    Attributes:
        tree: At each level, [D].
        num: How many levels there are.
        loss: Sorted, inf for leaves that are out, [D, L].
        leaf: Which ones these are, [D, L].
        place: Of their detections, [D, L, S].
        price: Of the cluster's detections, [P].
        shared: Which places only one tree may have, [P] (bool).
        margin: Differences below are none.
    """

    tree: Array
    num: Array
    loss: Array
    leaf: Array
    place: Array
    price: Array
    shared: Array
    margin: Array


class _Search(NamedTuple):
    """Where the search of a cluster stands.

    Attributes:
        level: Of the tree that is to choose; -1 when all has been seen.
        rank: The next leaf to try at each level, by loss, [D].
        lost: Losses at the levels before, [D + 1].
        taken: [P] (bool).
        chosen: The rank of each level's leaf in the best selection so far, [D].
        least: What that one loses.
        count: Nodes.
    """

    level: Array
    rank: Array
    lost: Array
    taken: Array
    chosen: Array
    least: Array
    count: Array


def branch(
    problem: Problem,
    num_detections: int,
    known: Answer,
    max_nodes: int = 1000,
    tolerance: float = 1e-6,
) -> Answer:
    """Closes the gap between a selection's score and the bound, or narrows it.

    The gradient of `log_score` is that of the chosen scores; the rest is constant.

    Args:
        problem: [N, L] and [N, L, S].
        num_detections: K, detections of a scan at most.
        known: A selection, and prices; the better they are, the fewer nodes. One that
            is not feasible is returned as it is.
        max_nodes: Of each cluster with a gap, at most.
        tolerance: What a search may leave of a cluster, in the unit of the scores and
            beyond their rounding; the bound counts it.

    Returns:
        The best selection if no search ran out of nodes, at the same prices.

    Raises:
        ValueError: There is no node, or the tolerance is negative.
    """
    if max_nodes < 1:
        raise ValueError(f"max_nodes is {max_nodes}; give at least 1")
    if not tolerance >= 0:
        raise ValueError(f"tolerance is {tolerance}; give 0 or more")
    fixed, known = jax.lax.stop_gradient((problem, known))
    given, cluster = slots(*fixed, num_detections), label(fixed, num_detections)
    loss, gap, own = _gaps(given, known, cluster)
    margin, table = tolerance + rounding(given), flat(known.price)

    def more(state: tuple[Array, Array, Array]) -> Array:
        return known.feasible & (state[1] > margin).any()

    def search(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        leaf, gap, left = state
        which = jnp.argmax(gap)
        price = jnp.where(own == which, table, 0.0)
        levels = _levels(given, loss, gap[which], cluster == which, price, margin)
        leaf, rest = _search(levels, leaf, gap[which], max_nodes)
        return leaf, gap.at[which].set(0.0), left.at[which].set(rest + margin)

    # What is not searched leaves its gap.
    state = known.leaf.astype(jnp.int32), gap, gap
    leaf, _, left = jax.lax.while_loop(more, search, state)
    found = answer(problem, leaf, known.price)
    limit = jax.lax.stop_gradient(found.log_score) + left.sum()
    limit = jnp.minimum(limit, found.log_bound)
    return found._replace(log_bound=jnp.where(known.feasible, limit, found.log_bound))


def _gaps(given: Slots, known: Answer, cluster: Array) -> tuple[Array, Array, Array]:
    """Returns losses [N, L], each cluster's gap [N], and whose the places are [P].

    A cluster's gap stands at its first tree; the others' are zero. A place that no
    leaf has belongs to N.
    """
    num, table = len(cluster), flat(known.price)
    worth = after_paying(given, table)
    possible = worth > -jnp.inf
    top = jnp.where(given.there, worth.max(1, initial=-jnp.inf), 0.0)
    loss = jnp.where(possible, top[:, None] - worth, jnp.inf)
    owner = jnp.where(possible, cluster[:, None], num)[..., None]
    owner = jnp.broadcast_to(owner, given.place.shape)
    own = jnp.full(table.shape, num).at[given.place].min(owner)
    has, leaf = known.leaf >= 0, jnp.maximum(known.leaf, 0)
    tree = jnp.arange(num)
    used = jnp.zeros(table.shape, bool)
    used = used.at[given.place[tree, leaf]].max(has[:, None])
    gap = jnp.zeros(num + 1, loss.dtype).at[own].add(jnp.where(used, 0.0, table))
    gap = gap.at[cluster].add(jnp.where(has, loss[tree, leaf], 0.0))
    return loss, gap[:num], own


def _levels(
    given: Slots, loss: Array, gap: Array, mine: Array, price: Array, margin: Array
) -> _Levels:
    """Puts the trees of a cluster in order: those with fewest leaves left first."""
    mine = mine & given.there
    loss = jnp.where(mine[:, None] & (loss <= gap), loss, jnp.inf)
    count = (loss < jnp.inf).sum(1)
    tree = jnp.argsort(jnp.where(mine, count, loss.shape[1] + 1))
    leaf = jnp.argsort(loss, axis=1)[tree].astype(jnp.int32)
    width = price.size // given.place.shape[-1]
    return _Levels(
        tree=tree,
        num=mine.sum(),
        loss=jnp.take_along_axis(loss[tree], leaf, axis=1),
        leaf=leaf,
        place=jnp.take_along_axis(given.place[tree], leaf[..., None], axis=1),
        price=price,
        shared=jnp.arange(price.size) % width < width - 1,
        margin=margin,
    )


def _search(
    levels: _Levels, leaf: Array, gap: Array, max_nodes: int
) -> tuple[Array, Array]:
    """Searches one cluster: leaves of all trees, and what may still be gained."""
    num = len(levels.tree)
    none, zero = jnp.zeros(num, jnp.int32), jnp.zeros((), jnp.int32)
    state = _Search(
        level=zero,
        rank=none,
        lost=jnp.zeros(num + 1, levels.loss.dtype),
        taken=jnp.zeros(levels.price.shape, bool),
        chosen=none - 1,
        least=gap,
        count=zero,
    )
    end = jax.lax.while_loop(
        lambda s: (s.level >= 0) & (s.count < max_nodes),
        lambda s: _visit(levels, s),
        state,
    )
    level = jnp.arange(num)
    better = (end.chosen[0] >= 0) & (level < levels.num)
    new = levels.leaf[level, jnp.maximum(end.chosen, 0)]
    leaf = leaf.at[levels.tree].set(jnp.where(better, new, leaf[levels.tree]))
    # What was not seen begins with the next leaf of one of the levels.
    last = levels.loss.shape[1] - 1
    ahead = levels.loss[level, jnp.minimum(end.rank, last)]
    ahead = jnp.where(end.rank > last, jnp.inf, ahead) + end.lost[:-1]
    unseen = jnp.where(level <= end.level, ahead, jnp.inf).min()
    return leaf, jnp.maximum(end.least - unseen, 0.0)


def _visit(levels: _Levels, state: _Search) -> _Search:
    """Gives the level's tree its next leaf and goes on, or takes one back."""
    now, num_leaves = state.level, levels.loss.shape[1]
    loss, place = levels.loss[now], levels.place[now]
    free = ~(state.taken & levels.shared)[place].any(-1)
    lost = state.lost[now] + loss
    fits = free & (jnp.arange(num_leaves) >= state.rank[now])
    fits = fits & (lost < state.least - levels.margin)
    found, next_leaf = fits.any(), jnp.argmax(fits).astype(jnp.int32)
    whole = found & (now + 1 == levels.num)

    rank = state.rank.at[now].set(jnp.where(found, next_leaf + 1, num_leaves))
    taken = state.taken.at[place[next_leaf]].set(
        jnp.where(found, True, state.taken[place[next_leaf]])
    )
    total = lost[next_leaf] + jnp.where(taken, 0.0, levels.price).sum()
    better = whole & (total < state.least - levels.margin)
    chosen = jnp.where(better, rank - 1, state.chosen)
    least = jnp.where(better, total, state.least)

    # Deeper, or at the same level again, or back.
    deeper = found & ~whole
    level = now + jnp.where(deeper, 1, jnp.where(found, 0, -1))
    back = jnp.where(found, now, jnp.maximum(now - 1, 0))
    given_up = levels.place[back, jnp.maximum(rank[back] - 1, 0)]
    taken = taken.at[given_up].set(jnp.where(deeper, taken[given_up], False))
    ahead = jnp.minimum(now + 1, len(rank) - 1)
    rank = rank.at[ahead].set(jnp.where(deeper, 0, rank[ahead]))
    after = state.lost.at[now + 1].set(
        jnp.where(deeper, lost[next_leaf], state.lost[now + 1])
    )
    return _Search(level, rank, after, taken, chosen, least, state.count + 1)
