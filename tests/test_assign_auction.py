"""Tests of `assign.auction` against the exact solver.

Totals may be zero, so bounds on their differences are absolute.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import assign as reference

from jaxtrack.assign import auction, best

INF = np.inf
many = jax.jit(jax.vmap(auction.auction, (0, None)))
exact = jax.jit(jax.vmap(best.best))


def draw(shape, count=200):
    rng = np.random.default_rng(sum(shape))
    drawn = [reference.scores(rng, *shape, gate) for gate in rng.random(count)]
    log_score = np.array(drawn).reshape(count, shape[0], shape[1] + 1)
    log_score[::2, :, -1][rng.random((len(log_score[::2]), shape[0])) < 0.3] = -INF
    return log_score


@pytest.mark.parametrize("shape", [(1, 0), (1, 1), (4, 4), (5, 9), (9, 5)])
def test_events_are_within_the_bound_and_exact_for_whole_numbers(shape):
    log_score = np.concatenate([draw(shape), np.round(draw(shape))])
    for epsilon in 0.5, 0.9 / shape[0]:
        found = jax.tree.map(np.asarray, many(jnp.asarray(log_score), epsilon))
        right = jax.tree.map(np.asarray, exact(jnp.asarray(log_score)))
        assert found.converged.all()
        np.testing.assert_array_equal(found.feasible, right.feasible)
        fits = right.feasible
        short = right.log_score[fits] - found.log_score[fits]
        # Sums of scores of order one.
        assert (short >= -1e-12).all()
        assert (short <= shape[0] * epsilon + 1e-12).all()
    whole = np.arange(len(log_score))[fits] >= len(log_score) // 2
    # Differences of totals, which should be 0.
    np.testing.assert_allclose(short[whole], 0, atol=1e-12)
    for column in found.column[found.feasible]:
        taken = column[column < shape[1]]
        assert len(set(taken)) == len(taken)


def test_too_few_rounds_are_told():
    log_score = jnp.zeros((3, 4)).at[:, -1].set(-9.0)
    found = auction.auction(log_score, 0.1, max_rounds=1)
    assert not found.converged
    assert not found.feasible
    assert found.log_score == -INF


def test_settings_are_checked():
    with pytest.raises(ValueError, match="epsilon is 0; it must be positive"):
        auction.auction(jnp.zeros((2, 3)), 0)
    with pytest.raises(ValueError, match="max_rounds is 0; give at least 1"):
        auction.auction(jnp.zeros((2, 3)), 0.1, 0)
