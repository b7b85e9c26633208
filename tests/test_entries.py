"""Tests of `jaxtrack.entries` against NumPy, with numbers known and not."""

import gc

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import entries
from jaxtrack.entries import Matrix


def sample(x):
    """Two matrices that share a size and no symmetry; zeros and ones are known."""
    left = Matrix([[1, x, 0], [0, 2.0, x**2]])
    right = Matrix([[0, x + 1], [1, -1], [x, 0]])
    return left, right


def as_numpy(x):
    left = np.array([[1, x, 0], [0, 2.0, x**2]])
    return left, np.array([[0, x + 1], [1, -1], [x, 0]])


def outcomes(left, right):
    vector, array = np.array([0.5, -1.0, 3.0]), np.arange(6.0).reshape(2, 3)
    return {
        "product": left @ right,
        "sum": left + right.T,
        "difference": left - right.T,
        "scaled": left.T * 3.0,
        "vector": left @ vector,
        "array": left @ array.T,
        "array first": array.T @ left,
        "plus array": left + array,
        "array plus": array + left,
        "minus array": left - array,
        "array minus": array - left,
        "part": left[1],
        "parts": [row for row in right],
    }


@pytest.mark.parametrize("x", [0.0, 0.7, -2.0])
def test_arithmetic_agrees_with_numpy(x):
    got = jax.jit(lambda x: entries.arrays(outcomes(*sample(x))))(x)
    chex.assert_trees_all_close(got, outcomes(*as_numpy(x)), rtol=1e-14)


def test_what_is_known_costs_nothing():
    left, right = sample(jnp.array(0.7))
    rows = (left @ Matrix([[1, 0], [0, 1], [0, 0]])).rows
    assert rows[0][0] == 1
    assert rows[1][0] == 0
    assert rows[0][1] is left.rows[0][1]
    assert (left - Matrix([[0] * 3] * 2)).rows[0][1] is left.rows[0][1]
    assert Matrix([[0, 1]]).T.rows == ((0,), (1,))
    del right


def test_many_matrices_have_a_leading_axis():
    times = jnp.array([0.0, 0.7, -2.0])
    left, right = jax.vmap(sample)(times)
    assert left.shape == (3, 2, 3)
    want = np.stack([np.matmul(*as_numpy(float(x))) for x in times])
    np.testing.assert_allclose(entries.dense(left @ right), want, rtol=1e-14)
    total = jax.lax.scan(lambda c, m: (c + m[0].sum(), m), 0.0, left)[0]
    np.testing.assert_allclose(total, np.sum(1 + times))


def test_a_matrix_is_a_pytree_of_what_is_not_known():
    left, _ = sample(jnp.array(0.7))
    leaves, layout = jax.tree.flatten(left)
    assert [float(x) for x in leaves] == [0.7, 0.7**2]
    again = jax.tree.unflatten(layout, leaves)
    assert again.rows == left.rows
    slope = jax.grad(lambda m: (m @ jnp.array([1.0, 2.0, 3.0])).sum())(left)
    assert [float(x) for x in jax.tree.leaves(slope)] == [2.0, 3.0]


def test_numpy_and_jax_read_it_as_an_array():
    left, _ = sample(0.7)
    want, _ = as_numpy(0.7)
    np.testing.assert_array_equal(np.asarray(left), want)
    np.testing.assert_array_equal(jnp.asarray(left), want)
    assert np.asarray(left, np.float32).dtype == np.float32
    assert (len(left), left.ndim, left.shape) == (2, 2, (2, 3))


@pytest.mark.parametrize("shape", [(2, 3), (4, 2, 3), (1, 1)])
def test_dense_undoes_split_and_scalars_are_along_the_last_axis(shape):
    array = jnp.arange(float(np.prod(shape))).reshape(shape)
    np.testing.assert_array_equal(entries.dense(entries.split(array)), array)
    for i, part in enumerate(entries.scalars(array)):
        np.testing.assert_array_equal(part, array[..., i])
    column = array[0] if array.ndim == 2 else array[0, 0]
    np.testing.assert_array_equal(entries.flat(entries.column(column)), column)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_precision_is_that_of_the_entries(dtype):
    x = jnp.asarray(0.7, dtype)
    for matrix in sample(x):
        assert matrix.dtype == entries.dense(matrix).dtype == dtype


def test_symmetric_computes_one_triangle():
    asked = []

    def entry(i, j):
        asked.append((i, j))
        return 10 * i + j

    matrix = entries.symmetric(entry, 3)
    assert asked == [(i, j) for i in range(3) for j in range(i, 3)]
    np.testing.assert_array_equal(np.asarray(matrix), np.asarray(matrix.T))
    assert matrix.rows[2][1] == 12


def test_what_was_joined_is_not_taken_apart_again():
    """Entries go across `dense` and `split` as they are, while a program is traced."""
    seen = {}

    def join(x):
        matrix = sample(x)[0]
        array = entries.dense(matrix)
        again = entries.split(array)
        seen["same"] = again.rows[0][1] is matrix.rows[0][1]
        seen["flat"] = entries.column(entries.flat(Matrix([[x], [0]]))).rows[0][0] is x
        seen["changed"] = entries.split(array + 0.0).rows[0][1] is x
        seen["leaves"] = len(jax.tree.leaves(again))
        return again @ entries.split(2.0 * array).T, array

    x = np.array([0.5, -3.0])
    product, array = jax.jit(jax.vmap(join))(x)
    assert seen == {"same": True, "flat": True, "changed": False, "leaves": 6}
    expected = np.stack([as_numpy(value)[0] for value in x])
    chex.assert_trees_all_close(array, expected, rtol=1e-14)
    square = 2 * expected @ expected.transpose(0, 2, 1)
    chex.assert_trees_all_close(entries.dense(product), square, rtol=1e-14)


@pytest.mark.parametrize("take", [entries.split, entries.column])
@pytest.mark.parametrize("join", [entries.dense, entries.flat])
def test_traced_or_not_the_entries_are_the_same(join, take):
    """Also where one function joined rows and the other takes columns apart."""

    def both(x):
        tall = Matrix([[x], [2.0 * x], [0]])
        return entries.dense(take(join(tall)))

    x = np.arange(4.0)
    if (join, take) == (entries.flat, entries.split):
        expected = np.stack([x, 2 * x, 0 * x], 1)  # of a vector each, a row
    else:
        expected = both(x)
    chex.assert_trees_all_close(jax.jit(both)(x), expected, rtol=1e-15)


def test_numbers_of_python_have_the_type_of_the_array():
    """Where float64 is the default, as here."""

    def half(x):
        return entries.split(entries.dense(Matrix([[x, 0]]))).rows[0][0] * np.float32(2)

    assert jax.jit(half)(0.5).dtype == half(0.5).dtype == np.float64


def test_nothing_is_remembered_of_a_program_that_is_traced():
    jax.jit(lambda x: entries.dense(sample(x)[0]))(0.3)
    gc.collect()
    assert not entries._MADE
