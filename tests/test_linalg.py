import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from reference.kalman import slopes, weighted_sum

from jaxtrack import entries, linalg

SIZES = range(1, 9)  # both sides of linalg.UNROLL
BOTH_SIDES = [2, linalg.UNROLL + 1]


def random_problem(size):
    """Matrices of three different shapes, so that a transpose cannot pass."""
    rng = np.random.default_rng(size)
    root = rng.normal(size=(size, size))
    cov = jnp.asarray(root @ root.T + np.eye(size))
    tall = jnp.asarray(rng.normal(size=(size + 1, size)))
    wide = jnp.asarray(rng.normal(size=(size, 3)))
    return cov, tall, wide


@jax.jit
def everything(cov, tall, wide):
    lower = linalg.cholesky(cov)
    vector = wide[:, 0]
    return {
        "symmetrize": linalg.symmetrize(cov + jnp.outer(vector, wide[:, 1])),
        "product": linalg.product(tall, wide),
        "inner": linalg.product(wide.T, wide),
        "congruence": linalg.congruence(tall, cov),
        "cholesky": lower,
        "lower": linalg.solve_lower(lower, wide),
        "lower_vector": linalg.solve_lower(lower, vector),
        "upper": linalg.solve_upper(lower, wide),
        "upper_vector": linalg.solve_upper(lower, vector),
        "solve": linalg.solve(lower, wide),
        "solve_vector": linalg.solve(lower, vector),
        "log_normal": linalg.log_normal(vector, lower),
    }


def everything_by_numpy(cov, tall, wide):
    cov, tall, wide = map(np.asarray, (cov, tall, wide))
    lower = np.linalg.cholesky(cov)
    inverse, vector = np.linalg.inv(lower), wide[:, 0]
    skew = cov + np.outer(vector, wide[:, 1])
    distance = vector @ np.linalg.inv(cov) @ vector
    return {
        "symmetrize": (skew + skew.T) / 2,
        "product": tall @ wide,
        "inner": wide.T @ wide,
        "congruence": tall @ cov @ tall.T,
        "cholesky": lower,
        "lower": inverse @ wide,
        "lower_vector": inverse @ vector,
        "upper": inverse.T @ wide,
        "upper_vector": inverse.T @ vector,
        "solve": np.linalg.inv(cov) @ wide,
        "solve_vector": np.linalg.inv(cov) @ vector,
        "log_normal": -(distance + np.log(np.linalg.det(2 * np.pi * cov))) / 2,
    }


@pytest.mark.parametrize("size", SIZES)
def test_every_function_agrees_with_numpy(size):
    problem = random_problem(size)
    expected = everything_by_numpy(*problem)
    chex.assert_trees_all_close(everything(*problem), expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("size", SIZES)
def test_symmetric_results_are_symmetric_to_the_last_bits(size):
    result = everything(*random_problem(size))
    for name in ("symmetrize", "congruence"):
        # XLA may fuse a multiply-add on one side of the average, not the other.
        np.testing.assert_array_max_ulp(result[name], result[name].T, maxulp=4)


@pytest.mark.parametrize("size", SIZES)
def test_cholesky_factor_is_zero_above_the_diagonal(size):
    lower = everything(*random_problem(size))["cholesky"]
    np.testing.assert_array_equal(jnp.triu(lower, 1), 0)


@pytest.mark.parametrize("size", BOTH_SIDES)
def test_gradients_agree_with_finite_differences(size):
    vector, unravel = ravel_pytree(random_problem(size))

    @jax.jit
    @jax.value_and_grad
    def loss(vector):
        cov, tall, wide = unravel(vector)
        outcome = everything(linalg.symmetrize(cov), tall, wide)
        return weighted_sum(outcome.values())

    by_gradient, by_differences = slopes(loss, vector)
    np.testing.assert_allclose(by_gradient, by_differences, rtol=1e-7)


@pytest.mark.parametrize("size", BOTH_SIDES)
def test_gradient_of_a_density_in_its_covariance_is_symmetric(size):
    @jax.jit
    @jax.grad
    def gradient(cov, matrix, residual):
        spread = linalg.congruence(matrix, cov) + jnp.eye(size)
        return linalg.log_normal(residual, linalg.cholesky(spread))

    cov, tall, wide = random_problem(size)
    slope = gradient(cov, tall[1:], wide[:, 0])
    chex.assert_trees_all_close(slope, slope.T, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_precision_of_the_arguments_is_kept(dtype):
    problem = [x.astype(dtype) for x in random_problem(3)]
    for result in everything(*problem).values():
        assert result.dtype == dtype


@pytest.mark.parametrize("size", [1, 3, linalg.UNROLL])
def test_matrices_by_entries_give_the_same(size):
    cov, tall, wide = random_problem(size)

    @jax.jit
    def apart(cov, tall, wide):
        cov, matrix = entries.split(cov), entries.split(tall)[:size]
        right = entries.split(wide)
        lower = linalg.cholesky(cov)
        white = linalg.solve_lower(lower, linalg.column(wide[:, 0]))
        told = {
            "product": linalg.product(entries.split(wide), entries.split(wide.T)),
            "congruence": linalg.congruence(entries.split(matrix), cov),
            "cholesky": lower,
            "solve": linalg.solve(lower, right),
            "upper": linalg.solve_upper(lower, right),
            "settle": linalg.settle(right),
            "triangle": linalg.triangle(cov),
        }
        assert all(isinstance(x, entries.Matrix) for x in told.values())
        return entries.arrays(told) | {"log_normal": linalg.log_white(white, lower)}

    want = everything_by_numpy(cov, tall, wide)
    want |= {"product": wide @ wide.T, "settle": wide, "triangle": cov}
    want["congruence"] = tall[:size] @ cov @ tall[:size].T
    got = apart(cov, tall, wide)
    chex.assert_trees_all_close(got, {k: want[k] for k in got}, rtol=1e-10, atol=1e-10)


def test_symmetric_is_the_mean_and_triangle_the_upper_one():
    skew = jnp.array([[1.0, 2.0], [4.0, 3.0]])
    for matrix in (skew, entries.split(skew)):
        np.testing.assert_array_equal(linalg.symmetric(matrix), [[1, 3], [3, 3]])
        np.testing.assert_array_equal(linalg.triangle(matrix), [[1, 2], [2, 3]])


@pytest.mark.parametrize("size", BOTH_SIDES)
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_loosen_adds_a_few_roundings_to_each_variance(size, dtype):
    cov = random_problem(size)[0].astype(dtype)
    loose = entries.dense(linalg.loosen(linalg.entries(cov)))
    added = np.asarray(loose - cov) / np.finfo(dtype).eps
    np.testing.assert_array_equal(added[~np.eye(size, dtype=bool)], 0)
    share = np.diag(added) / np.diag(cov)
    assert (share > size).all()
    assert (share < 4 * size).all()


def test_settle_leaves_values_gradients_and_what_is_known():
    @jax.jit
    @jax.value_and_grad
    def loss(x):
        settled = linalg.settle(entries.Matrix([[0, x], [x, 1]]))
        assert settled.rows[0][0] == 0
        assert settled.rows[0][1] is settled.rows[1][0]
        return settled.rows[0][1] ** 3

    value, slope = loss(2.0)
    assert (float(value), float(slope)) == (8.0, 12.0)


def test_rows_puts_entries_where_they_are_written():
    matrix = linalg.rows([[1, jnp.array(2.0), 3], [0, 0.5, jnp.array(6.0)]])
    np.testing.assert_array_equal(matrix, [[1, 2, 3], [0, 0.5, 6]])


def test_product_names_the_shape_it_wanted():
    with pytest.raises(AssertionError, match=r"\(3, 2\) but expected \(2, "):
        linalg.product(jnp.zeros((4, 2)), jnp.zeros((3, 2)))


def test_safe_log_is_minus_infinity_with_zero_slope_where_nothing_is():
    values = jnp.array([2.0, 1.0, 0.0])
    value, slope = jax.vmap(jax.value_and_grad(linalg.safe_log))(values)
    chex.assert_trees_all_close(value, jnp.array([np.log(2.0), 0.0, -np.inf]))
    chex.assert_trees_all_close(slope, jnp.array([0.5, 1.0, 0.0]))


@pytest.mark.parametrize("scale", [1e-90, 1e90])
def test_densities_do_not_overflow(scale):
    got = linalg.log_normal(jnp.zeros(5), scale * jnp.eye(5))
    np.testing.assert_allclose(got, -5 * np.log(scale * np.sqrt(2 * np.pi)))
