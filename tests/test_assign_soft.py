"""Tests of `assign.soft`: what it maximises, its limit and its derivatives.

Shares are between 0 and 1, and so are slopes, so bounds on them are absolute.
"""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import assign as reference

from jaxtrack.assign import best, soft

INF = np.inf
solve = jax.jit(jax.vmap(soft.soft, (0, None)))


def draw(shape, count=50):
    rng = np.random.default_rng(sum(shape))
    drawn = [reference.scores(rng, *shape, gate) for gate in rng.random(count)]
    return np.array(drawn).reshape(count, shape[0], shape[1] + 1)


@pytest.mark.parametrize("shape", [(1, 0), (1, 3), (4, 4), (3, 6), (6, 3)])
def test_shares_are_those_of_the_maximum(shape):
    log_score, temperature = draw(shape), 0.7
    found = jax.tree.map(np.asarray, solve(jnp.asarray(log_score), temperature))
    assert found.converged.all()
    pair = found.prob[:, :, :-1]
    slack = 1 - pair.sum(1)
    np.testing.assert_allclose(found.prob.sum(2), 1)
    assert (slack > 0).all()
    # There all derivatives along the constraints are zero: a pair against a miss and
    # a detection left to clutter.
    pairs, misses = log_score[:, :, :-1], log_score[:, :, -1:]
    at = np.broadcast_to(np.log(found.prob[:, :, -1:]), pair.shape)
    at = at + np.log(slack)[:, None]
    inside = (pair > 0) & (found.prob[:, :, -1:] > 0)
    left = (pairs - misses)[inside] / temperature
    # Shares are settled to 1e-12, logs of small ones less.
    np.testing.assert_allclose(np.log(pair[inside]) - at[inside], left, atol=1e-6)
    assert (pair[pairs == -INF] == 0).all()


def test_shares_tend_to_the_best_event():
    log_score = draw((4, 4))
    column = np.asarray(jax.jit(jax.vmap(best.best))(jnp.asarray(log_score)).column)
    far = []
    for temperature in 1.0, 0.1, 0.01:
        prob = solve(jnp.asarray(log_score), temperature).prob
        far.append(np.abs(prob - np.eye(5)[column]).max((1, 2)))
    assert np.median(far[0]) > np.median(far[1]) > np.median(far[2])
    # Those of near ties are not there yet.
    assert np.quantile(far[2], 0.9) < 1e-3


def test_derivatives_are_those_of_finite_differences():
    log_score = draw((4, 4))[3]

    def loss(score, temperature):
        return (soft.soft(score, temperature).prob ** 2).sum(1)

    value, slopes = jax.jit(loss), jax.jit(jax.jacrev(loss, (0, 1)))
    first = slopes(log_score, 0.5)
    second = jax.jit(jax.jacfwd(lambda x: slopes(x, 0.5)[0]))(log_score)
    chex.assert_tree_all_finite((first, second))
    step = 1e-5
    for n, k in np.argwhere(log_score > -INF):
        move = np.zeros_like(log_score)
        move[n, k] = step
        for function, exact in (value, first[0]), (lambda *x: slopes(*x)[0], second):
            gap = function(log_score + move, 0.5) - function(log_score - move, 0.5)
            # Differences of numbers of order one, over a step of 1e-5.
            np.testing.assert_allclose(exact[..., n, k], gap / 2e-5, atol=1e-6)
    gap = value(log_score, 0.5 + step) - value(log_score, 0.5 - step)
    np.testing.assert_allclose(first[1], gap / 2e-5, atol=1e-6)
    assert (np.asarray(first[0])[:, log_score == -INF] == 0).all()


def test_derivatives_without_any_slack():
    log_score = jnp.array([[1.0, 0.5, -INF], [0.2, 0.3, -INF]])
    slope = jax.jit(jax.jacrev(lambda x: soft.soft(x).prob[0, 0]))(log_score)
    # Shares p and 1 - p with p / (1 - p) = exp of half the difference of the sums.
    p = 1 / (1 + np.exp(-(1.0 + 0.3 - 0.5 - 0.2) / 2))
    expected = p * (1 - p) / 2 * np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]])
    # Slack of nothing is reached slowly, and the equations are nearly singular.
    np.testing.assert_allclose(slope, expected, atol=1e-2)


def test_what_is_infeasible_gives_zeros_and_finite_gradients():
    log_score = jnp.array([[1.0, -INF, -INF], [2.0, -INF, -INF]])
    found = jax.jit(soft.soft)(log_score)
    assert not found.feasible
    assert (found.prob == 0).all()
    slope = jax.jit(jax.grad(lambda x: soft.soft(x).prob.sum()))(log_score)
    chex.assert_tree_all_finite(slope)


def test_float32_is_near_float64():
    log_score = draw((4, 4))
    double = solve(jnp.asarray(log_score), 1.0)
    single = solve(jnp.asarray(log_score, jnp.float32), jnp.float32(1.0))
    assert single.prob.dtype == jnp.float32
    # Shares settle to 1e-5 in float32.
    np.testing.assert_allclose(single.prob, double.prob, atol=1e-4)


def test_settings_are_checked():
    with pytest.raises(ValueError, match="temperature is 0; it must be positive"):
        soft.soft(jnp.zeros((2, 3)), 0)
    with pytest.raises(ValueError, match="max_iterations is 0; give at least 1"):
        soft.soft(jnp.zeros((2, 3)), max_iterations=0)
