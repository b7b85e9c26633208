"""Linear programmes over trees and detections by a primal-dual interior point method.

Maximise sum(share * score), where the shares of a tree's leaves add up to one and those
of the leaves that use a detection to one at most. Newton's method, with a predictor and
a corrector, on the conditions of an optimum in which every share times what its leaf
lacks to the best is one small number, and so is every price times what its detection
has to spare; that number goes to zero in some ten to twenty rounds. Shares and the
gains of trees are eliminated, so that a round solves one dense system in the prices.
Where many shares are optimal it ends amid all of them, whatever the order of leaves.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import interior, slots
    >>> log_score = jnp.array([[3.0, 0.0], [5.0, 4.0]])
    >>> given = slots.slots(log_score, jnp.array([[[0], [-1]], [[0], [-1]]]), 1)
    >>> point = interior.solve(given, 1, 50, 1e-4)
    >>> print(jnp.round(point.share, 2).tolist(), point.converged)
    [[1.0, 0.0], [0.0, 1.0]] True

Reference: Mehrotra, "On the implementation of a primal-dual interior point method",
SIAM Journal on Optimization 2(4), 1992.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.multiscan.primal_dual import Point, better
from jaxtrack.assign.multiscan.slots import Slots, used
from jaxtrack.assign.multiscan.system import factorize, solve_system
from jaxtrack.types import Array

NEAR = 0.995  # how far to go, at most, to where a share or a price is zero


class Place(NamedTuple):
    """A point inside; all but `gain` are positive, or 1 where there is nothing.

    Attributes:
        share: [N, L].
        spare: What is left of each detection, [S (K + 1)].
        gain: Of each tree, [N].
        table: Prices, [S (K + 1)].
        lack: What each leaf lacks to its tree's gain, [N, L].
    """

    share: Array
    spare: Array
    gain: Array
    table: Array
    lack: Array


class _Frame(NamedTuple):
    """What does not change from round to round.

    Attributes:
        finite: Whether there is a leaf, [N, L] (bool).
        real: Whether a place is that of a detection, [S (K + 1)] (bool).
        score: Divided by their spread, the best of each tree 0, [N, L].
        unit: That spread.
        heat: Temperature in that unit, or None.
    """

    finite: Array
    real: Array
    score: Array
    unit: Array
    heat: Array | None


def solve(
    given: Slots, num_detections: int, max_rounds: int, tolerance: float
) -> Point:
    """Solves one linear programme.

    Args:
        given: The problem.
        num_detections: K.
        max_rounds: Rounds at most.
        tolerance: Residual that ends it, as in `primal_dual`.
    """

    def judge(place: Place, share: Array, table: Array, point: Point) -> Point:
        return better(given, share, table, tolerance, point)

    return follow(given, num_detections, max_rounds, None, judge)[1]


def follow(
    given: Slots,
    num_detections: int,
    max_rounds: int,
    temperature: Array | None,
    judge: Callable[[Place, Array, Array, Point], Point],
) -> tuple[Place, Point]:
    """Goes inwards to the optimum, round by round.

    Args:
        given: The problem.
        num_detections: K.
        max_rounds: Rounds at most.
        temperature: Of the entropy in the objective; None for a linear programme.
        judge: (place, share [N, L], prices [S (K + 1)], best point) -> best point.

    Returns:
        The last place, in scores divided by their spread, and the best point.
    """
    frame = _frame(given, num_detections, temperature)

    def more(state: tuple[Place, Point, Array]) -> Array:
        _, point, going = state
        return going & ~point.converged & (point.num_iterations < max_rounds)

    def go(state: tuple[Place, Point, Array]) -> tuple[Place, Point, Array]:
        place, point, _ = state
        new = _round(given, frame, place)
        finite = jax.tree.map(lambda x: jnp.isfinite(x).all(), new)
        sound = jax.tree.reduce(jnp.logical_and, finite)
        place = jax.tree.map(lambda x, y: jnp.where(sound, x, y), new, place)
        table = jnp.where(frame.real, frame.unit * place.table, 0.0)
        found = judge(place, jnp.where(frame.finite, place.share, 0.0), table, point)
        return place, found._replace(num_iterations=point.num_iterations + 1), sound

    zero = jnp.zeros(frame.real.shape, frame.score.dtype)
    inf, none = jnp.zeros_like(frame.unit) + jnp.inf, jnp.zeros((), jnp.int32)
    point = Point(jnp.zeros_like(frame.score), zero, inf, jnp.array(False), none)
    start = _begin(given, frame), point, jnp.array(True)
    return jax.lax.while_loop(more, go, start)[:2]


def _frame(given: Slots, num_detections: int, temperature: Array | None) -> _Frame:
    """Scales a problem so that the best of a tree has score 0, and the worst -1."""
    finite = given.log_score > -jnp.inf
    top = jnp.where(given.there, given.log_score.max(1, initial=-jnp.inf), 0.0)
    below = jnp.where(finite, given.log_score - top[:, None], 0.0)
    unit = jnp.maximum(-below.min(initial=0.0), 1e-6)
    size = given.place.shape[-1] * (num_detections + 1)
    real = jnp.arange(size) % (num_detections + 1) < num_detections
    heat = None if temperature is None else temperature / unit
    return _Frame(finite, real, below / unit, unit, heat)


def _begin(given: Slots, frame: _Frame) -> Place:
    """Starts with equal shares, and prices and gains at which no leaf is worth it."""
    finite, real, score = frame[:3]
    count = jnp.maximum(finite.sum(1), 1)[:, None]
    share = jnp.where(finite, 1 / count, 1.0).astype(score.dtype)
    table = jnp.where(real, 0.1, 0.0).astype(score.dtype)
    paid = score - table[given.place].sum(-1)
    gain = jnp.where(finite, paid, -jnp.inf).max(1, initial=-jnp.inf)
    gain = jnp.where(given.there, gain + 0.1, 0.0)
    lack = jnp.where(finite, gain[:, None] - paid, 1.0)
    left = 1 - used(given, jnp.where(finite, share, 0.0), table)
    table = jnp.where(real, table, 1.0)
    return Place(share, jnp.maximum(left, 0.1), gain, table, lack)


def _round(given: Slots, frame: _Frame, place: Place) -> Place:
    """Predicts, corrects, and goes as far as all stays positive."""
    move = _newton(given, frame, place)
    together = frame.heat is not None

    def products(at: Place) -> Array:
        leaves = jnp.where(frame.finite, at.share * at.lack, 0.0).sum()
        return leaves + jnp.where(frame.real, at.spare * at.table, 0.0).sum()

    share, spare, _, table, lack = place
    first = move(-share * lack, -spare * table)
    now = products(place)
    ratio = products(_advance(place, first, 1.0, together)) / now
    aim = now / (frame.finite.sum() + frame.real.sum()) * ratio**3
    second = move(
        aim - share * lack - first.share * first.lack,
        aim - spare * table - first.spare * first.table,
    )
    return _advance(place, second, NEAR, together)


def _newton(
    given: Slots, frame: _Frame, place: Place
) -> Callable[[Array, Array], Place]:
    """Makes the solver of the linear equations of a round.

    Returns:
        (changes of share * lack [N, L], of spare * table [S (K + 1)]) -> changes.
    """
    share, spare, gain, table, lack = place
    finite, real, score, _, heat = frame
    held = jnp.where(finite, share, 0.0)
    prices = jnp.where(real, table, 0.0)
    if heat is None:
        stiff, bend = lack, jnp.zeros_like(lack)
        off = bend  # true of the start; from rounding it cannot be told
    else:
        stiff, bend = lack + heat, jnp.where(finite, heat / share, 0.0)
        rise = gain[:, None] + prices[given.place].sum(-1) - score
        off = jnp.where(finite, rise + heat * jnp.log(share) - lack, 0.0)
    width = jnp.where(finite, share / stiff, 0.0)
    system = factorize(given, width, spare / table)
    short = jnp.where(given.there, 1 - held.sum(1), 0.0)
    free = jnp.where(real, 1 - used(given, held, table) - spare, 0.0)

    def respond(base: Array, spared: Array, trees: Array, right: Array) -> Place:
        """Solves for gains and prices; shares and what is spared go with them."""
        gains, changes = solve_system(system, trees, jnp.where(real, right, 0.0))
        gains = jnp.where(given.there, gains, 0.0)
        changes = jnp.where(real, changes, 0.0)
        lacks = jnp.where(finite, gains[:, None] + changes[given.place].sum(-1), 0.0)
        spared = spared - jnp.where(real, spare / table * changes, 0.0)
        return Place(base - width * lacks, spared, gains, changes, lacks)

    def move(leaves: Array, detections: Array) -> Place:
        """Solves, and solves once more for what rounding left."""
        base = jnp.where(finite, (leaves - share * off) / stiff, 0.0)
        spared = jnp.where(real, detections / table, 0.0)
        right = used(given, base, table) + spared - free
        first = respond(base, spared, base.sum(1) - short, right)
        trees = first.share.sum(1) - short
        right = used(given, first.share, table) + first.spare - free
        none = jnp.zeros_like(base), jnp.zeros_like(spared)
        both = jax.tree.map(jnp.add, first, respond(*none, trees, right))
        return both._replace(lack=both.lack + bend * both.share + off)

    return move


def _advance(place: Place, change: Place, near: float, together: bool) -> Place:
    """Goes along a change, shares and prices each as far as they stay positive."""

    def room(at: Array, by: Array) -> Array:
        falls = by < 0
        ratio = jnp.where(falls, -at / jnp.where(falls, by, -1.0), jnp.inf)
        return ratio.min(initial=jnp.inf)

    primal = jnp.minimum(
        room(place.share, change.share), room(place.spare, change.spare)
    )
    dual = jnp.minimum(room(place.table, change.table), room(place.lack, change.lack))
    primal, dual = jnp.minimum(near * primal, 1.0), jnp.minimum(near * dual, 1.0)
    if together:
        primal = dual = jnp.minimum(primal, dual)
    return Place(
        share=place.share + primal * change.share,
        spare=place.spare + primal * change.spare,
        gain=place.gain + dual * change.gain,
        table=place.table + dual * change.table,
        lack=place.lack + dual * change.lack,
    )
