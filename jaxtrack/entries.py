"""Small matrices written out entry by entry, so that XLA fuses them over any batch.

A `Matrix` has its entries apart: scalars, or arrays of one shape for many matrices at
once. A Python number among them is known when the program is traced, so that the zeros
and ones of a model cost nothing. NumPy and JAX read a `Matrix` as an array; of two of
them `+`, `-` and `@` make a `Matrix`, of one and an array they make an array. It is a
pytree of the entries that are not known: `vmap`, `scan` and `grad` take it as it is.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.entries import Matrix
    >>> shift = Matrix([[1, jnp.array(0.5)], [0, 1]])
    >>> print((shift @ shift).rows[1], shift @ jnp.array([3.0, 2.0]))
    (0, 1) [4. 2.]
"""

import math
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxtrack.types import Array, PyTree

Entry = Any  # a Python number, or an array


@jax.tree_util.register_pytree_node_class
class Matrix:
    """A matrix by its entries.

    Attributes:
        rows: Rows of Python numbers, and of arrays that broadcast to one shape.
    """

    __array_priority__ = 100  # NumPy leaves array @ matrix and the like to us

    def __init__(self, rows: Iterable[Iterable[Entry]]) -> None:
        """Keeps the rows as tuples."""
        self.rows = tuple(tuple(row) for row in rows)

    @property
    def shape(self) -> tuple[int, ...]:
        """Returns the shape as an array; many matrices have a leading axis."""
        leaves = (jnp.shape(x) for row in self.rows for x in row)
        return (*np.broadcast_shapes(*leaves), len(self.rows), len(self.rows[0]))

    @property
    def size(self) -> int:
        """Returns the number of entries as an array."""
        return math.prod(self.shape)

    @property
    def ndim(self) -> int:
        """Returns the number of axes as an array."""
        return len(self.shape)

    @property
    def dtype(self) -> Any:
        """Returns the type as an array."""
        return jnp.result_type(float, *(x for row in self.rows for x in row))

    @property
    def T(self) -> "Matrix":
        """Returns the transpose."""
        return Matrix(zip(*self.rows, strict=True))

    def __len__(self) -> int:
        """Returns the length of the first axis."""
        return self.shape[0]

    def __getitem__(self, index: Any) -> Array:
        """Returns a part of the array."""
        return dense(self)[index]

    def __iter__(self) -> Iterator[Array]:
        """Returns the parts of the array along its first axis."""
        return iter(dense(self))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Returns the array, for NumPy."""
        del copy
        return np.asarray(dense(self), dtype)

    def __jax_array__(self) -> Array:
        """Returns the array, for JAX."""
        return dense(self)

    def __matmul__(self, other: Any) -> Any:
        """Returns the product with a matrix, or with an array."""
        if isinstance(other, Matrix):
            columns = other.T.rows
            return Matrix([dot(row, column) for column in columns] for row in self.rows)
        if jnp.ndim(other) == 1:
            return flat(self @ column(other))
        return dense(self) @ other

    def __rmatmul__(self, other: Any) -> Array:
        """Returns the product of an array with this one."""
        return other @ dense(self)

    def __add__(self, other: Any) -> Any:
        """Returns the sum with a matrix, or with an array."""
        return _entrywise(plus, jnp.add, self, other)

    def __radd__(self, other: Any) -> Array:
        """Returns the sum of an array and this one."""
        return other + dense(self)

    def __sub__(self, other: Any) -> Any:
        """Returns the difference from a matrix, or from an array."""
        return _entrywise(minus, jnp.subtract, self, other)

    def __rsub__(self, other: Any) -> Array:
        """Returns the difference of an array from this one."""
        return other - dense(self)

    def __mul__(self, other: Any) -> Any:
        """Returns the matrix times a scalar, or entry by entry times an array."""
        if jnp.ndim(other) > 0:
            return dense(self) * other
        return Matrix([times(x, other) for x in row] for row in self.rows)

    def __rmul__(self, other: Any) -> Any:
        """Returns a scalar or an array times the matrix."""
        return self * other

    def __truediv__(self, other: Any) -> Any:
        """Returns the matrix over a scalar, or entry by entry over an array."""
        return dense(self) / other if jnp.ndim(other) > 0 else self.over(other)

    def __neg__(self) -> "Matrix":
        """Returns the matrix with all signs turned."""
        return self * -1.0

    def over(self, scalar: Entry) -> "Matrix":
        """Returns the matrix over a scalar, or over one for each of many matrices."""
        return Matrix([over(x, scalar) for x in row] for row in self.rows)

    def tree_flatten(self) -> tuple[list[Array], tuple]:
        """Returns the entries that are not known, and where the others stand."""
        known = tuple(tuple(_number(x) for x in row) for row in self.rows)
        leaves = [x for row in self.rows for x in row if _number(x) is None]
        return leaves, known

    @classmethod
    def tree_unflatten(cls, known: tuple, leaves: Sequence[Any]) -> "Matrix":
        """Puts the entries back."""
        rest = iter(leaves)
        return cls([next(rest) if x is None else x for x in row] for row in known)


def _number(entry: Entry) -> float | None:
    """Returns an entry that is known, or None."""
    return entry if isinstance(entry, int | float) else None


def _entrywise(entry: Callable, array: Callable, left: Matrix, right: Any) -> Any:
    if not isinstance(right, Matrix):
        return array(dense(left), right)
    pairs = zip(left.rows, right.rows, strict=True)
    return Matrix([entry(x, y) for x, y in zip(*pair, strict=True)] for pair in pairs)


def plus(left: Entry, right: Entry) -> Entry:
    """Returns left + right."""
    if isinstance(left, int | float) and left == 0:
        return right
    return left if isinstance(right, int | float) and right == 0 else left + right


def minus(left: Entry, right: Entry) -> Entry:
    """Returns left - right."""
    return left if isinstance(right, int | float) and right == 0 else left - right


def times(left: Entry, right: Entry) -> Entry:
    """Returns left * right."""
    for one, other in ((left, right), (right, left)):
        if isinstance(one, int | float) and one in (0, 1):
            return other if one else 0
    return left * right


def over(left: Entry, right: Entry) -> Entry:
    """Returns left / right, where right is not zero."""
    return 0 if isinstance(left, int | float) and left == 0 else left / right


def dot(left: Iterable[Entry], right: Iterable[Entry]) -> Entry:
    """Returns the sum of the products of two rows."""
    total: Entry = 0
    for x, y in zip(left, right, strict=True):
        total = plus(total, times(x, y))
    return total


def symmetric(entry: Callable[[int, int], Entry], size: int) -> Matrix:
    """Returns the matrix with entry(i, j), of which one triangle is computed."""
    half = {(i, j): entry(i, j) for i in range(size) for j in range(i, size)}
    side = range(size)
    return Matrix([half[min(i, j), max(i, j)] for j in side] for i in side)


def split(array: Array) -> Matrix:
    """Returns the entries of an array [R, C], of many [N, R, C] each an array [N]."""
    made = _made(array, jnp.shape(array))
    # Row by row, as `dense` joins them: XLA then sees through the one and the other.
    return made or Matrix(map(scalars, apart(array, -2)))


def scalars(array: Array) -> list[Array]:
    """Returns the entries of an array [N], or along the last axis of a larger one."""
    return apart(array, -1)


def apart(array: Array, axis: int) -> list[Array]:
    """Returns the parts of an array along an axis, which they no longer have."""
    # A sum over one item, since `vmap` would have a squeeze move the batch axis.
    array = jnp.asarray(array)
    axis = axis % array.ndim
    parts = jax.lax.split(array, [1] * array.shape[axis], axis=axis)
    return [x.sum(axis) for x in parts]


def column(array: Array) -> Matrix:
    """Returns the entries of an array [N], one below the other."""
    made = _made(array, (*jnp.shape(array), 1))
    return made or Matrix([x] for x in scalars(array))


def flat(matrix: Matrix | Array) -> Array:
    """Returns a matrix of one column, [N, 1], as an array [N]."""
    array = dense(matrix)
    chex.assert_axis_dimension(array, -1, 1)
    array = array.sum(-1)
    return _remembered(array, matrix) if isinstance(matrix, Matrix) else array


def dense(matrix: Matrix | Array) -> Array:
    """Returns a matrix as an array [R, C], many as [N, R, C]; an array as it is."""
    if not isinstance(matrix, Matrix):
        return matrix
    shape, dtype = matrix.shape[:-2], matrix.dtype

    def full(entry: Entry) -> Array:
        return jnp.broadcast_to(jnp.asarray(entry, dtype), shape)

    # Row by row: XLA on CPU is slow at joining many small pieces at once.
    stacked = [jnp.stack([full(x) for x in row], axis=-1) for row in matrix.rows]
    return _remembered(jnp.stack(stacked, axis=-2), matrix)


# The entries of arrays in programs that are being traced, by the arrays' ids.
_MADE: dict[int, tuple[weakref.ref, Matrix]] = {}


def _remembered(array: Array, matrix: Matrix) -> Array:
    """Returns an array, of which `split` and `column` will know the entries.

    One function joins what the next takes apart, and XLA on CPU does not always see
    through: it would copy whole matrices between the two. What was known is an array
    among these entries, so that two of them are the same pytree.
    """
    shape, dtype = matrix.shape[:-2], matrix.dtype

    def entry(value: Entry) -> Array:
        return jnp.full(shape, value, dtype) if _number(value) is not None else value

    def same(entry: Array) -> bool:
        strong = not getattr(entry, "weak_type", False)
        return strong and (jnp.shape(entry), entry.dtype) == (shape, dtype)

    every = Matrix(map(entry, row) for row in matrix.rows)
    if isinstance(array, Tracer) and all(same(x) for row in every.rows for x in row):
        key = id(array)
        _MADE[key] = weakref.ref(array, lambda _: _MADE.pop(key, None)), every
    return array


def _made(array: Array, shape: tuple[int, ...]) -> Matrix | None:
    """Returns the entries that an array was made of, if they have that shape."""
    where, matrix = _MADE.get(id(array), (None, None))
    if matrix is None or where is None or where() is not array:
        return None
    return matrix if matrix.shape == shape else None


def arrays(tree: PyTree) -> PyTree:
    """Returns a pytree with each `Matrix` in it as an array."""
    return jax.tree.map(dense, tree, is_leaf=lambda x: isinstance(x, Matrix))
