"""Many good selections, cluster by cluster, and what leaving out others may have cost.

Trees choose one after another, and so many partial selections are kept: those that
could still come to the largest sums at given prices, by what their leaves have after
paying and what the trees to come have at most. Trees of different clusters share
nothing, so every cluster has a list of its own; a list of B for each of ten clusters
tells of B^10 selections. `leaf_prob` sums up over the lists, `together` makes one list
of them.

    >>> import functools, jax, jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import beam, problem
    >>> log_score = jnp.array([[3.0, 0.0], [5.0, 4.0], [1.0, 0.0]])
    >>> detection = jnp.array([[[0], [-1]], [[0], [-1]], [[1], [-1]]])
    >>> given = problem.Problem(log_score, detection)
    >>> best = functools.partial(beam.beam, num_detections=2, width=4)
    >>> found = jax.jit(best)(given)
    >>> print(found.label, found.log_score[:, 0], found.log_score[:, 2])
    [0 0 2] [  7.   5.   4. -inf] [  1.   0. -inf -inf]
    >>> print(beam.together(found).log_score)
    [8. 7. 6. 5.]

A list has no two selections that are the same, but it may have some that use the same
detections, where leaves of a tree do.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.multiscan.lagrangian import lagrangian
from jaxtrack.assign.multiscan.problem import Problem, label
from jaxtrack.assign.multiscan.slots import Slots, after_paying, flat, slots
from jaxtrack.types import Array

WORD = 32  # detections of which one integer tells whether they are taken
ROUNDS = 30  # of `lagrangian`, for prices where none are given


class Beam(NamedTuple):
    """Selections of each cluster, best first.

    Attributes:
        leaf: Of each tree in the selections of its cluster, [B, N] (int); -1 where the
            tree is empty, or there are not so many.
        log_score: Sum over the tree's cluster, [B, N]; -inf where there are not so
            many.
        label: The first tree of each tree's cluster, [N].
        log_lost: What no selection of the tree's cluster exceeds that is not in the
            list, up to rounding, [N]; -inf where nothing was left out. Those of the
            list that are above are the best ones.
    """

    leaf: Array
    log_score: Array
    label: Array
    log_lost: Array


class Together(NamedTuple):
    """Selections of all trees, best first.

    Attributes:
        leaf: [B, N] (int), as in `Beam`.
        log_score: [B]; -inf where there are not so many.
        log_lost: What no selection exceeds that is not in the list.
    """

    leaf: Array
    log_score: Array
    log_lost: Array


class _Frame(NamedTuple):
    """What is known of trees.

    Attributes:
        there: Whether a tree has a leaf, [N] (bool).
        score: [N, L]; an empty tree has one of 0.
        margin: What leaves have after paying less the best of the tree, [N, L].
        limit: What no selection of the tree's cluster exceeds, [N].
        bits: Detections of leaves, [N, L, W].
        label: Cluster, [N].
    """

    there: Array
    score: Array
    margin: Array
    limit: Array
    bits: Array
    label: Array


class _State(NamedTuple):
    """Partial selections of the present cluster, and those of earlier ones.

    Attributes:
        leaf: [B, N].
        score: Sum of the present cluster's leaves so far, [B].
        rank: Sum of what they have after paying less what their trees have at best.
        taken: Detections, as bits, [B, W].
        lost: [N].
    """

    leaf: Array
    score: Array
    rank: Array
    taken: Array
    lost: Array


def beam(
    problem: Problem, num_detections: int, width: int, price: Array | None = None
) -> Beam:
    """Lists the best selections of each cluster.

    With a width that is enough for all selections of a cluster, the list is complete.
    The gradient of `log_score` is that of the chosen scores.

    Args:
        problem: [N, L] and [N, L, S].
        num_detections: K, detections of a scan at most.
        width: B, selections that are kept for each cluster.
        price: Of detections, not negative, [S, K], such as `lagrangian` and `relax`
            find; the better, the fewer good selections are lost on the way. None for
            those of a few rounds of `lagrangian`.

    Raises:
        ValueError: The width is not positive.
    """
    if width < 1:
        raise ValueError(f"width is {width}; give at least 1")
    fixed = jax.lax.stop_gradient(problem)
    if price is None:
        price = lagrangian(fixed, num_detections, max_rounds=ROUNDS).price
    table = flat(jax.lax.stop_gradient(price))
    given = slots(*fixed, num_detections)
    labels = label(fixed, num_detections)
    leaf, lost = _search(given, labels, table, width)

    score = slots(*problem, num_detections).log_score
    chosen = jnp.maximum(leaf, 0).T  # [N, B]
    own = jnp.take_along_axis(score, chosen, axis=1)
    there = leaf.T >= 0
    empty = jnp.where(given.there, -jnp.inf, 0.0)[:, None]
    # A list's end, and an empty tree's list but for its first, is no selection.
    empty = jnp.where(jnp.arange(width)[None] > 0, -jnp.inf, empty)
    own = jnp.where(there, jnp.where(there, own, 0.0), empty)
    same = (labels[:, None] == labels[None])[..., None]
    total = jnp.where(same, own[None], 0.0).sum(1)
    return Beam(leaf, total.T, labels, lost)


def leaf_prob(found: Beam, num_leaves: int) -> Array:
    """Returns the probability of each tree's leaves among the selections, [N, L].

    Zero where there is no selection.

    Args:
        found: The lists.
        num_leaves: L.
    """
    there = found.log_score > -jnp.inf
    top = jnp.where(there, found.log_score, -jnp.inf).max(0)
    top = jnp.where(top > -jnp.inf, top, 0.0)
    excess = jnp.where(there, found.log_score, 0.0) - top[None]
    weight = jnp.where(there, jnp.exp(excess), 0.0)
    total = weight.sum(0)
    weight = weight / jnp.where(total > 0, total, 1.0)[None]
    is_leaf = found.leaf[..., None] == jnp.arange(num_leaves)[None, None]
    return jnp.where(is_leaf, weight[..., None], 0.0).sum(0)


def together(found: Beam) -> Together:
    """Makes one list of as many selections of all trees."""
    width, num_trees = found.leaf.shape
    fixed = jax.lax.stop_gradient(found.log_score)

    def join(state: tuple, tree: Array) -> tuple[tuple, None]:
        rank, total, lost = state
        own = fixed[:, tree]
        sums = (total[:, None] + own[None]).reshape(-1)
        best, index = jax.lax.top_k(sums, width)
        mine = found.label == tree
        joined = jnp.where(mine[None], index[:, None] % width, rank[index // width])
        # Left out before, or by the cluster's list, or here.
        thrown = jnp.maximum(lost + own[0], total[0] + found.log_lost[tree])
        thrown = jnp.maximum(thrown, sums.at[index].set(-jnp.inf).max())
        return jax.tree.map(
            lambda new, old: jnp.where(mine[tree], new, old),
            (joined, best, thrown),
            state,
        ), None

    none = jnp.full((), -jnp.inf, fixed.dtype)
    begin = jnp.full(width, none).at[0].set(0.0)
    start = jnp.zeros((width, num_trees), jnp.int32), begin, none
    rank, total, lost = jax.lax.scan(join, start, jnp.arange(num_trees))[0]
    leaf = jnp.take_along_axis(found.leaf, rank, axis=0)
    first = found.label == jnp.arange(num_trees)
    scores = jnp.take_along_axis(found.log_score, rank, axis=0)
    there = (total > -jnp.inf)[:, None]
    scores = jnp.where(there & first[None], jnp.where(there, scores, 0.0), 0.0)
    summed = jnp.where(there[:, 0], scores.sum(1), -jnp.inf)
    return Together(jnp.where(there, leaf, -1), summed, lost)


def _search(
    given: Slots, labels: Array, table: Array, width: int
) -> tuple[Array, Array]:
    """Goes through the trees: the leaves of lists [B, N], and what was lost [N]."""
    num_trees, num_leaves = given.log_score.shape
    there = given.there[:, None]
    worth = after_paying(given, table)
    gain = jnp.where(given.there, worth.max(1), 0.0)
    alone = jnp.where(jnp.arange(num_leaves) == 0, 0.0, -jnp.inf)[None]
    frame = _Frame(
        there=given.there,
        score=jnp.where(there, given.log_score, alone),
        margin=jnp.where(there, worth - gain[:, None], alone),
        limit=_limits(given, labels, table, gain),
        bits=_bits(given, len(table)),
        label=labels,
    )
    # In each cluster those first that have most to lose beside their best leaf.
    second = jax.lax.top_k(frame.margin, min(2, num_leaves))[0][:, -1]
    order = jnp.lexsort((second, labels))
    ordered = labels[order]
    edge = jnp.ones(1, bool)
    first = jnp.concatenate([edge, ordered[1:] != ordered[:-1]])
    last = jnp.concatenate([first[1:], edge])
    begin = jnp.full(width, -jnp.inf, worth.dtype).at[0].set(0.0)
    start = _State(
        leaf=jnp.full((width, num_trees), -1, jnp.int32),
        score=begin,
        rank=begin,
        taken=jnp.zeros((width, frame.bits.shape[-1]), jnp.uint32),
        lost=jnp.full(num_trees, -jnp.inf, worth.dtype),
    )

    def turn(state: _State, turn: tuple[Array, Array, Array]) -> tuple[_State, None]:
        return _choose(frame, state, *turn), None

    final = jax.lax.scan(turn, start, (order, first, last))[0]
    return final.leaf, final.lost


def _choose(
    frame: _Frame, state: _State, tree: Array, first: Array, last: Array
) -> _State:
    """Lets a tree choose in all partial selections, and keeps the most promising."""
    width, num_leaves = len(state.score), frame.score.shape[1]
    begin = jnp.full(width, -jnp.inf, state.score.dtype).at[0].set(0.0)
    total = jnp.where(first, begin, state.score)
    rank = jnp.where(first, begin, state.rank)
    taken = jnp.where(first, jnp.uint32(0), state.taken)
    bits, mine = frame.bits[tree], frame.label == frame.label[tree]
    clash = ((taken[:, None] & bits[None]) != 0).any(-1)
    totals = jnp.where(clash, -jnp.inf, total[:, None] + frame.score[tree][None])
    ranks = jnp.where(clash, -jnp.inf, rank[:, None] + frame.margin[tree][None])
    value = jnp.where(last, totals, ranks + frame.limit[tree]).reshape(-1)
    best, index = jax.lax.top_k(value, width)
    parent, leaf = index // num_leaves, index % num_leaves
    chosen = jnp.where((best > -jnp.inf) & frame.there[tree], leaf, -1)
    leaves = jnp.where(mine[None], state.leaf[parent], state.leaf)
    thrown = value.at[index].set(-jnp.inf).max()
    return _State(
        leaf=leaves.at[:, tree].set(chosen.astype(jnp.int32)),
        score=totals.reshape(-1)[index],
        rank=ranks.reshape(-1)[index],
        taken=taken[parent] | bits[leaf],
        lost=jnp.where(mine, jnp.maximum(state.lost, thrown), state.lost),
    )


def _limits(given: Slots, labels: Array, table: Array, gain: Array) -> Array:
    """Returns what no selection of a tree's cluster exceeds at these prices, [N]."""
    num_trees = len(labels)
    possible = (given.log_score > -jnp.inf)[..., None]
    owner = jnp.where(possible, labels[:, None, None], num_trees)
    owner = jnp.broadcast_to(owner, given.place.shape)
    owner = jnp.full(len(table), num_trees).at[given.place].min(owner)
    price = jnp.where(owner[None] == labels[:, None], table[None], 0.0).sum(1)
    same = labels[:, None] == labels[None]
    return price + jnp.where(same, gain[None], 0.0).sum(1)


def _bits(given: Slots, size: int) -> Array:
    """Returns the detections of each leaf as bits, [N, L, W]."""
    num_scans = given.place.shape[-1]
    width = size // num_scans
    real = given.place % width < width - 1
    bit = jnp.left_shift(jnp.uint32(1), (given.place % WORD).astype(jnp.uint32))
    words = [
        jnp.where(real & (given.place // WORD == word), bit, jnp.uint32(0))
        for word in range(-(-size // WORD))
    ]
    # Detections of different scans have bits of their own, so that a sum is a union.
    return jnp.stack([word.sum(-1, dtype=jnp.uint32) for word in words], -1)
