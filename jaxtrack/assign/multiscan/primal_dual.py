"""Linear programmes over trees and detections by a primal-dual method with restarts.

Maximise sum(share * score), where the shares of a tree's leaves add up to one and those
of the leaves that use a detection to one at most. Shares follow their reduced scores
and prices follow the demand, in alternation (primal-dual hybrid gradients), each with a
step that fits the number of entries in its row or column. Steps are doubled and pulled
back to an anchor, the less the longer it stands (Halpern's iteration), and the anchor
is set anew where the residual has fallen enough; then the balance between primal and
dual steps is corrected, too. That converges linearly for linear programmes.

Detections are looked up and added up in a flat table, no matrix is made.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import primal_dual, slots
    >>> log_score = jnp.array([[3.0, 0.0], [5.0, 4.0]])
    >>> given = slots.slots(log_score, jnp.array([[[0], [-1]], [[0], [-1]]]), 1)
    >>> point = primal_dual.solve(given, jnp.zeros(2), 400, 1e-4)
    >>> print(jnp.round(point.share, 2).tolist(), point.converged)
    [[1.0, 0.0], [0.0, 1.0]] True

References: Applegate, Diaz, Hinder, Lu, Lubin, O'Donoghue and Schudy, "Practical
large-scale linear programming using primal-dual hybrid gradient", NeurIPS, 2021; Lu and
Yang, "Restarted Halpern PDHG for linear programming", arXiv:2407.16144, 2024; Pock and
Chambolle, "Diagonal preconditioning for first order primal-dual algorithms in convex
optimization", ICCV, 2011.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.multiscan.slots import Slots, gained, used
from jaxtrack.types import Array

EVERY = 20  # steps between looks at how far it has come
ENOUGH, SOME, LONG = 0.2, 0.8, 0.36  # residual, or share of all steps, at a restart
CALM = 0.5  # how much of the old balance is kept


class Point(NamedTuple):
    """What was found.

    Attributes:
        share: [N, L].
        table: Prices, [S (K + 1)].
        residual: The larger of what constraints are violated by, and the gap between
            value and bound relative to 1 and both.
        converged: Whether that is within the tolerance (bool).
        num_iterations: Steps.
    """

    share: Array
    table: Array
    residual: Array
    converged: Array
    num_iterations: Array


class _Place(NamedTuple):
    """Shares [N, L], what a tree gains [N], and prices [S (K + 1)]."""

    share: Array
    gain: Array
    table: Array


class _Steps(NamedTuple):
    """Sizes of steps, in the form of a `_Place`, for a balance of 1."""

    share: Array
    gain: Array
    table: Array


class _State(NamedTuple):
    """Where the steps stand.

    Attributes:
        place: Of the last step.
        anchor: Where the steps since the last restart began.
        since: Steps since then.
        first: Residual of the first of them.
        last: Residual at the last look.
        balance: Size of dual steps over that of primal ones.
        point: The best so far.
        count: Steps in all.
    """

    place: _Place
    anchor: _Place
    since: Array
    first: Array
    last: Array
    balance: Array
    point: Point
    count: Array


def solve(given: Slots, table: Array, max_iterations: int, tolerance: float) -> Point:
    """Solves one linear programme.

    Args:
        given: The problem.
        table: Prices to start at, [S (K + 1)].
        max_iterations: Steps at most, rounded up to a multiple of `EVERY`.
        tolerance: Residual that ends it.
    """
    # Each tree's best score counts 0, and the scores' spread 1.
    finite = given.log_score > -jnp.inf
    top = jnp.where(given.there, given.log_score.max(1, initial=-jnp.inf), 0.0)
    below = jnp.where(finite, given.log_score - top[:, None], 0.0)
    unit = jnp.maximum(-below.min(initial=0.0), 1e-6)
    score = below / unit
    steps = _sizes(given, finite, table)

    def apply(place: _Place, balance: Array) -> _Place:
        return _step(given, finite, score, steps, place, balance)

    def more(state: _State) -> Array:
        return ~state.point.converged & (state.count < max_iterations)

    def go(state: _State) -> _State:
        return _look(given, steps, apply, unit, tolerance, state)

    share = jnp.where(score >= 0, finite.astype(score.dtype), 0.0)
    share = share / jnp.maximum(share.sum(1), 1.0)[:, None]
    begin = _Place(share, jnp.zeros_like(top), table / unit)
    zero, none = jnp.zeros((), score.dtype), jnp.zeros((), jnp.int32)
    point = Point(share, table, zero + jnp.inf, jnp.array(False), none)
    state = _State(
        begin, begin, none, zero + jnp.inf, zero + jnp.inf, zero + 1, point, none
    )
    final = jax.lax.while_loop(more, go, state)
    return final.point._replace(num_iterations=final.count)


def _sizes(given: Slots, finite: Array, table: Array) -> _Steps:
    """Returns the reciprocals of the numbers of entries in columns and rows."""
    kind = given.log_score.dtype
    num_scans = given.place.shape[-1]
    width = table.size // num_scans
    many = (given.place % width < width - 1).sum(-1) + 1
    leaves = finite.astype(kind)
    return _Steps(
        share=1 / many.astype(kind),
        gain=1 / jnp.maximum(leaves.sum(1), 1.0),
        table=1 / jnp.maximum(used(given, leaves, table), 1.0),
    )


def _step(
    given: Slots,
    finite: Array,
    score: Array,
    steps: _Steps,
    place: _Place,
    balance: Array,
) -> _Place:
    """Moves shares along reduced scores, and then prices along the demand."""
    share, gain, table = place
    rise = score - gain[:, None] - table[given.place].sum(-1)
    moved = jnp.maximum(share + steps.share / balance * rise, 0.0)
    moved = jnp.where(finite, moved, 0.0)
    ahead = 2 * moved - share
    width = table.size // given.place.shape[-1]
    real = jnp.arange(table.size) % width < width - 1
    raised = table + balance * steps.table * (used(given, ahead, table) - 1)
    lifted = gain + balance * steps.gain * (ahead.sum(1) - 1)
    return _Place(
        share=moved,
        gain=jnp.where(given.there, lifted, 0.0),
        table=jnp.where(real, jnp.maximum(raised, 0.0), 0.0),
    )


def _look(
    given: Slots,
    steps: _Steps,
    apply: Callable[[_Place, Array], _Place],
    unit: Array,
    tolerance: float,
    state: _State,
) -> _State:
    """Takes `EVERY` steps, and sees whether to stop, or to set a new anchor."""

    def halpern(k: Array, both: tuple[_Place, _Place]) -> tuple[_Place, _Place]:
        place, _ = both
        after = apply(place, state.balance)
        weight = (state.since + k + 1).astype(unit.dtype)
        weight = weight / (weight + 1)
        new = jax.tree.map(
            lambda now, then, old: weight * (2 * then - now) + (1 - weight) * old,
            place,
            after,
            state.anchor,
        )
        return new, place

    place, before = jax.lax.fori_loop(0, EVERY, halpern, (state.place, state.place))
    after = apply(place, state.balance)
    primal, dual = _lengths(steps, after, place)
    residual = jnp.sqrt(state.balance * primal + dual / state.balance)
    point = better(given, after.share, unit * after.table, tolerance, state.point)
    since, count = state.since + EVERY, state.count + EVERY
    fell = residual <= ENOUGH * state.first
    stuck = (residual <= SOME * state.first) & (residual > state.last)
    anew = fell | stuck | (since >= LONG * count)
    moved, raised = _lengths(steps, after, state.anchor)
    sound = (moved > 0) & (raised > 0)
    ratio = jnp.where(sound, raised, 1.0) / jnp.where(sound, moved, 1.0)
    tilt = jnp.exp(CALM * jnp.log(state.balance) + (1 - CALM) * 0.5 * jnp.log(ratio))

    def choose(new: _Place, old: _Place) -> _Place:
        return jax.tree.map(lambda x, y: jnp.where(anew, x, y), new, old)

    return _State(
        place=choose(after, place),
        anchor=choose(after, state.anchor),
        since=jnp.where(anew, 0, since),
        first=jnp.where(anew, residual, jnp.minimum(state.first, 1e30)),
        last=jnp.where(anew, jnp.inf, residual),
        balance=jnp.where(anew & sound, tilt, state.balance),
        point=point,
        count=count,
    )


def _lengths(steps: _Steps, one: _Place, other: _Place) -> tuple[Array, Array]:
    """Returns the squared distances of shares, and of prices, weighted by steps."""
    apart = jax.tree.map(lambda x, y: (x - y) ** 2, one, other)
    dual = (apart.gain / steps.gain).sum() + (apart.table / steps.table).sum()
    return (apart.share / steps.share).sum(), dual


def better(
    given: Slots, share: Array, table: Array, tolerance: float, best: Point
) -> Point:
    """Returns the better of shares and prices [S (K + 1)], and an older point."""
    total = share.sum(1)
    lacking = jnp.where(given.there, jnp.abs(total - 1), 0.0).max(initial=0.0)
    over = (used(given, share, table) - 1).max(initial=0.0)
    score = jnp.where(share > 0, given.log_score, 0.0)
    value, limit = (share * score).sum(), gained(given, table)
    gap = jnp.abs(limit - value) / (1 + jnp.abs(limit) + jnp.abs(value))
    residual = jnp.maximum(jnp.maximum(lacking, over), gap)
    new = Point(share, table, residual, residual <= tolerance, best.num_iterations)
    nearer = residual < best.residual
    return jax.tree.map(lambda x, y: jnp.where(nearer, x, y), new, best)
