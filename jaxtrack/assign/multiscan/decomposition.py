"""Dual decomposition: one assignment for each scan, which must agree on the leaves.

Every scan has its own copy of the selection, in which only its own detections are kept
apart: an assignment of trees to detections in two dimensions, in which each tree and
detection is represented by its best leaf. The scores are shared out over the copies,
by multipliers that move until the copies agree (equations 36 to 46). What all copies
agree on is kept, and other trees choose among the leaves that are left. Where rounds
end and a gap remains, branch and bound decides (`branching`); the paper branches in
every round.

The least bound is the value of the linear relaxation (`relax`), as for `lagrangian`.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import decomposition, problem
    >>> log_score = jnp.array([[3.0, 0.0], [5.0, 4.0]])
    >>> detection = jnp.array([[[0, 1], [-1, -1]], [[0, 0], [-1, -1]]])
    >>> given = problem.Problem(log_score, detection)
    >>> found = decomposition.decomposition(given, num_detections=2)
    >>> print(found.leaf, found.log_score, jnp.round(found.log_bound, 3))
    [0 1] 7.0 7.0

References: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, section V.C; Lau and Williams,
"Multidimensional assignment by dual decomposition", ISSNIP, 2011.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.best import best
from jaxtrack.assign.multiscan import branching, greedy
from jaxtrack.assign.multiscan.lagrangian import PATIENCE, SHORTER
from jaxtrack.assign.multiscan.problem import Answer, Problem, answer
from jaxtrack.assign.multiscan.slots import (
    Slots,
    after_paying,
    flat,
    gained,
    judge,
    leaves_in,
    rounding,
    scan_matrix,
    slots,
)
from jaxtrack.types import Array


class _State(NamedTuple):
    """Where the rounds stand.

    Attributes:
        multiplier: What each copy adds to a leaf's share of its score, [S, N, L]; over
            copies they sum to zero.
        limit: Least bound so far.
        price: Of detections in their own scans' assignments, at that bound, [S, K].
        leaf: Best selection so far, [N].
        score: Its score; -inf if none is known.
        length: Of steps, relative to Polyak's.
        stale: Rounds since the bound fell.
        count: Rounds.
    """

    multiplier: Array
    limit: Array
    price: Array
    leaf: Array
    score: Array
    length: Array
    stale: Array
    count: Array


def decomposition(
    problem: Problem,
    num_detections: int,
    max_rounds: int = 100,
    tolerance: float = 1e-6,
    price: Array | None = None,
    leaf: Array | None = None,
    max_nodes: int = 1000,
) -> Answer:
    """Moves multipliers until the scans agree, then branches on what they leave.

    The gradient of `log_score` is that of the chosen scores; the rest is constant.

    Args:
        problem: [N, L] and [N, L, S].
        num_detections: K, detections of a scan at most.
        max_rounds: Rounds at most.
        tolerance: Gap, in the unit of the scores and beyond their rounding, that ends
            the search.
        price: What detections may cost, to begin with, [S, K]; 0 if None. A good guess
            saves rounds.
        leaf: A feasible selection, to begin with, [N]; None if none is known.
        max_nodes: Of branch and bound, in each cluster with a gap; 0 for none of it.

    Raises:
        ValueError: There is no round, or `tolerance` or `max_nodes` is negative.
    """
    if max_rounds < 1:
        raise ValueError(f"max_rounds is {max_rounds}; give at least 1")
    for name, least in {"tolerance": tolerance, "max_nodes": max_nodes}.items():
        if not least >= 0:
            raise ValueError(f"{name} is {least}; give 0 or more")
    given = slots(*jax.lax.stop_gradient(problem), num_detections)
    least = tolerance + rounding(given)

    def more(state: _State) -> Array:
        return (state.limit - state.score > least) & (state.count < max_rounds)

    state = jax.lax.while_loop(
        more,
        lambda state: _round(given, num_detections, state),
        _start(given, num_detections, price, leaf),
    )
    found = answer(problem, state.leaf, state.price)
    if not max_nodes:
        return found
    return branching.branch(problem, num_detections, found, max_nodes, tolerance)


def _start(
    given: Slots, num_detections: int, guess: Array | None, known: Array | None
) -> _State:
    """Gives every copy the prices of its own scan."""
    num_trees, _, num_scans = given.place.shape
    kind = given.log_score.dtype
    price = jnp.zeros((num_scans, num_detections), kind)
    paid = flat(price if guess is None else guess.astype(kind))[given.place]
    own = jnp.moveaxis(paid - paid.mean(-1, keepdims=True), -1, 0)
    leaf = jnp.full(num_trees, -1) if known is None else known
    leaf = leaf.astype(jnp.int32)
    zero, one, count = jnp.zeros((), kind), jnp.ones((), kind), jnp.zeros((), jnp.int32)
    return _State(
        multiplier=own,
        limit=zero + jnp.inf,
        price=price,
        leaf=leaf,
        score=judge(given, leaf, flat(price).size)[0],
        length=one,
        stale=count,
        count=count,
    )


def _round(given: Slots, num_detections: int, state: _State) -> _State:
    """Solves all copies, recovers a selection, and moves the multipliers."""
    wish, value, price = _copies(given, num_detections, state.multiplier)
    table = flat(price)
    agreed = jnp.where(given.there & (wish == wish[:1]).all(0), wish[0], -1)
    leaf = greedy.choose(given, after_paying(given, table), table.size, agreed)
    leaf = greedy.choose_again(given, leaf, table.size, 1)
    score = judge(given, leaf, table.size)[0]
    better, best_score = score > state.score, jnp.maximum(score, state.score)
    limit = gained(given, table)
    nearer = limit < state.limit
    stale = jnp.where(nearer, 0, state.stale + 1)
    tired = stale >= PATIENCE
    length = jnp.where(tired, SHORTER * state.length, state.length)

    leaves = jnp.arange(given.log_score.shape[1])
    copy = (wish[..., None] == leaves[None, None]) & given.there[None, :, None]
    copy = copy.astype(value.dtype)
    apart = copy - copy.mean(0)[None]
    norm = jnp.maximum((apart * apart).sum(), 1.0)  # copies that differ have 1 or more
    largest = jnp.where(given.log_score > -jnp.inf, jnp.abs(given.log_score), 0.0).max()
    target = jnp.where(best_score > -jnp.inf, best_score, value - largest)
    step = length * jnp.where(value > -jnp.inf, value - target, 0.0) / norm
    return _State(
        multiplier=state.multiplier - step * apart,
        limit=jnp.where(value > -jnp.inf, jnp.minimum(limit, state.limit), -jnp.inf),
        price=jnp.where(nearer, price, state.price),
        leaf=jnp.where(better, leaf, state.leaf),
        score=best_score,
        length=length,
        stale=jnp.where(tired, 0, stale),
        count=state.count + 1,
    )


def _copies(
    given: Slots, num_detections: int, multiplier: Array
) -> tuple[Array, Array, Array]:
    """Solves each scan's assignment: leaves [S, N], their value, and prices [S, K]."""
    num_scans = given.place.shape[-1]
    worth = given.log_score[None] / num_scans + multiplier
    matrix = jnp.stack(
        [scan_matrix(given, w, num_detections, s) for s, w in enumerate(worth)]
    )
    found = jax.vmap(best)(matrix)
    leaf = [
        leaves_in(given, w, num_detections, s, found.column[s])
        for s, w in enumerate(worth)
    ]
    price = jnp.where(found.feasible.all(), found.detection_price, 0.0)
    return jnp.stack(leaf).astype(jnp.int32), found.log_score.sum(), price
