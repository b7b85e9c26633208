"""Which numbers of a `Params` are learned, and what each of them is called.

The tree is walked by what it holds, each array constrained as its field is annotated.

    >>> import numpy as np
    >>> from jaxtrack.learn import leaves
    >>> from jaxtrack.models.probability import Constant
    >>> params = Constant(np.array(0.9)), Constant(np.array(1.0))
    >>> plan = leaves.plan(params)  # what is 1 stays 1
    >>> for name, numbers in leaves.unconstrain(plan, params).items():
    ...     print(name, numbers.round(2))
    [0].value [2.2]
"""

import functools
import typing
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxtrack.constraints import REAL, Constraint, of
from jaxtrack.learn import supports
from jaxtrack.types import Array, PyTree

Where = Callable[[Any], Any]
Free = dict[str, Array]


class Leaf(NamedTuple):
    """A learned array; static.

    Attributes:
        path: What it is called, such as "target.sensor.noise_std".
        index: Which of the leaves of `Params` it is.
        constraint: What values it may have.
        place: Which of its entries move.
        other: The index of the leaf that its constraint refers to, None without.
        above: That of one which is learned not, but must stay below this, or None.
    """

    path: str
    index: int
    constraint: Constraint
    place: supports.Places
    other: int | None
    above: int | None


Plan = tuple[Leaf, ...]


class Declared(NamedTuple):
    """An array of `Params`, learned or not.

    Attributes:
        path: What it is called.
        parent: What the tuple is called that it is a field of.
        constraint: That of its field.
    """

    path: str
    parent: str
    constraint: Constraint


class _Mark(NamedTuple):
    """Stands for a leaf in what `where` is shown."""

    index: int


def declared(params: PyTree) -> list[Declared]:
    """Lists the leaves of `Params` in the order of `jax.tree.leaves`.

    Raises:
        ValueError: The annotations of a class cannot be read.
    """
    return list(_walk(params, "", "", REAL))


def plan(params: PyTree, where: Where | None = None) -> Plan:
    """Says which arrays of `Params` are learned, and which of their entries.

    Args:
        params: Any tracker's `Params`, with numbers.
        where: Takes something like `params` and returns the arrays or subtrees of it
            that are learned, one or a tuple of them; by default all. What is `Fixed`
            must be named itself. Truth values are never learned, nor whole numbers
            but where the field says what real numbers it may have.

    Raises:
        ValueError: Nothing is left to be learned, `where` returns something else, a
            value breaks its constraint, or the values are traced.
    """
    every, values = declared(params), jax.tree.leaves(params)
    if any(isinstance(value, Tracer) for value in values):
        raise ValueError(
            "the params are being traced by jax; call unconstrain outside of jit, vmap "
            "and grad, and inside of them the function that it returns"
        )
    named, below = _chosen(params, where)
    learned = {}
    for i, (one, value) in enumerate(zip(every, values, strict=True)):
        if _is_real(one.constraint, value):
            if i in named or (i in below and not one.constraint.fixed):
                learned[i] = one
        elif i in named:
            raise ValueError(
                f"{one.path} holds {jnp.result_type(value)}, which has no slope; "
                "choose arrays of floats"
            )
    index = {one.path: i for i, one in enumerate(every)}
    made = [_leaf(i, one, every, index, learned, values) for i, one in learned.items()]
    found = tuple(leaf for leaf in made if leaf.place.free)
    if not found:
        raise ValueError(
            "nothing is left to be learned; choose arrays of floats that do not stand "
            "on the boundary of what they may be"
        )
    return found


def unconstrain(plan: Plan, params: PyTree) -> Free:
    """Returns the free numbers by the path of their array, each a vector."""
    values = jax.tree.leaves(params)
    return {
        leaf.path: jnp.asarray(
            supports.unconstrain(
                leaf.constraint.kind,
                _numbers(values[leaf.index]),
                leaf.place,
                bounds_of(leaf, lambda i: _numbers(values[i])),
            ),
            jnp.result_type(values[leaf.index], float),
        )
        for leaf in plan
    }


def constrain(plan: Plan, params: PyTree, free: Free) -> PyTree:
    """Returns `params` with what is learned as the free numbers say."""
    values, structure = jax.tree.flatten(params)
    learned = values_of(plan, params, free)
    for leaf in plan:
        values[leaf.index] = learned[leaf.path]
    return jax.tree.unflatten(structure, values)


def values_of(plan: Plan, params: PyTree, free: Free) -> dict[str, Array]:
    """Returns the learned arrays by path, as the free numbers say."""
    start = jax.tree.leaves(params)
    by_index = {leaf.index: leaf for leaf in plan}

    @functools.cache
    def value(index: int) -> Any:
        leaf = by_index.get(index)
        if leaf is None:
            return start[index]
        kind, x = leaf.constraint.kind, free[leaf.path]
        # Below what is learned too; but a scale stays what it was at the start.
        bounds = bounds_of(leaf, value if kind == "below" else start.__getitem__)
        return supports.constrain(kind, start[index], x, leaf.place, bounds)

    return {leaf.path: value(leaf.index) for leaf in plan}


def entries(plan: Plan, params: PyTree) -> list[str]:
    """Names the entry at which each free number stands, in the order of their leaves.

    That is the order in which `jax.tree.leaves` tells them, sorted by path.
    """
    values, names = jax.tree.leaves(params), []
    for leaf in sorted(plan):
        shape = np.shape(values[leaf.index])
        for i in leaf.place.free:
            where = ", ".join(str(j) for j in np.unravel_index(i, shape))
            names.append(f"{leaf.path}[{where}]" if shape else leaf.path)
    return names


def _walk(value: Any, path: str, parent: str, constraint: Constraint) -> Any:
    """Yields each leaf below a value."""
    inside = jax.tree_util.tree_flatten_with_path(
        value, is_leaf=lambda x: x is not value
    )[0]
    if len(inside) == 1 and not inside[0][0]:
        yield Declared(path or "params", parent, constraint)
        return
    hints = _hints(type(value))
    for keys, part in inside:
        name = jax.tree_util.keystr(keys)
        field = getattr(keys[0], "name", None)
        below = (of(hints[field]) or REAL) if field in hints else constraint
        yield from _walk(part, (path + name).removeprefix("."), path, below)


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    try:
        return typing.get_type_hints(kind, include_extras=True)
    except NameError as error:
        raise ValueError(
            f"an annotation of {kind.__name__} cannot be read ({error}); import what "
            "it names where the class is defined"
        ) from None


def _is_real(constraint: Constraint, value: Any) -> bool:
    """Returns whether an array holds real numbers, if written as whole ones."""
    kind = jnp.result_type(value)
    meant = constraint.kind != "real" or constraint.other
    return jnp.issubdtype(kind, jnp.floating) or bool(
        meant and jnp.issubdtype(kind, jnp.integer)
    )


def _chosen(params: PyTree, where: Where | None) -> tuple[set[int], set[int]]:
    """Returns which leaves were named, and which stand below a subtree that was."""
    number = len(jax.tree.leaves(params))
    if where is None:
        return set(), set(range(number))
    if not callable(where):
        raise ValueError(
            f"where is {where!r}; give a function such as lambda p: p.target.sensor"
        )
    marks = [_Mark(i) for i in range(number)]
    shown = jax.tree.unflatten(jax.tree.structure(params), marks)
    named: set[int] = set()
    below: set[int] = set()
    _sort(where(shown), named, below)
    return named, below


def _sort(answer: Any, named: set[int], below: set[int]) -> None:
    """Puts what `where` returned where it belongs."""
    if isinstance(answer, _Mark):
        named.add(answer.index)
        return
    if type(answer) in (tuple, list):
        for part in answer:
            _sort(part, named, below)
        return
    found = jax.tree.leaves(answer, is_leaf=lambda x: isinstance(x, _Mark))
    if not found or not all(isinstance(x, _Mark) for x in found):
        raise ValueError(
            f"where returns {answer!r}, which is no part of the params; return arrays "
            "or tuples of what it is given"
        )
    below.update(mark.index for mark in found)


def _leaf(
    i: int,
    one: Declared,
    every: list[Declared],
    index: dict[str, int],
    learned: dict[int, Declared],
    values: list[Any],
) -> Leaf:
    """Says what is learned of an array, and checks it."""
    prefix = f"{one.parent}." if one.parent else ""
    other = index.get(prefix + one.constraint.other) if one.constraint.other else None
    field = one.path.removeprefix(prefix)
    above = next(
        (
            j
            for j, lower in enumerate(every)
            if lower.parent == one.parent
            and lower.constraint.kind == "below"
            and lower.constraint.other == field
            and j not in learned
        ),
        None,
    )
    value = _numbers(values[i])
    leaf = Leaf(one.path, i, one.constraint, supports.Places((), ()), other, above)
    bounds = bounds_of(leaf, lambda j: _numbers(values[j]))
    remedy = supports.remedy(one.constraint.kind, value, bounds)
    if remedy:
        told = np.array2string(value, threshold=20, separator=", ").replace("\n", "")
        raise ValueError(f"{one.path} is {told}; give {remedy}")
    return leaf._replace(place=supports.places(one.constraint.kind, value))


def bounds_of(leaf: Leaf, value: Callable[[int], Any]) -> supports.Bounds:
    """Returns what the values of other leaves say about one."""
    low = value(leaf.above) if leaf.above is not None else 0.0
    if leaf.other is None:
        return supports.Bounds(low=low)
    if leaf.constraint.kind == "below":
        return supports.Bounds(low=low, high=value(leaf.other))
    return supports.Bounds(cov=value(leaf.other))


def _numbers(value: Any) -> np.ndarray:
    return np.asarray(value, float)
