"""Many runs in one compiled call, in blocks and shared among all local devices.

>>> import jax
>>> from jaxtrack.study import devices
>>> def roll(sides, low, keys):
...     return low + jax.vmap(lambda key: jax.random.randint(key, (), 0, sides))(keys)
>>> keys = jax.random.split(jax.random.key(0), 5)
>>> devices.call(roll, (6,), (1,), keys).result.shape
(5,)
"""

import functools
import time
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxtrack.types import Array, PyTree

LANES = 16  # numbers that a core takes at once
SAME, MANY = PartitionSpec(), PartitionSpec("runs")


class Call(NamedTuple):
    """What a call yields.

    Attributes:
        result: The function's result, arrays on the host.
        seconds: How long the call took.
        compile_seconds: How long it took to compile it; next to nothing if it was
            compiled before.
    """

    result: PyTree
    seconds: float
    compile_seconds: float


def call(
    function: Callable[..., PyTree],
    static: tuple[Hashable, ...],
    values: tuple[PyTree, ...],
    keys: Array,
) -> Call:
    """Calls a function of many runs, each device with an equal share of them.

    Args:
        function: (*static, *values, keys [R]) -> arrays [R, ...], of independent runs.
        static: What the program depends on.
        values: Arrays, which every device gets whole.
        keys: One for each run, [R]. If the devices cannot share them evenly, some runs
            are made twice and left out of the result.

    Returns:
        The result; an array that does not hold one item for each key of a device comes
        back with a leading axis over devices instead.
    """
    mesh = local_mesh()
    each = -(-keys.size // mesh.size)
    share = jax.device_put(again(keys, each * mesh.size), shares(mesh))
    # Explicit types, so that a Python number and an array compile alike.
    values = jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), values)
    values = jax.device_put(values, NamedSharding(mesh, SAME))

    start = time.perf_counter()
    leaves, structure = jax.tree.flatten((values, share))
    shapes = tuple(
        jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=x.sharding) for x in leaves
    )
    program = _compiled(function, static, mesh, structure, shapes)
    compiled = time.perf_counter()
    result = jax.block_until_ready(program(values, share))
    end = time.perf_counter()
    result = jax.tree.map(lambda x: np.asarray(x)[: keys.size], result)
    return Call(result, end - compiled, compiled - start)


@functools.lru_cache(maxsize=64)
def _compiled(
    function: Callable[..., PyTree],
    static: tuple[Hashable, ...],
    mesh: Mesh,
    structure: Any,
    shapes: tuple[jax.ShapeDtypeStruct, ...],
) -> Callable[..., PyTree]:
    """Compiles a call."""
    arguments = jax.tree.unflatten(structure, shapes)

    def work(values: tuple[PyTree, ...], share: Array) -> PyTree:
        return function(*static, *values, share)

    return jax.jit(spread(work, mesh)).lower(*arguments).compile()


def local_mesh() -> Mesh:
    """Returns all local devices in a row."""
    return Mesh(np.array(jax.local_devices()), ("runs",))


def shares(mesh: Mesh) -> NamedSharding:
    """Returns where arrays with a leading R lie if each device has its share."""
    return NamedSharding(mesh, MANY)


def spread(
    function: Callable[[PyTree, PyTree], PyTree], mesh: Mesh
) -> Callable[[PyTree, PyTree], PyTree]:
    """Lets each device work on its share of the runs, without a word to the others.

    Args:
        function: Of arrays that every device gets whole, and of arrays of which it gets
            its share along the leading axis; what it returns has that axis too.
        mesh: The devices; the number of runs is a multiple of theirs.
    """
    return jax.shard_map(
        function, mesh=mesh, in_specs=(SAME, MANY), out_specs=MANY, check_vma=False
    )


def again(runs: PyTree, total: int) -> PyTree:
    """Returns arrays [R, ...] as [total, ...], beginning anew where they end."""
    count = jax.tree.leaves(runs)[0].shape[0]
    if count == total:
        return runs
    whole, rest = divmod(total, count)
    # Copied in pieces: picking them one by one would take as long as a Kalman filter.
    return jax.tree.map(lambda x: jnp.concatenate([x] * whole + [x[:rest]]), runs)


def blocks(runs: int, devices: int, block: int) -> tuple[int, int]:
    """Returns how many blocks each device works on, and how many runs each block has.

    Blocks are equal and have `block` runs at most. Where none down to half of that
    divides the runs, the blocks together hold a few runs more than there are, and large
    blocks are rounded up to whole numbers of lanes.

        >>> blocks(10_000, devices=2, block=1024), blocks(10_007, 2, 1024)
        ((5, 1000), (5, 1008))
    """
    each = -(-runs // devices)
    least = -(-each // block)
    for count in range(least, 2 * least + 1):
        if runs % (count * devices) == 0:
            return count, runs // (count * devices)
    size = -(-each // least)
    if size >= 8 * LANES:
        size = -(-size // LANES) * LANES
    return least, size


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))
def map_blocks(
    function: Callable[..., PyTree],
    static: tuple[Hashable, ...],
    own: tuple[bool, ...],
    block: int,
    mesh: Mesh,
    arguments: tuple[PyTree, ...],
) -> PyTree:
    """Calls a function of one run for each of R runs; see `engine.map_runs`.

    Args:
        function: (*static, *arguments of one run) -> arrays.
        static: What the program depends on.
        own: For each argument, whether it has a leading R; at least one has.
        block: Runs that are computed side by side, at most.
        mesh: The devices.
        arguments: Of all runs.

    Returns:
        What the function returns, with a leading R.
    """
    pairs = list(zip(arguments, own, strict=True))
    same = [None if mine else x for x, mine in pairs]
    runs = [x if mine else None for x, mine in pairs]

    def one(same: list[PyTree], run: list[PyTree]) -> PyTree:
        whole = [y if mine else x for x, y, mine in zip(same, run, own, strict=True)]
        return function(*static, *whole)

    many = jax.vmap(one, (None, 0))
    number = jax.tree.leaves(runs)[0].shape[0]
    count, size = blocks(number, mesh.size, block)

    def work(same: list[PyTree], share: list[PyTree]) -> PyTree:
        if count == 1:
            return many(same, share)
        share = jax.tree.map(lambda x: x.reshape(count, size, *x.shape[1:]), share)
        result = jax.lax.map(functools.partial(many, same), share)
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), result)

    total = count * size * mesh.size
    result = spread(work, mesh)(same, again(runs, total))
    return jax.tree.map(lambda x: x[:number], result) if total > number else result
