"""Tests of `assign.best` against SciPy, over many random matrices of each shape."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import assign as reference
from scipy.optimize import linear_sum_assignment

from jaxtrack.assign import best

INF = np.inf
many = jax.jit(jax.vmap(best.best))
least = jax.jit(jax.vmap(best.least))


def scipy_best(log_score):
    """The same with a column of its own for each track's miss."""
    num, miss = len(log_score), log_score[:, -1]
    cost = np.hstack([-log_score[:, :-1], np.where(np.eye(num), -miss[:, None], INF)])
    try:
        return -cost[linear_sum_assignment(cost)].sum()
    except ValueError:
        return -INF


def draw(shape, rounded, count=500):
    """Matrices from empty to full; half of them also lack some misses."""
    rng = np.random.default_rng(sum(shape))
    num_tracks, num_detections = shape
    drawn = [reference.scores(rng, *shape, gate) for gate in rng.random(count)]
    log_score = np.array(drawn).reshape(count, num_tracks, num_detections + 1)
    log_score[::2, :, -1][rng.random((len(log_score[::2]), num_tracks)) < 0.5] = -INF
    return np.round(log_score) if rounded else log_score


@pytest.mark.parametrize("rounded", [False, True], ids=["distinct", "tied"])
@pytest.mark.parametrize("shape", [(1, 0), (3, 0), (1, 1), (4, 4), (5, 9), (9, 5)])
def test_best_is_the_optimum_and_its_prices_prove_it(shape, rounded):
    log_score = draw(shape, rounded)
    found = jax.tree.map(np.asarray, many(jnp.asarray(log_score)))
    expected = np.array([scipy_best(one) for one in log_score])
    fits = expected > -INF
    np.testing.assert_array_equal(found.feasible, fits)
    np.testing.assert_allclose(found.log_score[fits], expected[fits], rtol=1e-12)
    assert (found.log_score[~fits] == -INF).all()
    assert all(np.isfinite(x).all() for x in found[:1] + found[2:])

    # Of sums of a few scores of order one, so rounding is far below this.
    slack, miss = 1e-12, shape[1]
    for one, column, u, v in zip(
        log_score[fits],
        found.column[fits],
        found.track_price[fits],
        found.detection_price[fits],
        strict=True,
    ):
        taken = column[column < miss]
        assert len(set(taken)) == len(taken)
        total = one[np.arange(shape[0]), column].sum()
        np.testing.assert_allclose(total, u.sum() + v.sum(), atol=slack)
        assert (one[:, :miss] <= u[:, None] + v[None] + slack).all()
        assert (one[:, miss] <= u + slack).all()
        assert (v >= 0).all()


def test_best_equals_enumeration_of_all_events():
    log_score = draw((4, 4), rounded=False, count=60)
    found = many(jnp.asarray(log_score)).log_score
    expected = [reference.best(one) for one in log_score]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("shape", [(1, 1), (6, 6), (5, 9), (40, 70)])
def test_least_costs_what_scipy_finds(shape):
    cost = np.random.default_rng(0).normal(size=(100, *shape))
    found = least(jnp.asarray(cost))
    expected = [one[linear_sum_assignment(one)].sum() for one in cost]
    np.testing.assert_allclose(found.cost, expected, rtol=1e-12)
    assert found.feasible.all()
    assert all(np.unique(column).size == shape[0] for column in found.column)


def test_least_says_where_rows_find_no_columns():
    cost = jnp.array([[[1.0, INF], [2.0, INF]], [[1.0, jnp.nan], [2.0, 3.0]]])
    found = least(cost)
    assert not found.feasible.any()
    assert (found.cost == INF).all()
    assert not least(jnp.zeros((1, 3, 2))).feasible.any()


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_what_is_no_score_makes_the_problem_infeasible(wrong):
    log_score = np.zeros((1, 4, 5))
    log_score[0, 1, 2] = wrong
    found = many(jnp.asarray(log_score))
    assert not found.feasible.any()
    assert found.log_score[0] == -INF
    chex.assert_tree_all_finite((found.column, found.track_price))


def test_gradient_is_that_of_the_chosen_scores():
    log_score = jnp.array([[5.0, 2.0, -INF, 0.0], [4.0, -2.0, -INF, 0.0]])
    slope = jax.jit(jax.grad(lambda x: best.best(x).log_score))(log_score)
    chex.assert_trees_all_equal(
        slope, jnp.array([[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    )


def test_batches_of_batches_in_blocks_and_one_alone_agree():
    log_score = jnp.asarray(draw((4, 4), rounded=True, count=1201))[:1200]
    nested = jax.jit(jax.vmap(jax.vmap(best.best)))(log_score.reshape(3, 400, 4, 5))
    flat = jax.tree.map(lambda x: x.reshape(1200, *x.shape[2:]), nested)
    chex.assert_trees_all_equal(flat, many(log_score))
    alone = jax.jit(best.best)
    for k in range(3):
        one = jax.tree.map(lambda x, k=k: x[k], flat)
        chex.assert_trees_all_equal(one, alone(log_score[k]))


def test_float32_finds_the_same_events():
    log_score = draw((5, 9), rounded=False)[1::2]
    single = many(jnp.asarray(log_score, jnp.float32))
    double = many(jnp.asarray(log_score))
    assert single.log_score.dtype == jnp.float32
    chex.assert_trees_all_equal(single.column, double.column)


def test_no_tracks_at_all_are_no_trouble():
    found = jax.jit(best.best)(jnp.zeros((0, 4)))
    assert found.feasible
    assert found.log_score == 0
    assert found.detection_price.shape == (3,)
