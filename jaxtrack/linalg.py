"""Small dense algebra shared by the filters.

Matrices with up to `UNROLL` rows and columns are written out entry by entry, with real
divisions, so that XLA fuses them over any batch that `vmap` adds; larger ones go to
`jax.numpy`. The functions take arrays and `entries.Matrix`: of arrays they make an
array, otherwise a `Matrix`. What is symmetric is computed as one triangle: an
antisymmetric part cannot build up, in values or in gradients.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import linalg
    >>> print(linalg.cholesky(jnp.array([[4.0, 2.0], [2.0, 10.0]])))
    [[2. 0.]
     [1. 3.]]
"""

import math
from collections.abc import Sequence
from typing import Any

import chex
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular

from jaxtrack.entries import (
    Matrix,
    dense,
    dot,
    flat,
    minus,
    over,
    plus,
    split,
)
from jaxtrack.entries import column as one_column
from jaxtrack.entries import symmetric as one_triangle
from jaxtrack.types import Array

UNROLL = 6  # beyond this the written-out form costs more to compile than it saves


def rows(entries: Sequence[Sequence[Any]]) -> Array:
    """Builds an array [rows, columns] from rows of Python numbers and scalars."""
    return dense(Matrix(entries))


def floating(value: Any) -> Array:
    """Returns an array of floats; float32 stays so where float64 is the default."""
    return jnp.asarray(value, jnp.result_type(value, float))


def safe_log(value: Array) -> Array:
    """Returns log(value), and -inf with a zero gradient where the value is not > 0."""
    value = floating(value)
    positive = value > 0
    return jnp.where(positive, jnp.log(jnp.where(positive, value, 1.0)), -jnp.inf)


def entries(matrix: Array | Matrix) -> Any:
    """Returns a small matrix as a `Matrix`, a large one as an array."""
    if _large(matrix):
        return dense(matrix)
    return matrix if isinstance(matrix, Matrix) else split(matrix)


def symmetric(matrix: Array | Matrix) -> Any:
    """Returns the mean of a small square matrix and its transpose as a `Matrix`.

    A large one comes back as an array.
    """
    if _large(matrix):
        return symmetrize(dense(matrix))
    apart = entries(matrix).rows

    def mean(i: int, j: int) -> Any:
        one, other = apart[i][j], apart[j][i]
        return one if one is other else plus(one, other) / 2

    return one_triangle(mean, len(apart))


def triangle(matrix: Array | Matrix) -> Any:
    """Returns what is symmetric but for rounding by its upper triangle, as `symmetric`.

    The lower one is not even computed; a large matrix is averaged.
    """
    if _large(matrix):
        return symmetrize(dense(matrix))
    apart = entries(matrix).rows
    return one_triangle(lambda i, j: apart[i][j], len(apart))


def column(vector: Array) -> Any:
    """Returns a small vector [D] as a `Matrix` [D, 1], a large one as an array."""
    return one_column(vector) if vector.shape[-1] <= UNROLL else vector[..., None]


def symmetrize(matrix: Array) -> Array:
    """Returns the mean of a square matrix [D, D] and its transpose."""
    return (matrix + matrix.T) / 2


def settle(matrix: Array | Matrix) -> Any:
    """Returns a small matrix unchanged, computed once and not in each of its uses."""
    if not isinstance(matrix, Matrix):
        return matrix
    entry = {id(x): x for row in matrix.rows for x in row}
    done = {name: once(x) for name, x in entry.items()}
    return Matrix([done[id(x)] for x in row] for row in matrix.rows)


def once(value: Any) -> Any:
    """Returns a value unchanged, computed once and not in each of its uses.

    XLA on CPU copies cheap operations into every consumer, but not a division; so this
    divides by a one that is not known before the program runs.
    """
    if isinstance(value, int | float):
        return value
    return value / jnp.where(value == value, 1.0, 2.0).astype(value.dtype)


def loosen(cov: Array | Matrix) -> Any:
    """Widens a covariance [D, D] by what rounding can take from it.

    So that cov - W.T @ W stays positive definite where it should be: D units in the
    last place of each variance, twice.
    """
    size = cov.shape[0]
    factor = 1 + 2 * size * jnp.finfo(cov.dtype).eps
    if not isinstance(cov, Matrix):
        return cov + jnp.diag((factor - 1) * jnp.diagonal(cov))
    wider = [
        [x * factor if i == j else x for j, x in enumerate(row)]
        for i, row in enumerate(cov.rows)
    ]
    return Matrix(wider)


def product(left: Array | Matrix, right: Array | Matrix) -> Any:
    """Returns left [A, B] @ right [B, C]."""
    chex.assert_shape(right, (left.shape[1], None))
    if _large(left, right):
        return dense(left) @ dense(right)
    return _like(entries(left) @ entries(right), left, right)


def congruence(matrix: Array | Matrix, cov: Array | Matrix) -> Any:
    """Returns matrix [Z, D] @ cov [D, D] @ matrix.T, symmetric by construction."""
    if _large(matrix, cov):
        return symmetrize(dense(matrix) @ symmetrize(dense(cov)) @ dense(matrix).T)
    outer = entries(matrix)
    half = (outer @ symmetric(cov)).rows
    result = one_triangle(lambda i, j: dot(half[i], outer.rows[j]), len(half))
    return _like(result, matrix, cov)


def cholesky(cov: Array | Matrix) -> Any:
    """Returns the lower Cholesky factor of a positive definite matrix [D, D]."""
    size = cov.shape[0]
    chex.assert_shape(cov, (size, size))
    if size > UNROLL:
        return jnp.linalg.cholesky(dense(cov))
    apart = entries(cov).rows
    lower: list[list[Any]] = [[0] * size for _ in range(size)]
    for i in range(size):
        for j in range(i + 1):
            rest = minus(apart[i][j], dot(lower[i][:j], lower[j][:j]))
            lower[i][j] = jnp.sqrt(rest) if i == j else over(rest, lower[j][j])
    return _like(Matrix(lower), cov)


def root(cov: Array | Matrix) -> Any:
    """Returns a lower factor of a covariance [D, D] that may be singular.

    Its column is zero where a component has no variance of its own left: less than
    rounding of its whole variance. Gradients are finite there.
    """
    size = cov.shape[0]
    chex.assert_shape(cov, (size, size))
    least = float(8 * size * jnp.finfo(cov.dtype).eps)
    if size > UNROLL:
        return _large_root(symmetrize(dense(cov)), least)
    apart = entries(cov).rows
    lower: list[list[Any]] = [[0] * size for _ in range(size)]
    for j in range(size):
        rest = minus(apart[j][j], dot(lower[j][:j], lower[j][:j]))
        if isinstance(rest, int | float) and rest == 0:
            continue
        free = rest > least * apart[j][j]
        pivot = once(jnp.sqrt(jnp.where(free, rest, 1.0)))
        lower[j][j] = jnp.where(free, pivot, 0.0)
        for i in range(j + 1, size):
            below = minus(apart[i][j], dot(lower[i][:j], lower[j][:j]))
            known = isinstance(below, int | float) and below == 0
            lower[i][j] = 0 if known else jnp.where(free, below / pivot, 0.0)
    return _like(Matrix(lower), cov)


def _large_root(cov: Array, least: float) -> Array:
    """Takes away one column after the other."""
    variance, columns = jnp.diagonal(cov), []
    for j in range(len(cov)):
        free = cov[j, j] > least * variance[j]
        pivot = jnp.sqrt(jnp.where(free, cov[j, j], 1.0))
        column = jnp.where(free & (jnp.arange(len(cov)) >= j), cov[:, j] / pivot, 0.0)
        cov = cov - jnp.outer(column, column)
        columns.append(column)
    return jnp.stack(columns, axis=1)


def solve_lower(lower: Array | Matrix, right: Array | Matrix) -> Any:
    """Returns the solution of lower [D, D] @ x = right, with right [D] or [D, C]."""
    return _solve(lower, right, backwards=False)


def solve_upper(lower: Array | Matrix, right: Array | Matrix) -> Any:
    """Returns the solution of lower.T @ x = right, with right [D] or [D, C]."""
    return _solve(lower, right, backwards=True)


def solve(lower: Array | Matrix, right: Array | Matrix) -> Any:
    """Returns the solution of (lower @ lower.T) @ x = right, right [D] or [D, C]."""
    return solve_upper(lower, solve_lower(lower, right))


def log_normal(residual: Array, lower: Array | Matrix) -> Array:
    """Log-density of a residual under N(0, lower @ lower.T).

    Args:
        residual: [Z].
        lower: Lower Cholesky factor of the covariance, [Z, Z].

    Returns:
        A scalar.
    """
    size = residual.size
    chex.assert_shape(lower, (size, size))
    return log_white(solve_lower(lower, column(residual)), lower)


def log_white(white: Array | Matrix, lower: Array | Matrix) -> Array:
    """Log-density of a residual of which `white` [Z, 1] is lower^-1 @ residual."""
    size = lower.shape[0]
    if _large(lower):
        scale = jnp.log(jnp.diagonal(dense(lower))).sum()
    else:
        factor = entries(lower).rows
        scale = sum(jnp.log(factor[i][i]) for i in range(size))
    return -square(white) / 2 - scale - size * math.log(math.tau) / 2


def square(vector: Array | Matrix) -> Array:
    """Returns the sum of the squares of a column [Z, 1]."""
    if _large(vector):
        return (dense(vector) ** 2).sum()
    values = entries(vector).T.rows[0]
    return dot(values, values)


def _solve(lower: Array | Matrix, right: Array | Matrix, backwards: bool) -> Any:
    size = lower.shape[0]
    chex.assert_shape(lower, (size, size))
    if len(right.shape) == 1:
        return flat(_solve(lower, column(dense(right)), backwards))
    if _large(lower, right):
        trans = 1 if backwards else 0
        return solve_triangular(dense(lower), dense(right), trans=trans, lower=True)
    turn = slice(None, None, -1 if backwards else 1)
    factor, columns = entries(lower), entries(right).T.rows
    if backwards:  # the transpose, turned about both ways, is lower triangular again
        factor = Matrix(row[turn] for row in factor.T.rows[turn])
    solved = [_substitute(factor.rows, values[turn])[turn] for values in columns]
    return _like(Matrix(solved).T, lower, right)


def _substitute(lower: Sequence[Sequence[Any]], right: Sequence[Any]) -> list[Any]:
    """Solves lower @ x = right for one column, from its first entry on."""
    solution: list[Any] = []
    for row, value in zip(lower, right, strict=True):
        rest = minus(value, dot(row[: len(solution)], solution))
        solution.append(over(rest, row[len(solution)]))
    return solution


def _large(*operands: Any) -> bool:
    return any(max(x.shape[-2:]) > UNROLL for x in operands)


def _like(result: Any, *operands: Any) -> Any:
    """Returns a result as an array if all operands were arrays."""
    return result if any(isinstance(x, Matrix) for x in operands) else dense(result)
