"""Prices of the columns of coupled assignments, by the method of multipliers (ADMM).

The programme is that of `jaxtrack.metrics.coupled`: T assignments W [N, L], with cost
<C, W> at each time and a price g for every change of an entry from one time to the
next. Four copies are split off: W itself (not negative), its changes, its row sums and
its column sums (at most one). What remains is a least-squares problem with the same
matrix for every problem of a size: in time a cosine transform makes it diagonal, in
space the means over rows and columns do, so a step is one matrix product.

Multipliers of the column sums are prices for which `jaxtrack.metrics.chains` gives a
bound. They are nearly right after some twenty steps, long before W is, so steps are
made in float32 whatever the precision of the bound.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import splitting
    >>> cost = jnp.full((3, 2, 1, 1), -1.0)  # two rows want one column
    >>> split = splitting.steps(cost, jnp.array([0.1]), splitting.start(cost), 99)
    >>> print(splitting.prices(split).round(2).ravel())  # worth its gain, 1
    [1. 1. 1.]

Reference: Boyd, Parikh, Chu, Peleato and Eckstein, "Distributed optimization and
statistical learning via the alternating direction method of multipliers", Foundations
and Trends in Machine Learning 3(1), 2011, sections 3.4.3 and 7.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.types import Array

# Chosen on simulated tracks; costs are between -1 and 0, so they need no scale.
PENALTY = 0.6  # of a copy that is not what it copies
CHANGES, SUMS = 0.5, 0.75  # the same for the other copies, relative to that of W
RELAX = 1.8


class Split(NamedTuple):
    """Copy plus scaled multiplier of each constraint, of R problems.

    Attributes:
        weight: Of W, [T, N, L, R].
        change: Of what each time has more than the one before, [T - 1, N, L, R].
        row: Of the row sums, [T, N, R].
        column: Of the column sums, [T, L, R].
    """

    weight: Array
    change: Array
    row: Array
    column: Array


def start(cost: Array) -> Split:
    """Returns zeros.

    Args:
        cost: [T, N, L, R].
    """
    times, rows, columns, number = cost.shape
    return Split(
        weight=jnp.zeros(cost.shape, jnp.float32),
        change=jnp.zeros((times - 1, rows, columns, number), jnp.float32),
        row=jnp.zeros((times, rows, number), jnp.float32),
        column=jnp.zeros((times, columns, number), jnp.float32),
    )


def steps(cost: Array, change_cost: Array, split: Split, num: Array | int) -> Split:
    """Makes `num` steps.

    Args:
        cost: [T, N, L, R], from -1 to 0.
        change_cost: g, [R].
        split: What the steps before gave.
        num: How many.
    """
    push = (cost / PENALTY).astype(jnp.float32)
    limit = (change_cost / (PENALTY * CHANGES)).astype(jnp.float32)[None, None, None]
    kernels = tuple(map(jnp.asarray, _kernels(*cost.shape[:3])))
    return jax.lax.fori_loop(
        0, num, lambda _, split: _step(push, limit, kernels, split), split
    )


def prices(split: Split) -> Array:
    """Returns the price of each column at each time, not negative, [T, L, R]."""
    return PENALTY * SUMS * jnp.maximum(split.column - 1, 0)


def weights(cost: Array, split: Split) -> Array:
    """Returns a feasible W near the present one, [T, N, L, R]."""
    weight = jnp.maximum(split.weight - cost / PENALTY, 0)
    most = jnp.maximum(weight.sum(2)[:, :, None], weight.sum(1)[:, None])
    return weight / jnp.maximum(most, 1)


def _step(push: Array, limit: Array, kernels: tuple, split: Split) -> Split:
    """Makes one step: copies, least squares, over-relaxed multipliers."""
    weight = jnp.maximum(split.weight - push, 0)
    held = jnp.clip(split.change, -limit, limit)
    row, column = jnp.minimum(split.row, 1), jnp.minimum(split.column, 1)

    pull = jnp.pad(CHANGES * (split.change - 2 * held), ((1, 1), *[(0, 0)] * 3))
    sums = (2 * row - split.row)[:, :, None] + (2 * column - split.column)[:, None]
    wanted = 2 * weight - split.weight + SUMS * sums + pull[:-1] - pull[1:]
    found = _least_squares(kernels, wanted)
    return Split(
        weight=split.weight + RELAX * (found - weight),
        change=split.change + RELAX * (found[1:] - found[:-1] - split.change + held),
        row=split.row + RELAX * (found.sum(2) - row),
        column=split.column + RELAX * (found.sum(1) - column),
    )


def _least_squares(kernels: tuple, wanted: Array) -> Array:
    """Solves (1 + a D'D + b (row sums) + b (column sums)) W = wanted, [T, N, L, R]."""

    def along(kernel: Array, x: Array) -> Array:
        flat = x.reshape(len(x), -1)
        product = jnp.matmul(kernel, flat, precision=jax.lax.Precision.HIGHEST)
        return product.reshape(x.shape)

    each, by_row, by_column, by_all = kernels
    row, column = wanted.sum(2), wanted.sum(1)
    both = along(by_column, column) + along(by_all, row.sum(1))[:, None]
    return along(each, wanted) + along(by_row, row)[:, :, None] + both[:, None]


@functools.cache
def _kernels(times: int, rows: int, columns: int) -> tuple[np.ndarray, ...]:
    """Inverts the matrix of the least squares.

    Returns:
        What each entry adds to W along time, what the row sums add, the column sums,
        and the sum of all, each [T, T].
    """
    wave, time = np.arange(times)[:, None], np.arange(times)[None]
    cosine = np.cos(np.pi * wave * (time + 0.5) / times) * np.sqrt(2 / times)
    cosine[0] /= np.sqrt(2)

    # Eigenvalues of what varies within rows and columns, with one, with none of them.
    inner = 1 + CHANGES * (2 - 2 * np.cos(np.pi * np.arange(times) / times))
    row, column = 1 / (inner + SUMS * columns), 1 / (inner + SUMS * rows)
    none = 1 / (inner + SUMS * (rows + columns))
    factors = (
        1 / inner,
        (row - 1 / inner) / columns,
        (column - 1 / inner) / rows,
        (1 / inner - row - column + none) / (rows * columns),
    )
    return tuple((cosine.T @ (f[:, None] * cosine)).astype(np.float32) for f in factors)
