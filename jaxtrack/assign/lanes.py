"""Solvers that work on many problems side by side, the axis over problems last.

A loop that ends when its problem is solved is slow under `jax.vmap`: the axis over
problems comes first, where a core cannot take 16 of them at once, and all wait for the
longest. A solver here is written for R problems, the last axis of every array, and
`lanes` makes a function of one problem of it. Under `vmap`, nested too, the problems
are gathered on that last axis and solved in blocks, each as soon as its own are done.

    >>> import jax
    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.lanes import lanes
    >>> total = lanes(lambda x: x.sum(0))  # [N, R] -> [R]
    >>> total(jnp.arange(3.0)).shape
    ()
    >>> print(jax.vmap(total)(jnp.ones((2, 3))))
    [3. 3.]
"""

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from jaxtrack.types import Array, PyTree


def lanes(function: Callable[..., PyTree], width: int = 512) -> Callable[..., PyTree]:
    """Turns a function of R problems into one of a single problem.

    What it returns is not meant to be differentiated: give it `stop_gradient`, or a
    derivative of its own.

    Args:
        function: (*arrays [..., R]) -> arrays [..., R], of independent problems.
        width: Problems that are solved side by side, at most.

    Returns:
        (*arrays [...]) -> arrays [...], for `jax.vmap`.
    """

    @jax.custom_batching.custom_vmap
    def many(*arrays: Array) -> PyTree:
        return _in_blocks(function, width, arrays)

    @many.def_vmap
    def _(size: int, batched: Sequence[bool], *arrays: Array) -> tuple:
        whole = [
            x if own else jnp.broadcast_to(x, (size, *x.shape))
            for x, own in zip(arrays, batched, strict=True)
        ]
        result = many(*map(_merge, whole))
        apart = jax.tree.map(functools.partial(_split, size), result)
        return apart, jax.tree.map(lambda x: True, apart)

    def one(*arrays: Array) -> PyTree:
        return jax.tree.map(lambda x: x[..., 0], many(*(x[..., None] for x in arrays)))

    return functools.wraps(function)(one)


def _merge(x: Array) -> Array:
    """Returns [V, ..., R] as [..., R V]."""
    return jnp.moveaxis(x, 0, -1).reshape(*x.shape[1:-1], x.shape[0] * x.shape[-1])


def _split(size: int, x: Array) -> Array:
    """Returns [..., R V] as [V, ..., R]."""
    return jnp.moveaxis(x.reshape(*x.shape[:-1], x.shape[-1] // size, size), -1, 0)


def _in_blocks(
    function: Callable[..., PyTree], width: int, arrays: tuple[Array, ...]
) -> PyTree:
    """Calls a function of many for blocks of equal size, the last ones filled up."""
    number = arrays[0].shape[-1]
    count = -(-number // width)
    if count == 1:
        return function(*arrays)
    size = -(-number // count)
    lacking = count * size - number

    def cut(x: Array) -> Array:
        full = jnp.concatenate([x, x[..., :lacking]], -1) if lacking else x
        return jnp.moveaxis(full.reshape(*x.shape[:-1], count, size), -2, 0)

    def join(x: Array) -> Array:
        whole = jnp.moveaxis(x, 0, -2)
        return whole.reshape(*whole.shape[:-2], count * size)[..., :number]

    result = jax.lax.map(lambda block: function(*block), tuple(map(cut, arrays)))
    return jax.tree.map(join, result)
