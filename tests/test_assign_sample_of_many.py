"""Tests of `assign.sample_of_many` against a list of all joint events."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_assign_k_best_of_many import K, N, draw, listed

from jaxtrack.assign import sample_of_many

INF, NUM = np.inf, 10


@functools.cache
def problems(ways):
    """Everybody can be missed, and the weights are such that all may be found."""
    log_score, log_weight = (x[:NUM] for x in draw(ways))
    log_score[..., K] = np.where(log_score[..., K] > -INF, log_score[..., K], -1.0)
    return log_score, log_weight


@functools.cache
def solve(ways, k, num_sweeps):
    def one(key, scores, weight):
        return sample_of_many.sample_of_many(key, scores, weight, k, num_sweeps, ways)

    keys = jax.random.split(jax.random.key(0), NUM)
    found = jax.jit(jax.vmap(one))(keys, *problems(ways))
    return jax.tree.map(np.asarray, found)


@functools.cache
def known(ways):
    return [listed(*one) for one in zip(*problems(ways), strict=True)]


@pytest.mark.parametrize("ways", [1, 2])
def test_pairs_have_their_weights_and_each_comes_once(ways):
    found = solve(ways, 400, 30)
    for run, all_of_them in enumerate(known(ways)):
        there = found.log_weight[run] > -INF
        columns = map(tuple, found.column[run, there].tolist())
        pairs = list(zip(found.problem[run, there].tolist(), columns, strict=True))
        assert len(set(pairs)) == len(pairs) > 3
        weights = found.log_weight[run, there]
        # Sums of scores of order 1, which may be 0.
        np.testing.assert_allclose(weights, [all_of_them[p] for p in pairs], atol=1e-12)
        assert (np.diff(weights) <= 0).all()
        assert not there[len(pairs) :].any()


@pytest.mark.parametrize("ways", [1, 2])
def test_long_walks_find_nearly_all(ways):
    found, missing = solve(ways, 400, 30), 0
    for run, all_of_them in enumerate(known(ways)):
        totals = np.array(sorted(all_of_them.values(), reverse=True))
        share = np.exp(found.log_weight[run]).sum() / np.exp(totals).sum()
        # Tracks that hold each other's detection hardly ever swap.
        assert 0.99 < share < 1 + 1e-9
        missing += share < 0.999
        np.testing.assert_allclose(found.log_weight[run, 0], totals[0])
    assert missing < NUM / 2


def test_what_was_not_found_is_bounded():
    found = solve(1, 4, 1)
    lost = 0
    for run, all_of_them in enumerate(known(1)):
        pairs = zip(found.problem[run], found.column[run].tolist(), strict=True)
        own = {(p, tuple(c)) for p, c in pairs}
        rest = [total for pair, total in all_of_them.items() if pair not in own]
        assert max(rest) <= found.log_lost[run] + 1e-5
        lost += found.log_left[run] > -INF
    assert lost > 0  # a problem had no chain


def test_gradient_is_that_of_the_chosen():
    log_score, log_weight = (jnp.asarray(x[0]) for x in problems(1))

    def second(scores, weight):
        key = jax.random.key(3)
        found = sample_of_many.sample_of_many(key, scores, weight, 6, 5)
        return found.log_weight[1], found

    slopes, found = jax.jit(jax.grad(second, (0, 1), has_aux=True))(
        log_score, log_weight
    )
    expected = np.zeros(log_score.shape)
    expected[int(found.problem[1]), np.arange(N), np.asarray(found.column[1])] = 1
    np.testing.assert_array_equal(slopes[0], expected)
    np.testing.assert_array_equal(slopes[1], np.arange(4) == found.problem[1])


def test_a_number_that_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="k is 3, num_sweeps is 0 and ways is 1; give"):
        sample_of_many.sample_of_many(
            jax.random.key(0), jnp.zeros((1, 1, 1)), jnp.zeros(1), 3, 0
        )
