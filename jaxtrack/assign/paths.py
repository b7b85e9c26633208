"""Shortest augmenting paths: places rows at columns, or leaves them at their own price.

Every row starts at its cheapest column; those that find it taken are placed one after
another, each by a Dijkstra search over columns. A row that no column takes pays its
miss, so no columns are added for misses.

All searches are one flat loop: an iteration scans one row of one search and, where that
ends it, swaps the columns along the path and goes on with the next row. So no problem
waits for the inner loops of another. Which columns are on a path is kept as bits, so
that the swap is done at once. The functions are for R problems, the last axis (see
`jaxtrack.assign.lanes`).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import paths
    >>> cost = jnp.array([[1.0, 3.0], [1.0, 5.0]])
    >>> print(paths.place(cost, jnp.array([9.0, 9.0]))[0])
    [1 0]

References: Jonker and Volgenant, "A shortest augmenting path algorithm for dense and
sparse linear assignment problems", Computing 38, 1987; Crouse, "On implementing 2D
rectangular assignment algorithms", IEEE Trans. Aerospace and Electronic Systems 52(4),
2016.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.assign.lanes import lanes
from jaxtrack.types import Array

WORD = 32  # columns whose membership in a path one integer tells


class _State(NamedTuple):
    """Where the searches of R problems stand.

    Attributes:
        row: Which row holds each column, -1 if none, [K, R].
        price: Dual potential of each column, never positive, [K, R].
        waiting: Rows yet to be placed, [N, R].
        feasible: No row was left without a place, [R].
        at: The row from which the search goes on, [R]; N when all is done.
        head: The column it held, [R]; K at the start of a search.
        reach: Distance of that column, [R].
        distance: Least known distance of each column, [K, R].
        closed: Whether that is final and the column's row was scanned, [K, R].
        source: The row from which it was reached, [K, R].
        path: Columns on the way to that row, bits of [W, K, R].
        trail: Columns on the way to `at`, [W, R].
        exit: Least distance of a row that would rather be missed, [R].
        exit_path: Columns on the way to that row, [W, R].
    """

    row: Array
    price: Array
    waiting: Array
    feasible: Array
    at: Array
    head: Array
    reach: Array
    distance: Array
    closed: Array
    source: Array
    path: Array
    trail: Array
    exit: Array
    exit_path: Array


def _start(cost: Array, miss: Array) -> _State:
    """Gives each row its cheapest column, where no earlier row wants the same."""
    num_rows, num_columns, number = cost.shape
    words = -(-num_columns // WORD)
    rows = _count(num_rows)[:, None, None]
    columns = _count(num_columns)[None, :, None]
    cheapest = cost.min(1, initial=jnp.inf)  # [N, R]
    first = jnp.where(cost <= cheapest[:, None], columns, num_columns).min(
        1, initial=num_columns
    )
    wants = (columns == first[:, None]) & (cheapest < miss)[:, None]
    row = jnp.where(wants, rows, num_rows).min(0, initial=num_rows)
    waiting = (wants & (row[None] != rows)).any(1)
    shape = num_columns, number
    empty = jnp.zeros((words, number), jnp.uint32)
    return _State(
        row=jnp.where(row < num_rows, row, -1),
        price=jnp.zeros(shape, cost.dtype),
        waiting=waiting,
        feasible=(jnp.minimum(cheapest, miss) < jnp.inf).all(0),
        at=_first(waiting),
        head=jnp.full(number, num_columns, jnp.int32),
        reach=jnp.zeros(number, cost.dtype),
        distance=jnp.full(shape, jnp.inf, cost.dtype),
        closed=jnp.zeros(shape, bool),
        source=jnp.zeros(shape, jnp.int32),
        path=jnp.zeros((words, *shape), jnp.uint32),
        trail=empty,
        exit=jnp.full(number, jnp.inf, cost.dtype),
        exit_path=empty,
    )


def _first(flags: Array) -> Array:
    """Returns the first row [R] whose flag [N, R] is set, N where none is."""
    num_rows = flags.shape[0]
    return jnp.where(flags, _count(num_rows)[:, None], num_rows).min(0)


def _count(number: int) -> Array:
    return jnp.arange(number, dtype=jnp.int32)


def _bits(num_columns: int) -> Array:
    """Returns the bit of each column, in the word that holds it, [W, K, 1]."""
    column = np.arange(num_columns)
    word = np.arange(-(-num_columns // WORD))[:, None]
    bit = np.uint32(1) << (column % WORD).astype(np.uint32)
    return jnp.asarray(np.where(column // WORD == word, bit, np.uint32(0))[..., None])


def _scan(cost: Array, miss: Array, state: _State) -> _State:
    """Looks from each row at which a search stands for shorter ways to columns."""
    num_rows, num_columns, _ = cost.shape
    columns = _count(num_columns)[:, None]
    at = jnp.minimum(state.at, num_rows - 1)
    # Reduced costs, so that the row's own column lies at distance `reach`.
    reduced = jnp.take_along_axis(cost, at[None, None], axis=0)[0] - state.price
    own = jnp.where(columns == state.head[None], reduced, 0.0).sum(0)
    offset = jnp.where(state.head == num_columns, 0.0, own - state.reach)
    distance = reduced - offset[None]
    leave = jnp.take_along_axis(miss, at[None], axis=0)[0] - offset
    nearer = ~state.closed & (distance < state.distance)
    leaves = leave < state.exit
    return state._replace(
        distance=jnp.where(nearer, distance, state.distance),
        source=jnp.where(nearer, at[None], state.source),
        path=jnp.where(nearer[None], state.trail[:, None], state.path),
        exit=jnp.where(leaves, leave, state.exit),
        exit_path=jnp.where(leaves[None], state.trail, state.exit_path),
    )


def _move(state: _State) -> _State:
    """Goes to the nearest column; a free one, or a nearer exit, ends the search."""
    num_rows, num_columns = state.waiting.shape[0], state.row.shape[0]
    columns, bit = _count(num_columns)[:, None], _bits(num_columns)
    open_distance = jnp.where(state.closed, jnp.inf, state.distance)
    reach = open_distance.min(0, initial=jnp.inf)
    nearest = jnp.where(open_distance <= reach[None], columns, num_columns)
    head = nearest.min(0, initial=num_columns)
    here = columns == head[None]
    holder = jnp.where(here, state.row, 0).sum(0, dtype=jnp.int32)
    step = jnp.where(here[None], state.path | bit, 0)
    trail = step.sum(1, dtype=jnp.uint32)

    missed = state.exit <= reach
    end = jnp.minimum(reach, state.exit)
    idle = state.at == num_rows
    done = missed | (holder < 0) | idle
    placed = done & (end < jnp.inf) & ~idle
    path = jnp.where(missed[None], state.exit_path, trail)
    along = ((path[:, None] & bit) != 0).any(0) & placed[None]
    paid = jnp.where(state.closed, jnp.minimum(state.distance - end[None], 0.0), 0.0)
    begun = _count(num_rows)[:, None] == _first(state.waiting)[None]
    waiting = state.waiting & ~(done[None] & begun)
    return state._replace(
        row=jnp.where(along, state.source, state.row),
        price=state.price + jnp.where(placed[None], paid, 0.0),
        waiting=waiting,
        feasible=state.feasible & (placed | idle | ~done),
        at=jnp.where(done, _first(waiting), holder),
        head=jnp.where(done, num_columns, head),
        reach=jnp.where(done, 0.0, reach),
        distance=jnp.where(done[None], jnp.inf, state.distance),
        closed=(state.closed | here) & ~done[None],
        trail=jnp.where(done[None], 0, trail),
        exit=jnp.where(done, jnp.inf, state.exit),
        exit_path=jnp.where(done[None], 0, state.exit_path),
    )


@lanes
def place(cost: Array, miss: Array) -> tuple[Array, Array, Array, Array]:
    """Places the rows of R problems.

    Args:
        cost: [N, K, R], inf where impossible.
        miss: [N, R], inf where impossible.

    Returns:
        The column of each row, K where it is missed, [N, R]; whether each has a place,
        [R]; and the potentials of rows [N, R] and columns [K, R].
    """
    num_rows, num_columns, number = cost.shape
    if not num_rows:
        return miss.astype(jnp.int32), jnp.ones(number, bool), miss, cost.sum(0)
    state = jax.lax.while_loop(
        lambda state: (state.at < num_rows).any(),
        lambda state: _move(_scan(cost, miss, state)),
        _start(cost, miss),
    )
    taken = state.row[None] == _count(num_rows)[:, None, None]  # [N, K, R]
    columns = _count(num_columns)[None, :, None]
    column = jnp.where(taken, columns, num_columns).min(1, initial=num_columns)
    own = jnp.where(taken, cost - state.price[None], 0.0).sum(1)
    price = jnp.where(column < num_columns, own, miss)
    price = jnp.where(price < jnp.inf, price, 0.0)
    return column, state.feasible, price, state.price
