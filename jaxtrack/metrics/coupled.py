"""Assignments at T times, coupled by a price for every change: a linear programme.

    least of  sum over times of <C, W> + g sum of |W[t + 1] - W[t]|

over matrices W [N, L] at each of T times that are not negative and whose rows and
columns sum to at most one, where C is not positive. `solve` is batched and says how far
from the optimum it may be; `exact` asks HiGHS, on the host, for one problem.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import coupled
    >>> cost = -jnp.array([[[1.0, 0.2]], [[0.2, 1.0]]])  # two times, one row
    >>> found = coupled.solve(cost, change_cost=0.1)
    >>> print(f"{found.lower:.3f} {found.upper:.3f}")
    -1.800 -1.800
    >>> print(found.weight[:, 0])
    [[1. 0.]
     [0. 1.]]

The steps of `splitting` give prices, `chains` a bound from them and an integral W.
Where the optimum is not integral, the W of the steps, made feasible, comes near it. The
bounds hold at every step, up to rounding, so the number of steps decides only how far
apart they are.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize, sparse

from jaxtrack.assign.lanes import lanes
from jaxtrack.metrics import chains, splitting
from jaxtrack.types import Array

BURST = 12  # steps before the first bound; then it is half of those made
WIDTH = 32  # problems side by side


class Coupled(NamedTuple):
    """A feasible W and how far from the least cost it is.

    Attributes:
        weight: W, [T, N, L].
        lower: No W costs less than this.
        upper: What `weight` costs.
    """

    weight: Any
    lower: Any
    upper: Any


class _State(NamedTuple):
    """Where R problems stand: `Coupled` with R last, the steps and their number."""

    best: Coupled
    split: splitting.Split
    num_steps: Array


def solve(
    cost: Array,
    change_cost: Array | float,
    offset: Array | float = 0.0,
    tolerance: Array | float = 1e-3,
    max_steps: Array | int = 2000,
) -> Coupled:
    """Solves the programme until the bounds are near enough, or steps run out.

    Near enough is upper - lower <= tolerance |offset + upper|, or what rounding allows.
    The derivative is zero: where the weight is unique, it is locally constant.

    Args:
        cost: C, finite, from -1 to 0, [T, N, L].
        change_cost: g, not negative.
        offset: A constant that belongs to the cost, for the tolerance.
        tolerance: Relative. Below 1e-6 it is reached where the optimum is integral, as
            it nearly always is; elsewhere not, since steps are made in float32.
        max_steps: At which to stop anyway, rounded up.
    """
    if not cost.size:
        zero = jnp.zeros((), cost.dtype)
        return Coupled(jnp.zeros_like(cost), zero, zero)
    scalars = change_cost, offset, tolerance
    fixed = jax.lax.stop_gradient(
        (cost, *(jnp.asarray(x, cost.dtype) for x in scalars))
    )
    return Coupled(*_solve(*fixed, jnp.asarray(max_steps)))


def _solve_many(*problems: Array) -> Coupled:
    """Solves R problems, the last axis of everything.

    A pass makes a burst of steps on those that are not near enough, in blocks, so that
    none waits for others.
    """
    # What is picked lies together in memory when the problem comes first.
    given = tuple(jnp.moveaxis(x, -1, 0) for x in problems)
    cost, change_cost, offset, tolerance, max_steps = given
    number = len(cost)
    width = -(-number // -(-number // WIDTH))

    def is_open(state: _State) -> Array:
        gap = state.best.upper - state.best.lower
        allowed = _allowed(state.best.upper, offset, tolerance)
        return ~(gap <= allowed) & (state.num_steps < max_steps)

    def go_on(state: _State) -> _State:
        open_ = is_open(state)
        left, order = open_.sum(), jnp.argsort(~open_)
        burst = jnp.maximum(jnp.where(open_, state.num_steps, 0).max() // 2, BURST)

        def block(carry: tuple[Array, _State]) -> tuple[Array, _State]:
            begin, state = carry
            place = begin + jnp.arange(width)
            index = order[jnp.minimum(place, number - 1)]
            some = jax.tree.map(lambda x: _last(x[index]), (cost, change_cost, state))
            better = _improve(some[0], some[1], some[2], burst)
            target = jnp.where(place < left, index, number)  # beyond: not written
            return begin + width, jax.tree.map(
                lambda x, y: x.at[target].set(_first(y), mode="drop"), state, better
            )

        all_blocks = jnp.array(0), state
        return jax.lax.while_loop(lambda c: c[0] < left, block, all_blocks)[1]

    begin = jax.tree.map(_first, _start(problems[0]))
    found = jax.lax.while_loop(lambda s: is_open(s).any(), go_on, begin).best
    return jax.tree.map(_last, found)


_solve = lanes(_solve_many)


def _last(x: Array) -> Array:
    return jnp.moveaxis(x, 0, -1)


def _first(x: Array) -> Array:
    return jnp.moveaxis(x, -1, 0)


def _allowed(upper: Array, offset: Array, tolerance: Array) -> Array:
    """Returns how far apart the bounds may be."""
    # Sums of so many terms are not known better.
    rounding = 64 * jnp.finfo(upper.dtype).eps * (1 + jnp.abs(offset))
    return jnp.maximum(tolerance * jnp.abs(offset + upper), rounding)


def _start(cost: Array) -> _State:
    """Returns weight zero and no bound."""
    zero = jnp.zeros_like(cost[0, 0, 0])
    nothing = Coupled(jnp.zeros_like(cost), zero - jnp.inf, zero)
    return _State(nothing, splitting.start(cost), jnp.zeros(zero.shape, int))


def _improve(cost: Array, change_cost: Array, state: _State, steps: Array) -> _State:
    """Makes some steps, and keeps the best bounds."""
    split = splitting.steps(cost, change_cost, state.split, steps)
    price = splitting.prices(split).astype(cost.dtype)
    _, message, lower = chains.bound(cost, change_cost, cost + price[:, None])
    best = state.best._replace(lower=jnp.maximum(state.best.lower, lower))
    for weight in (
        chains.rounded(cost, change_cost, message),
        splitting.weights(cost, split).astype(cost.dtype),
    ):
        upper = (cost * weight).sum((0, 1, 2)) + changes(weight, change_cost)
        less = upper < best.upper
        best = best._replace(
            weight=jnp.where(less[None, None, None], weight, best.weight),
            upper=jnp.where(less, upper, best.upper),
        )
    return _State(best, split, state.num_steps + steps)


def changes(weight: Array, change_cost: Any) -> Array:
    """Returns g times the sum of all changes of W [T, N, L, ...] in time, [...]."""
    return change_cost * jnp.abs(weight[1:] - weight[:-1]).sum((0, 1, 2))


def exact(cost: np.ndarray, change_cost: float) -> Coupled:
    """Solves the programme on the host, by HiGHS; both bounds are its optimum.

    Pairs whose cost is never below 0 are left out; they have weight 0.

    Args:
        cost: C, [T, N, L].
        change_cost: g, not negative.

    Raises:
        RuntimeError: HiGHS fails.
    """
    times, rows, columns = cost.shape
    row, column = np.nonzero((cost < 0).any(0))
    pairs = len(row)
    weight, zero = np.zeros(cost.shape), np.zeros(())
    if not pairs:
        return Coupled(weight, zero, zero)
    # |a - b| = 2 max(a - b, 0) - (a - b), where the last part sums to first minus last.
    price = np.array(cost[:, row, column], float)
    price[0] -= change_cost
    price[-1] += change_cost
    number, falls = times * pairs, (times - 1) * pairs
    target = np.concatenate([price.ravel(), np.full(falls, 2 * change_cost)])
    time, one = np.repeat(np.arange(times), pairs), np.ones(falls)
    entry, fall = np.arange(number), np.arange(falls)
    shape = number + falls
    total = [
        sparse.csr_matrix(
            (np.ones(number), (time * size + np.tile(place, times), entry)),
            shape=(times * size, shape),
        )
        for place, size in ((row, rows), (column, columns))
    ]
    signs = np.concatenate([one, -one, -one])
    where = np.tile(fall, 3), np.concatenate([fall, fall + pairs, number + fall])
    drop = sparse.csr_matrix((signs, where), shape=(falls, shape))
    limit = np.concatenate([np.ones(times * (rows + columns)), np.zeros(falls)])
    found = optimize.linprog(target, sparse.vstack([*total, drop]), limit)
    if not found.success:
        raise RuntimeError(f"HiGHS says: {found.message}")
    weight[:, row, column] = found.x[:number].reshape(times, pairs)
    return Coupled(weight, found.fun, found.fun)
