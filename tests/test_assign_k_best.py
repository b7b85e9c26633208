"""Tests of `assign.k_best` against a sorted list of all joint events.

Sums of scores may be zero, so bounds on them are absolute.
"""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import assign as reference

from jaxtrack.assign import k_best

INF = np.inf
K = 12
many = jax.jit(jax.vmap(lambda log_score: k_best.k_best(log_score, K)))


def draw(shape, rounded, count=60):
    rng = np.random.default_rng(sum(shape))
    drawn = [reference.scores(rng, *shape, gate) for gate in rng.random(count)]
    log_score = np.array(drawn).reshape(count, shape[0], shape[1] + 1)
    log_score[::2, :, -1][rng.random((len(log_score[::2]), shape[0])) < 0.3] = -INF
    return np.round(log_score / 3) if rounded else log_score


@pytest.mark.parametrize("rounded", [False, True], ids=["distinct", "tied"])
@pytest.mark.parametrize("shape", [(1, 0), (1, 4), (2, 2), (4, 3), (3, 5)])
def test_events_are_the_best_in_order_and_each_comes_once(shape, rounded):
    log_score = draw(shape, rounded)
    found = jax.tree.map(np.asarray, many(jnp.asarray(log_score)))
    for k, one in enumerate(log_score):
        listed = {key: total for key, total in reference.events(one)}
        expected = sorted(listed.values(), reverse=True)[:K]
        count = len(expected)
        assert found.feasible[k].sum() == count
        assert found.feasible[k, :count].all()
        # Sums of scores of order one.
        np.testing.assert_allclose(found.log_score[k, :count], expected, atol=1e-12)
        assert (found.log_score[k, count:] == -INF).all()
        columns = [tuple(x) for x in found.column[k, :count].tolist()]
        assert len(set(columns)) == count
        totals = [listed[key] for key in columns]
        # Sums of scores of order 1, which may be 0.
        np.testing.assert_allclose(totals, expected, atol=1e-12)


def test_a_long_list_is_complete_and_in_order():
    log_score = draw((5, 6), rounded=False, count=4)
    long = jax.jit(jax.vmap(lambda x: k_best.k_best(x, 300)))(jnp.asarray(log_score))
    for one, totals, fits in zip(log_score, long.log_score, long.feasible, strict=True):
        listed = sorted((total for _, total in reference.events(one)), reverse=True)
        expected = listed[:300]
        assert fits.sum() == len(expected)
        # Sums of scores of order one.
        np.testing.assert_allclose(totals[: len(expected)], expected, atol=1e-12)


def test_gradient_is_that_of_the_chosen_scores():
    log_score = jnp.asarray(draw((4, 3), rounded=False)[1])
    column = k_best.k_best(log_score, 3).column
    slope = jax.jit(jax.jacrev(lambda x: k_best.k_best(x, 3).log_score))(log_score)
    chex.assert_trees_all_equal(slope, jax.nn.one_hot(column, 4, dtype=slope.dtype))


def test_float32_finds_the_same_events():
    log_score = draw((4, 3), rounded=False)
    single, double = many(jnp.asarray(log_score, jnp.float32)), many(log_score)
    fits = np.asarray(double.feasible)
    np.testing.assert_array_equal(single.feasible, fits)
    np.testing.assert_array_equal(single.column[fits], double.column[fits])


def test_none_at_all_is_refused():
    with pytest.raises(ValueError, match="k is 0; give at least 1"):
        k_best.k_best(jnp.zeros((2, 3)), 0)
