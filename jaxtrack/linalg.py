"""Small dense algebra shared by the filters.

Matrices with up to `UNROLL` rows are written out, with real divisions, so that XLA
fuses them over any batch that `vmap` adds; larger ones go to `jax.numpy`. What should
be symmetric is averaged with its transpose: an antisymmetric part cannot build up, in
values (to the last bits) or in gradients.

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

from jaxtrack.types import Array

UNROLL = 6  # rows; beyond this the written-out form costs more to compile than it saves


def rows(entries: Sequence[Sequence[Any]]) -> Array:
    """Builds a matrix from rows of scalars.

    Models write their matrices through this one function, so that the zeros and ones
    they know stay visible in one place.

    Args:
        entries: Rows of equal length, of Python numbers or scalar arrays.

    Returns:
        The matrix, [rows, columns].
    """
    dtype = jnp.result_type(float, *(x for row in entries for x in row))
    return jnp.stack(
        [jnp.stack([jnp.asarray(x, dtype) for x in row]) for row in entries]
    )


def floating(value: Any) -> Array:
    """Returns an array of floats; float32 stays so where float64 is the default."""
    return jnp.asarray(value, jnp.result_type(value, float))


def safe_log(value: Array) -> Array:
    """Returns log(value), and -inf with a zero gradient where the value is not > 0."""
    value = floating(value)
    positive = value > 0
    return jnp.where(positive, jnp.log(jnp.where(positive, value, 1.0)), -jnp.inf)


def symmetrize(matrix: Array) -> Array:
    """Returns the mean of a square matrix [D, D] and its transpose."""
    return (matrix + matrix.T) / 2


def product(left: Array, right: Array) -> Array:
    """Returns left [A, B] @ right [B, C]."""
    inner = left.shape[1]
    chex.assert_shape(right, (inner, None))
    if max(*left.shape, *right.shape) > UNROLL:
        return left @ right
    terms = [left[:, k, None] * right[None, k] for k in range(inner)]
    return sum(terms[1:], start=terms[0])


def congruence(matrix: Array, cov: Array) -> Array:
    """Returns matrix [Z, D] @ cov [D, D] @ matrix.T, symmetric by construction."""
    return symmetrize(product(product(matrix, cov), matrix.T))


def cholesky(cov: Array) -> Array:
    """Returns the lower Cholesky factor of a positive definite matrix [D, D]."""
    size = cov.shape[0]
    chex.assert_shape(cov, (size, size))
    if size > UNROLL:
        return jnp.linalg.cholesky(cov)
    lower = [[jnp.zeros((), cov.dtype)] * size for _ in range(size)]
    for i in range(size):
        for j in range(i + 1):
            rest = cov[i, j] - sum(lower[i][k] * lower[j][k] for k in range(j))
            lower[i][j] = jnp.sqrt(rest) if i == j else rest / lower[j][j]
    return jnp.stack([jnp.stack(row) for row in lower])


def solve_lower(lower: Array, right: Array) -> Array:
    """Returns the solution of lower [D, D] @ x = right, with right [D] or [D, C]."""
    size = lower.shape[0]
    chex.assert_shape(lower, (size, size))
    if size > UNROLL:
        return solve_triangular(lower, right, lower=True)
    solution: list[Array] = []
    for i in range(size):
        rest = right[i] - sum(lower[i, k] * solution[k] for k in range(i))
        solution.append(rest / lower[i, i])
    return jnp.stack(solution)


def solve_upper(lower: Array, right: Array) -> Array:
    """Returns the solution of lower.T @ x = right, with right [D] or [D, C]."""
    size = lower.shape[0]
    chex.assert_shape(lower, (size, size))
    if size > UNROLL:
        return solve_triangular(lower, right, trans=1, lower=True)
    solution: list[Array] = []
    for i in reversed(range(size)):
        known = zip(range(size - 1, i, -1), solution, strict=True)
        rest = right[i] - sum(lower[k, i] * x for k, x in known)
        solution.append(rest / lower[i, i])
    return jnp.stack(solution[::-1])


def solve(lower: Array, right: Array) -> Array:
    """Returns the solution of (lower @ lower.T) @ x = right, right [D] or [D, C]."""
    return solve_upper(lower, solve_lower(lower, right))


def log_normal(residual: Array, lower: Array) -> Array:
    """Log-density of a residual under N(0, lower @ lower.T).

    Args:
        residual: [Z].
        lower: Lower Cholesky factor of the covariance, [Z, Z].

    Returns:
        A scalar.
    """
    size = residual.size
    chex.assert_shape(lower, (size, size))
    white = solve_lower(lower, residual)
    log_scale = jnp.log(jnp.diagonal(lower)).sum() + size * math.log(math.tau) / 2
    return -(white * white).sum() / 2 - log_scale
