"""One compiled call for many runs, shared among all local devices.

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
    mesh = Mesh(np.array(jax.local_devices()), ("runs",))
    each = -(-keys.size // mesh.size)
    everyone = jnp.arange(each * mesh.size) % keys.size
    share = jax.device_put(keys[everyone], NamedSharding(mesh, MANY))
    # Explicit types, so that a Python number and an array compile alike.
    values = jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), values)
    values = jax.device_put(values, NamedSharding(mesh, SAME))

    start = time.perf_counter()
    leaves, structure = jax.tree.flatten((*values, share))
    shapes = tuple(
        jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=x.sharding) for x in leaves
    )
    program = _compiled(function, static, mesh, structure, shapes)
    compiled = time.perf_counter()
    result = jax.block_until_ready(program(*values, share))
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
    """Compiles; each device works on its own, without a word to the others."""
    arguments = jax.tree.unflatten(structure, shapes)
    program = jax.shard_map(
        functools.partial(function, *static),
        mesh=mesh,
        in_specs=(*(SAME for _ in arguments[:-1]), MANY),
        out_specs=MANY,
        check_vma=False,
    )
    return jax.jit(program).lower(*arguments).compile()
