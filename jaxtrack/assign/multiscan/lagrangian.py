"""Lagrangian relaxation: prices on detections, and selections recovered at them.

Whether a detection is used twice is left to its price, of all scans or of all but one.
Then every tree takes its best leaf, or trees and the detections of the scan that is
kept are assigned to each other (`jaxtrack.assign.best`). Prices of detections in demand
rise and others fall, by Polyak's step: as far as the bound would have to fall to reach
the best selection known. At each round's prices a selection is recovered, and in the
end the best one is given with the least bound, so that the gap tells what may be lost.

The least bound is the value of the linear relaxation (`relax`), whichever scan is kept:
where that has a gap, so has this, and no number of rounds closes it.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import lagrangian, problem
    >>> log_score = jnp.array([[3.0, 0.0], [5.0, 4.0]])
    >>> detection = jnp.array([[[0], [-1]], [[0], [-1]]])
    >>> given = problem.Problem(log_score, detection)
    >>> found = lagrangian.lagrangian(given, num_detections=1)
    >>> print(found.leaf, found.log_score, found.log_bound)
    [0 1] 7.0 7.0

References: Poore and Robertson, "A new Lagrangian relaxation based algorithm for a
class of multidimensional assignment problems", Computational Optimization and
Applications 8(2), 1997; Deb, Yeddanapudi, Pattipati and Bar-Shalom, "A generalized S-D
assignment algorithm for multisensor-multitarget state estimation", IEEE Trans.
Aerospace and Electronic Systems 33(2), 1997; Polyak, "Minimization of unsmooth
functionals", USSR Computational Mathematics and Mathematical Physics 9(3), 1969.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.best import best
from jaxtrack.assign.multiscan import greedy
from jaxtrack.assign.multiscan.problem import Answer, Problem, answer
from jaxtrack.assign.multiscan.slots import (
    Slots,
    after_paying,
    flat,
    judge,
    leaves_in,
    rounding,
    scan_matrix,
    slots,
    unflat,
    used,
)
from jaxtrack.types import Array

PATIENCE = 4  # rounds without a better bound, after which steps become shorter
SHORTER = 0.7


class _State(NamedTuple):
    """Where the rounds stand.

    Attributes:
        table: Prices, [S (K + 1)].
        limit: Least bound so far.
        at: Prices of that bound.
        leaf: Best selection so far, [N].
        score: Its score; -inf if none is known.
        length: Of steps, relative to Polyak's.
        stale: Rounds since the bound fell.
        count: Rounds.
    """

    table: Array
    limit: Array
    at: Array
    leaf: Array
    score: Array
    length: Array
    stale: Array
    count: Array


def lagrangian(
    problem: Problem,
    num_detections: int,
    max_rounds: int = 100,
    tolerance: float = 1e-6,
    keep: int | None = None,
    price: Array | None = None,
    leaf: Array | None = None,
) -> Answer:
    """Searches for prices with a small bound and for selections at them.

    The gradient of `log_score` is that of the chosen scores; the rest is constant.

    Args:
        problem: [N, L] and [N, L, S].
        num_detections: K, detections of a scan at most.
        max_rounds: Rounds at most.
        tolerance: Gap, in the unit of the scores and beyond their rounding, that ends
            the search.
        keep: The scan whose detections are assigned rather than priced; None prices
            those of all scans.
        price: What detections may cost, to begin with, none below 0, [S, K]; all 0 if
            None. A good guess saves rounds.
        leaf: A feasible selection, to begin with, [N]; None if none is known.

    Raises:
        ValueError: There is no round, or no such scan.
    """
    num_scans = problem.detection.shape[-1]
    if max_rounds < 1:
        raise ValueError(f"max_rounds is {max_rounds}; give at least 1")
    if keep is not None and not -num_scans <= keep < num_scans:
        raise ValueError(f"keep is {keep}; there are {num_scans} scans")
    fixed = jax.lax.stop_gradient(problem)
    given = slots(*fixed, num_detections)
    kept = None if keep is None else keep % num_scans
    least = tolerance + rounding(given)

    def more(state: _State) -> Array:
        return (state.limit - state.score > least) & (state.count < max_rounds)

    def go(state: _State) -> _State:
        return _round(given, num_detections, kept, state)

    state = jax.lax.while_loop(
        more, go, _start(given, num_detections, price, leaf, kept)
    )
    return answer(problem, state.leaf, unflat(state.at, num_detections))


def _start(
    given: Slots,
    num_detections: int,
    guess: Array | None,
    known: Array | None,
    kept: int | None,
) -> _State:
    kind = given.log_score.dtype
    table = jnp.zeros((given.place.shape[-1], num_detections), kind)
    none = flat(table)
    if guess is not None:
        table = guess.astype(kind)
    if kept is not None:
        table = table.at[kept].set(0.0)
    leaf = jnp.full(len(given.log_score), -1) if known is None else known
    leaf = leaf.astype(jnp.int32)
    score = judge(given, leaf, none.size)[0]
    zero, one = jnp.zeros((), kind), jnp.ones((), kind)
    count = jnp.zeros((), jnp.int32)
    return _State(flat(table), zero + jnp.inf, none, leaf, score, one, count, count)


def _round(
    given: Slots, num_detections: int, kept: int | None, state: _State
) -> _State:
    """Solves at the present prices, recovers a selection, and moves the prices."""
    worth = after_paying(given, state.table)
    if kept is None:
        wish, full = jnp.argmax(worth, axis=1), state.table
        value = jnp.where(given.there, worth.max(1), 0.0).sum() + state.table.sum()
    else:
        wish, full, value = _assigned(given, worth, num_detections, kept, state.table)
    excess, alone = _wanted(given, wish, full)
    held = jnp.where(alone, wish, -1).astype(jnp.int32)
    leaf = greedy.choose(given, after_paying(given, full), full.size, held)
    leaf = greedy.choose_again(given, leaf, full.size, 1)
    score = judge(given, leaf, full.size)[0]
    better, nearer = score > state.score, value < state.limit
    best_score = jnp.maximum(score, state.score)
    stale = jnp.where(nearer, 0, state.stale + 1)
    tired = stale >= PATIENCE
    length = jnp.where(tired, SHORTER * state.length, state.length)

    real = (jnp.arange(full.size) % (num_detections + 1)) < num_detections
    if kept is not None:
        real &= jnp.arange(full.size) // (num_detections + 1) != kept
    moves = real & ((state.table > 0) | (excess > 0))
    excess = jnp.where(moves, excess, 0.0)
    norm = (excess * excess).sum()
    spread = jnp.where(given.log_score > -jnp.inf, jnp.abs(given.log_score), 0.0)
    target = jnp.where(best_score > -jnp.inf, best_score, value - spread.max())
    far = jnp.where(value > -jnp.inf, value - target, 0.0)
    step = length * far / jnp.maximum(norm, 1.0)
    return _State(
        table=jnp.where(real, jnp.maximum(state.table + step * excess, 0.0), 0.0),
        limit=jnp.minimum(value, state.limit),
        at=jnp.where(nearer, full, state.at),
        leaf=jnp.where(better, leaf, state.leaf),
        score=best_score,
        length=length,
        stale=jnp.where(tired, 0, stale),
        count=state.count + 1,
    )


def _wanted(given: Slots, wish: Array, table: Array) -> tuple[Array, Array]:
    """Returns by how much detections are wanted too often, and who wants his alone."""
    leaves = jnp.arange(given.log_score.shape[1])
    share = (wish[:, None] == leaves[None]) & (given.log_score > -jnp.inf)
    demand = used(given, share.astype(table.dtype), table)
    place = jnp.take_along_axis(given.place, wish[:, None, None], axis=1)[:, 0]
    return demand - 1, share.any(1) & (demand[place] <= 1).all(1)


def _assigned(
    given: Slots, worth: Array, num_detections: int, kept: int, table: Array
) -> tuple[Array, Array, Array]:
    """Assigns the detections of one scan: the leaves, all prices, and the bound."""
    matrix = scan_matrix(given, worth, num_detections, kept)
    found = best(matrix)
    leaf = leaves_in(given, worth, num_detections, kept, found.column)
    price = unflat(table, num_detections).at[kept].set(found.detection_price)
    return leaf, flat(price), found.log_score + table.sum()
