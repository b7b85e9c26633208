"""Tests of `jaxtrack.metrics.ospa2` against all pairings tried one by one."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from reference import metrics as reference
from test_metrics_trajectories import TIMES, as_lists, random_sets

from jaxtrack.metrics import ospa, ospa2

measure = jax.jit(ospa2.ospa2)
NUM = 200
EQUAL = jnp.ones(TIMES)


@pytest.mark.parametrize(
    ("cutoff", "order", "inner"), [(8.0, 2.0, 2.0), (12.0, 1.0, 1.0), (20.0, 3.0, 1.0)]
)
def test_ospa2_follows_the_definition(cutoff, order, inner):
    sets = [random_sets(seed) for seed in range(NUM)]
    weight = np.random.default_rng(0).random((NUM, TIMES))
    weight[:, 0] = 0
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *sets)
    many = jax.jit(jax.vmap(lambda w, *s: measure(*s, cutoff, order, inner, w)))
    found = many(jnp.asarray(weight), *stacked)
    expected = [
        reference.ospa2(as_lists(*s[:2]), as_lists(*s[2:]), cutoff, order, inner, w)
        for s, w in zip(sets, weight, strict=True)
    ]
    np.testing.assert_allclose(found.distance, expected, rtol=1e-12)
    parts = found.localisation**order + found.cardinality**order
    np.testing.assert_allclose(parts, found.distance**order, rtol=1e-12)


def test_the_inner_order_is_the_outer_one_by_default():
    sets = random_sets(1)
    other = measure(*sets, 10.0, 3.0, 3.0, EQUAL)
    chex.assert_trees_all_close(measure(*sets, 10.0, 3.0), other, rtol=1e-12)


def test_one_time_is_ospa():
    sets = random_sets(3)
    expected = ospa.ospa(*(x[0] for x in sets), 10.0)
    found = measure(*(x[:1] for x in sets), 10.0)
    chex.assert_trees_all_close(found, expected, rtol=1e-12)


def test_a_track_broken_in_two_is_no_perfect_track():
    sets = random_sets(0)
    truth, alive = sets[0][:, :1], jnp.ones((TIMES, 1), bool)
    early = (jnp.arange(TIMES) < 2)[:, None]
    halves = jnp.tile(truth, (1, 2, 1)), jnp.concatenate([early, ~early], 1)
    assert measure(truth, alive, truth, alive, 10.0).distance == 0
    # The longer half lacks two fifths of the time, and the other has no partner.
    expected = ((10**2 * 2 / 5 + 10**2) / 2) ** 0.5
    np.testing.assert_allclose(
        measure(truth, alive, *halves, 10.0).distance, expected, rtol=1e-12
    )


def test_over_time_looks_back_as_far_as_the_window():
    sets = random_sets(7)
    found = jax.jit(lambda *x: ospa2.over_time(*x, 10.0, window=3))(*sets)
    for k in range(TIMES):
        inside = (jnp.arange(TIMES) <= k) & (jnp.arange(TIMES) > k - 3)
        expected = measure(*sets, 10.0, 2.0, 2.0, jnp.where(inside, 1.0, 0.0))
        one = jax.tree.map(lambda x, k=k: x[k], found)
        chex.assert_trees_all_close(one, expected, rtol=1e-12)


def test_empty_sets_and_padding():
    truth, alive, estimate, reported = random_sets(2)
    none = jnp.zeros_like(reported)
    assert measure(truth, alive, estimate, none, 10.0).distance == 10
    assert measure(truth, alive & False, estimate, none, 10.0).distance == 0
    hidden = jnp.where(reported[..., None], estimate, jnp.nan)
    before = measure(truth, alive, estimate, reported, 10.0)
    after = measure(truth, alive, hidden, reported, 10.0)
    chex.assert_trees_all_close(after, before, rtol=1e-12)


def test_gradients_are_right_and_finite():
    truth, alive, estimate, reported = random_sets(5)
    distance = jax.jit(lambda x, y, c: measure(x, alive, y, reported, c).distance)
    check_grads(distance, (truth, estimate, 10.0), order=1, modes=["rev"], rtol=1e-5)
    same = jnp.concatenate([truth, truth[:, :1]], 1)
    slope = jax.grad(distance)(truth, same, 10.0)
    chex.assert_trees_all_equal(jnp.isfinite(slope), jnp.ones(slope.shape, bool))


def test_bad_settings_are_rejected():
    sets = random_sets(0)
    with pytest.raises(ValueError, match="window is 0; give at least 1"):
        ospa2.over_time(*sets, 10.0, window=0)
    with pytest.raises(ValueError, match="order is 0.5"):
        ospa2.ospa2(*sets, 10.0, 2.0, 0.5)
