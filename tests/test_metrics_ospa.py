"""Tests of `jaxtrack.metrics.ospa` against all pairings tried one by one."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from reference import metrics as reference

from jaxtrack.metrics import ospa

measure = jax.jit(ospa.ospa)
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
def test_ospa_follows_the_definition(seed, cutoff, order):
    truth, estimate = random_set(seed), random_set(1000 + seed, NUM + 1)
    expected = reference.ospa(members(*truth), members(*estimate), cutoff, order)
    result = measure(*truth, *estimate, cutoff, order)
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-12)


def test_ospa_assigns_on_the_cut_distance_to_the_power_of_the_order():
    truth = jnp.array([[0.0, 0.0], [3.0, 0.0]])
    estimate = jnp.array([[3.2, 0.0], [6.0, 0.0]])
    both = jnp.ones(2, bool)
    distance = measure(truth, both, estimate, both, 10.0, 2.0).distance
    np.testing.assert_allclose(distance, (19.24 / 2) ** 0.5)  # 3.102, not 4.245

    # Pairs (3, sqrt 10) have the smaller squares, pairs (0, 5) the smaller sum.
    estimate = jnp.array([[3.0, 0.0], [4.0, 3.0]])
    distance = measure(truth, both, estimate, both, 10.0, 2.0).distance
    np.testing.assert_allclose(distance, (19 / 2) ** 0.5)
    distance = measure(truth, both, estimate, both, 10.0, 1.0).distance
    np.testing.assert_allclose(distance, 5 / 2)


@pytest.mark.parametrize("seed", range(20))
def test_ospa_is_a_metric(seed):
    x, y, z = random_set(seed), random_set(100 + seed), random_set(200 + seed)
    xy = measure(*x, *y, 15.0, 2.0).distance
    yx = measure(*y, *x, 15.0, 2.0).distance
    yz = measure(*y, *z, 15.0, 2.0).distance
    xz = measure(*x, *z, 15.0, 2.0).distance
    assert measure(*x, *x, 15.0, 2.0).distance == 0
    np.testing.assert_allclose(xy, yx, rtol=1e-12)
    assert xz <= xy + yz + 1e-12
    assert 0 <= xz <= 15.0 + 1e-12


def test_ospa_of_empty_sets():
    points, none = jnp.zeros((NUM, 2)), jnp.zeros(NUM, bool)
    some = none.at[1].set(True)
    assert measure(points, none, points, none, 15.0, 2.0) == (0.0, 0.0, 0.0)
    assert measure(points, none, points, some, 15.0, 2.0) == (15.0, 0.0, 15.0)
    assert measure(points, some, points, none, 15.0, 2.0) == (15.0, 0.0, 15.0)
    no_slots = jnp.zeros((0, 2)), jnp.zeros(0, bool)
    assert measure(*no_slots, *no_slots, 15.0, 2.0) == (0.0, 0.0, 0.0)
    assert measure(*no_slots, points, some, 15.0, 2.0) == (15.0, 0.0, 15.0)
    assert measure(points, some, *no_slots, 15.0, 2.0) == (15.0, 0.0, 15.0)


def test_ospa_ignores_padding_and_the_order_of_slots():
    truth, (estimate, exists) = random_set(1), random_set(5)
    before = measure(*truth, estimate, exists, 12.0, 2.0)
    slots = np.array([2, 0, 3, 1])
    turned = measure(*truth, estimate[slots], exists[slots], 12.0, 2.0)
    chex.assert_trees_all_close(turned, before, rtol=1e-12)

    padded = jnp.pad(estimate, ((3, 2), (0, 0)), constant_values=jnp.nan)
    after = measure(*truth, padded, jnp.pad(exists, (3, 2)), 12.0, 2.0)
    chex.assert_trees_all_close(after, before, rtol=1e-12)


def test_ospa_takes_a_point_that_is_not_finite_for_a_far_one():
    nowhere, yes = jnp.full((NUM, 2), jnp.nan), jnp.ones(NUM, bool)
    result = measure(jnp.zeros((NUM, 2)), yes, nowhere, yes, 15.0, 2.0)
    assert result == (15.0, 15.0, 0.0)


def test_ospa_has_correct_gradients():
    rng = np.random.default_rng(3)
    truth, estimate = rng.normal(size=(2, NUM, 2)) * 10
    yes = jnp.ones(NUM, bool)

    @jax.jit
    def parts(truth, estimate, cutoff, order):
        return ospa.ospa(truth, yes, estimate, yes.at[0].set(False), cutoff, order)

    points = jnp.asarray(truth), jnp.asarray(estimate), 20.0, 2.0
    check_grads(parts, points, order=1, modes=["rev"], rtol=1e-5)


@jax.jit
def both_ways(points, others, cutoff, exists):
    """Sum of all parts, from the points to some of the others and back."""
    yes = jnp.ones(NUM, bool)
    there = ospa.ospa(points, yes, others, exists, cutoff)
    back = ospa.ospa(others, exists, points, yes, cutoff)
    return sum(there) + sum(back)


slopes_both_ways = jax.jit(jax.grad(both_ways, (0, 1, 2)))


@pytest.mark.parametrize("num_estimates", [0, 1, NUM])
def test_ospa_has_a_finite_gradient_where_points_coincide(num_estimates):
    points = jnp.arange(2.0 * NUM).reshape(NUM, 2)
    exists = jnp.arange(NUM) < num_estimates
    others = jnp.where(exists[:, None], points, jnp.nan)  # nobody may look there
    slopes = slopes_both_ways(points, others, 12.0, exists)
    chex.assert_trees_all_equal(slopes[:2], (jnp.zeros((NUM, 2)),) * 2)
    np.testing.assert_allclose(slopes[2], 4 * (1 - num_estimates / NUM) ** 0.5)


def test_ospa_batches_over_runs_and_traces_once():
    truths = jax.tree.map(lambda *x: jnp.stack(x), *map(random_set, range(5)))
    others = jax.tree.map(lambda *x: jnp.stack(x), *map(random_set, range(9, 14)))
    one = chex.assert_max_traces(lambda *x: ospa.ospa(*x, 12.0), n=1)
    batched = jax.jit(jax.vmap(one))
    for _ in range(2):
        result = batched(*truths, *others)
    expected = [
        measure(*random_set(a), *random_set(b), 12.0, 2.0)
        for a, b in zip(range(5), range(9, 14), strict=True)
    ]
    expected = jax.tree.map(lambda *x: jnp.stack(x), *expected)
    chex.assert_trees_all_close(result, expected, rtol=1e-12)


def test_ospa_in_single_precision_stays_in_it_and_near():
    truth, estimate = random_set(3, scale=1e5), random_set(4, scale=1e5)
    exact = measure(*truth, *estimate, 1e5, 2.0)
    single = [(points.astype(jnp.float32), yes) for points, yes in (truth, estimate)]
    result = measure(*single[0], *single[1], 1e5, 2.0)
    assert {part.dtype for part in result} == {jnp.dtype("float32")}
    np.testing.assert_allclose(result, exact, rtol=1e-5)


def test_ospa_names_the_shape_it_wanted():
    points = jnp.zeros((2, 2))
    with pytest.raises(AssertionError, match=r"\(3,\) but expected \(2\)"):
        ospa.ospa(points, jnp.ones(3, bool), points, jnp.ones(2, bool), 1.0)
