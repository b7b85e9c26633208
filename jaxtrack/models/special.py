"""What the models are written with: blocks, and functions smooth at zero.

The usual forms, such as sin(a)/a or (exp(z) - 1 - z)/z^2, are 0/0 at zero and lose
their digits near it. These keep values and derivatives there.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models import special
    >>> print(jnp.stack(special.exponentials(jnp.array(0.0), 2)))
    [1.  1.  0.5]
"""

import functools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.entries import Matrix
from jaxtrack.models import trig
from jaxtrack.types import Array


def block_diagonal(blocks: Sequence[Sequence[Sequence[Any]]]) -> Matrix:
    """Returns the matrix with these square blocks, of entries, on its diagonal."""
    size = len(blocks[0])
    dim = size * len(blocks)
    entries: list[list[Any]] = [[0] * dim for _ in range(dim)]
    for axis, block in enumerate(blocks):
        for i, row in enumerate(block):
            entries[axis * size + i][axis * size : (axis + 1) * size] = row
    return Matrix(entries)


def scaled_blocks(block: Sequence[Sequence[Any]], scale: Array) -> Matrix:
    """Returns the block-diagonal matrix of one block, of entries, times scale [P]."""
    return block_diagonal([[[s * x for x in row] for row in block] for s in scale])


def diagonal(std: Array) -> Matrix:
    """Returns the covariance [Z, Z] of independent errors, std [Z]."""
    size = range(len(std))
    return Matrix([std[i] ** 2 if i == j else 0 for j in size] for i in size)


def exponentials(z: Array, order: int) -> list[Array]:
    """Returns phi_0(z) to phi_order(z), where phi_k(z) = sum_n z^n / (n + k)!.

    phi_0 is the exponential and phi_k(z) = (phi_{k-1}(z) - 1 / (k-1)!) / z, a recursion
    that loses digits for small z; there the last one is summed and it runs backwards.
    """
    small = jnp.abs(z) < 2
    near, far = jnp.where(small, z, 0.0), jnp.where(small, -2.0, z)
    last = jnp.zeros_like(z)
    for n in reversed(range(22)):
        last = last * near + 1 / math.factorial(n + order)
    below, above = [last], [jnp.exp(far)]
    for k in reversed(range(order)):
        below.insert(0, near * below[0] + 1 / math.factorial(k))
    for k in range(order):
        above.append((above[-1] - 1 / math.factorial(k)) / far)
    return [jnp.where(small, *pair) for pair in zip(below, above, strict=True)]


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def circular(angle: Array, order: int = 3) -> tuple[Array, ...]:
    """Returns c_0(a) to c_order(a), where c_k(a) = sum_n (-a^2)^n / (2 n + k)!.

    The first are cos(a), sin(a)/a, (1 - cos(a))/a^2 and (a - sin(a))/a^3 (the functions
    of Stumpff); each is smooth at 0, and c_k(a) = 1/k! - a^2 c_{k+2}(a).
    """
    small = jnp.abs(angle) < 1
    near, far = jnp.where(small, angle, 0.0), jnp.where(small, 1.0, angle)
    square = near**2
    below: list[Array] = []
    for k in reversed(range(order + 1)):
        if k > order - 2:
            last = jnp.zeros_like(angle)
            for n in reversed(range(9)):
                last = 1 / math.factorial(2 * n + k) - square * last
            below.insert(0, last)
        else:
            below.insert(0, 1 / math.factorial(k) - square * below[1])
    sin, cos = trig.sincos(far)
    above = [cos, sin / far]
    for k in range(order - 1):
        above.append((1 / math.factorial(k) - above[k]) / far**2)
    pairs = zip(below, above[: order + 1], strict=True)
    return tuple(linalg.once(jnp.where(small, *pair)) for pair in pairs)


@circular.defjvp
def _circular_jvp(
    order: int, primals: tuple[Array], tangents: tuple[Array]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    c, turn = circular(primals[0], order + 2), primals[0] * tangents[0]
    slopes = (turn * (k * c[k + 2] - c[k + 1]) for k in range(order + 1))
    return c[: order + 1], tuple(slopes)
