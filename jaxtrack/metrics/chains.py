"""Bounds and roundings of coupled assignments, by chains of the rows through time.

The programme is that of `jaxtrack.metrics.coupled`. Its cost is shared out between
rows and columns, C = A + B. With A alone a row is a chain: at each time it has one
column or none, and pays g to leave and g to enter one; messages passed along time find
its least cost. With B alone a column, at each time, takes the row that costs least, if
that is less than 0. The sum of these least costs is a bound from below whatever the
share, and with the best share it is the optimum, as rows alone and columns alone have
integral solutions.

A sweep goes through time and, at each, moves costs to and fro between rows and columns,
each time as much as leaves the best choice and the second best as far apart on both
sides; the bound rises. The rounding takes the best assignment at each time, given the
one before and the messages from the future.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import chains
    >>> cost, change = jnp.full((3, 2, 1, 1), -1.0), jnp.array([0.1])
    >>> share, message, bound = chains.bound(cost, change, cost + 1)  # 1 is its price
    >>> print(bound.round(2))
    [-3.]
    >>> print(chains.rounded(cost, change, message).sum((1, 2)).ravel())
    [1. 1. 1.]

References: Kolmogorov, "Convergent tree-reweighted message passing for energy
minimization", IEEE Trans. Pattern Analysis and Machine Intelligence 28(10), 2006;
Swoboda, Rother, Abu Alhaija, Kainmueller and Savchynskyy, "A study of Lagrangean
decompositions and dual ascent solvers for graph matching", CVPR, 2017.
"""

import jax
import jax.numpy as jnp

from jaxtrack.assign.paths import place
from jaxtrack.types import Array

ROUNDS = 2  # of a sweep forward and one backward

_place = jax.vmap(place, in_axes=-1, out_axes=-1)


def bound(cost: Array, change_cost: Array, share: Array) -> tuple[Array, Array, Array]:
    """Bounds the least cost from below, and improves the share.

    Args:
        cost: C, [T, N, L, R].
        change_cost: g, [R].
        share: A, what the rows bear of it, [T, N, L, R].

    Returns:
        A better share, what the future of each row says to each column relative to
        none, [T, N, L, R], and the bound, [R].
    """

    def both(_: int, carry: tuple) -> tuple:
        share, message, most = carry
        share, message, ahead = _sweep(cost, change_cost, share, message, False)
        share, message, back = _sweep(cost, change_cost, share, message, True)
        return share, message, jnp.maximum(most, jnp.maximum(ahead, back))

    least = jnp.full(cost.shape[-1], -jnp.inf, cost.dtype)
    begin = share, _messages(change_cost, share), least
    return jax.lax.fori_loop(0, ROUNDS, both, begin)


def rounded(cost: Array, change_cost: Array, message: Array) -> Array:
    """Returns an assignment at each time, [T, N, L, R], of zeros and ones.

    Args:
        cost: C, [T, N, L, R].
        change_cost: g, [R].
        message: From `bound`, [T, N, L, R].
    """
    _, rows, columns, number = cost.shape
    free = jnp.zeros((rows, number), cost.dtype)

    def step(context: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        column = _place(now[0] + now[1] + context, free)[0]
        chosen = column[:, None] == jnp.arange(columns)[None, :, None]
        return jnp.where(chosen, -1, 1) * change_cost[None, None], chosen

    begin = jnp.zeros((rows, columns, number), cost.dtype)
    chosen = jax.lax.scan(step, begin, (cost, message))[1]
    return chosen.astype(cost.dtype)


def _messages(change_cost: Array, share: Array) -> Array:
    """Returns what the future of each row says, [T, N, L, R]."""

    def step(message: Array, share: Array) -> tuple[Array, Array]:
        return _pass(change_cost, message + share)[0], message

    return jax.lax.scan(step, jnp.zeros_like(share[0]), share, reverse=True)[1]


def _sweep(
    cost: Array, change_cost: Array, share: Array, message: Array, backward: bool
) -> tuple[Array, Array, Array]:
    """Goes through time once; returns the share, messages of this way, and the bound.

    The messages are those of the other way.
    """

    def step(carry: tuple, now: tuple) -> tuple:
        (before, total), (cost, share, after) = carry, now
        around = before + after
        row, column = share + around, cost - share
        surplus = _surplus(row, 1)
        row, column = row - surplus, column + surplus
        surplus = _surplus(column, 0)
        row, column = row + surplus, column - surplus
        share = row - around

        total = total + jnp.minimum(column.min(0), 0).sum(0)
        end = total + jnp.minimum((before + share).min(1), 0).sum(0)
        passed, least = _pass(change_cost, before + share)
        return (passed, total + least.sum(0)), (share, before, end)

    begin = jnp.zeros_like(share[0]), jnp.zeros_like(change_cost)
    _, (share, passed, end) = jax.lax.scan(
        step, begin, (cost, share, message), reverse=backward
    )
    return share, passed, end[0 if backward else -1]


def _pass(change_cost: Array, cost: Array) -> tuple[Array, Array]:
    """Passes the costs of a row's columns, relative to none, on to the next time.

    Args:
        change_cost: g, [R].
        cost: [N, L, R].

    Returns:
        The message, [N, L, R], and the least cost that it is relative to, [N, R].
    """
    least = jnp.minimum(cost.min(1) + change_cost[None], 0)
    return jnp.minimum(cost - least[:, None], change_cost[None, None]), least


def _surplus(cost: Array, axis: int) -> Array:
    """Returns the costs [N, L, R] over the middle of the best two; none costs 0."""
    best = cost.min(axis, keepdims=True)
    is_best = cost <= best
    other = jnp.where(is_best, jnp.inf, cost).min(axis, keepdims=True)
    second = jnp.where(is_best.sum(axis, keepdims=True) > 1, best, other)
    middle = jnp.where(best < 0, best + jnp.minimum(second, 0), best) / 2
    return cost - middle
