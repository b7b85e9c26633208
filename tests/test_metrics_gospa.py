"""Tests of `jaxtrack.metrics.gospa` against all pairings tried one by one."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from reference import metrics as reference

from jaxtrack.metrics import gospa

measure = jax.jit(gospa.gospa)
rmse = jax.jit(gospa.rmse)
NUM = 4


def random_set(seed, num=NUM, scale=10.0):
    """A masked set of 0 to `num` points; what is behind an empty slot is large."""
    rng = np.random.default_rng(seed)
    exists = rng.random(num) < rng.choice([0.0, 0.4, 0.7, 1.0])
    points = np.where(exists[:, None], rng.normal(size=(num, 2)) * scale, 1e6)
    return jnp.asarray(points), jnp.asarray(exists)


def members(points, exists):
    return np.asarray(points)[np.asarray(exists)].tolist()


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize(("cutoff", "order"), [(12.0, 2.0), (25.0, 1.0), (60.0, 3.5)])
def test_gospa_follows_the_definition(seed, cutoff, order):
    truth, estimate = random_set(seed), random_set(1000 + seed, NUM + 1)
    expected = reference.gospa(members(*truth), members(*estimate), cutoff, order)
    result = measure(*truth, *estimate, cutoff, order)
    np.testing.assert_allclose(result, expected[:6], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_rmse_is_taken_over_the_pairs_of_the_definition(seed):
    truth, estimate = random_set(seed), random_set(1000 + seed, NUM + 1)
    X, Y = members(*truth), members(*estimate)
    pairs = reference.gospa(X, Y, 12.0, 2)[-1]
    squares = [reference.gap(X[i], Y[j]) ** 2 for i, j in pairs]
    expected = np.sqrt(np.mean(squares)) if squares else 0.0
    result = rmse(*truth, *estimate, 12.0)
    np.testing.assert_allclose(result, (expected, len(pairs)), rtol=1e-12)


def test_pairs_are_made_on_the_distance_to_the_power_of_the_order():
    # Pairs (3, sqrt 10) have the smaller squares, pairs (0, 5) the smaller sum.
    truth = jnp.array([[0.0, 0.0], [3.0, 0.0]])
    estimate = jnp.array([[3.0, 0.0], [4.0, 3.0]])
    both = jnp.ones(2, bool)
    sets = truth, both, estimate, both
    np.testing.assert_allclose(measure(*sets, 10.0, 2.0).localisation, 19)
    np.testing.assert_allclose(measure(*sets, 10.0, 1.0).localisation, 5)
    np.testing.assert_allclose(rmse(*sets, 10.0).error, (19 / 2) ** 0.5)


@pytest.mark.parametrize("seed", range(20))
def test_gospa_is_a_metric(seed):
    x, y, z = random_set(seed), random_set(100 + seed), random_set(200 + seed)
    xy = measure(*x, *y, 15.0, 2.0).distance
    yx = measure(*y, *x, 15.0, 2.0).distance
    yz = measure(*y, *z, 15.0, 2.0).distance
    xz = measure(*x, *z, 15.0, 2.0).distance
    assert measure(*x, *x, 15.0, 2.0).distance == 0
    np.testing.assert_allclose(xy, yx, rtol=1e-12)
    assert xz <= xy + yz + 1e-12


def test_gospa_of_empty_sets():
    points, none = jnp.zeros((NUM, 2)), jnp.zeros(NUM, bool)
    three = none.at[1:].set(True)
    assert measure(points, none, points, none, 10.0, 2.0) == (0, 0, 0, 0, 0, 0)
    missed = measure(points, three, points, none, 10.0, 2.0)
    np.testing.assert_allclose(missed, (150**0.5, 0, 150, 0, 3, 0))
    false = measure(points, none, points, three, 10.0, 2.0)
    np.testing.assert_allclose(false, (150**0.5, 0, 0, 150, 0, 3))
    no_slots = jnp.zeros((0, 2)), jnp.zeros(0, bool)
    np.testing.assert_array_equal(measure(*no_slots, points, three, 10.0, 2.0), false)


def test_gospa_counts_a_pair_at_the_cut_off_as_missed_and_false():
    points, first = jnp.zeros((NUM, 2)), jnp.arange(NUM) == 0
    there = points.at[0].set(jnp.array([6.0, 8.0]))
    result = measure(points, first, there, first, 10.0, 2.0)
    np.testing.assert_allclose(result, (10, 0, 50, 50, 1, 1))


def test_gospa_ignores_padding_and_the_order_of_slots():
    truth, (estimate, exists) = random_set(1), random_set(5)
    before = measure(*truth, estimate, exists, 12.0, 2.0)
    slots = np.array([2, 0, 3, 1])
    turned = measure(*truth, estimate[slots], exists[slots], 12.0, 2.0)
    chex.assert_trees_all_close(turned, before, rtol=1e-12)

    padded = jnp.pad(estimate, ((3, 2), (0, 0)), constant_values=jnp.nan)
    after = measure(*truth, padded, jnp.pad(exists, (3, 2)), 12.0, 2.0)
    chex.assert_trees_all_close(after, before, rtol=1e-12)


def test_gospa_has_correct_gradients():
    rng = np.random.default_rng(3)
    truth, estimate = rng.normal(size=(2, NUM, 2)) * 10
    yes = jnp.ones(NUM, bool)

    @jax.jit
    def parts(truth, estimate, cutoff, order):
        exists = yes.at[0].set(False)
        return gospa.gospa(truth, yes, estimate, exists, cutoff, order)[:4]

    points = jnp.asarray(truth), jnp.asarray(estimate), 20.0, 2.0
    check_grads(parts, points, order=1, modes=["rev"], rtol=1e-5)


@jax.jit
@jax.grad
def slope(points, others, exists):
    sets = points, jnp.ones(NUM, bool), others, exists
    return sum(gospa.gospa(*sets, 12.0)[:4]) + gospa.rmse(*sets, 12.0).error


@pytest.mark.parametrize("num_estimates", [0, 1, NUM])
def test_gradients_are_finite_where_points_coincide(num_estimates):
    points = jnp.arange(2.0 * NUM).reshape(NUM, 2)
    exists = jnp.arange(NUM) < num_estimates
    chex.assert_trees_all_equal(slope(points, points, exists), jnp.zeros((NUM, 2)))


def test_gospa_batches_over_runs():
    truths = jax.tree.map(lambda *x: jnp.stack(x), *map(random_set, range(5)))
    others = jax.tree.map(lambda *x: jnp.stack(x), *map(random_set, range(9, 14)))
    result = jax.jit(jax.vmap(lambda *x: gospa.gospa(*x, 12.0)))(*truths, *others)
    expected = [
        measure(*random_set(a), *random_set(b), 12.0, 2.0)
        for a, b in zip(range(5), range(9, 14), strict=True)
    ]
    expected = jax.tree.map(lambda *x: jnp.stack(x), *expected)
    chex.assert_trees_all_close(result, expected, rtol=1e-12)


def test_gospa_in_single_precision_stays_in_it_and_near():
    truth, estimate = random_set(3, scale=1e5), random_set(4, scale=1e5)
    exact = measure(*truth, *estimate, 1e5, 2.0)
    single = [(points.astype(jnp.float32), yes) for points, yes in (truth, estimate)]
    result = measure(*single[0], *single[1], 1e5, 2.0)
    assert {part.dtype for part in result[:4]} == {jnp.dtype("float32")}
    np.testing.assert_allclose(result, exact, rtol=1e-5)
