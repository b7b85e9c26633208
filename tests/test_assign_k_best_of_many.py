"""Tests of `assign.k_best_of_many` against a sorted list of all joint events."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import assign as reference

from jaxtrack.assign import k_best_of_many

INF = np.inf
H, N, K = 4, 3, 3
NUM = 40


def draw(ways=1):
    rng = np.random.default_rng(ways)
    shape = NUM, H
    drawn = [reference.scores(rng, N, K, gate) for gate in rng.random(NUM * H)]
    log_score = np.array(drawn).reshape(*shape, N, K + 1)
    log_score[..., -1][rng.random((*shape, N)) < 0.2] = -INF
    more = rng.normal(size=(*shape, N, ways - 1))
    log_weight = rng.normal(size=shape)
    log_weight[rng.random(shape) < 0.2] = -INF
    return np.concatenate([log_score, more], -1), log_weight


def solve(log_score, log_weight, k, width=None):
    ways = log_score.shape[-1] - K

    def one(scores, weight):
        return k_best_of_many.k_best_of_many(scores, weight, k, width, ways)

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(log_score, log_weight))


def listed(log_score, log_weight):
    """Every pair of a problem and an event, by their weights."""
    found = {}
    for problem, (scores, weight) in enumerate(zip(log_score, log_weight, strict=True)):
        for columns, total in events(scores):
            if weight > -INF:
                found[problem, columns] = weight + total
    return found


def events(scores):
    """All joint events: whoever is missed is missed in each of the ways."""
    ways = scores.shape[1] - K
    apart = np.full((N, K + N * ways), -INF)
    apart[:, :K] = scores[:, :K]
    for n in range(N):
        apart[n, K + n * ways : K + (n + 1) * ways] = scores[n, K:]
    none = np.full((N, 1), -INF)
    for columns, total in reference.events(np.concatenate([apart, none], 1)):
        yield tuple(c if c < K else K + (c - K) % ways for c in columns), total


@pytest.mark.parametrize("ways", [1, 2])
@pytest.mark.parametrize("k", [10, 1000])
def test_the_pairs_are_the_best_in_order_and_each_comes_once(k, ways):
    log_score, log_weight = draw(ways)
    found = solve(log_score, log_weight, k, 8 * k)
    for run in range(NUM):
        known = listed(log_score[run], log_weight[run])
        expected = sorted(known.values(), reverse=True)[:k]
        count = len(expected)
        totals = found.log_weight[run]
        # Sums of scores of order 1, which may be 0.
        np.testing.assert_allclose(totals[:count], expected, atol=1e-12)
        assert (totals[count:] == -INF).all()
        columns = map(tuple, found.column[run, :count].tolist())
        pairs = list(zip(found.problem[run, :count].tolist(), columns, strict=True))
        assert len(set(pairs)) == count
        # The same sums.
        np.testing.assert_allclose(
            totals[:count], [known[p] for p in pairs], atol=1e-12
        )
    if k == 1000:
        assert (found.log_lost == -INF).all()


def test_what_is_above_the_bound_is_right_however_few_are_kept():
    log_score, log_weight = draw()
    right = 0
    found = solve(log_score, log_weight, 4, width=4)
    for run in range(NUM):
        known = listed(log_score[run], log_weight[run])
        expected = sorted(known.values(), reverse=True)
        sure = int((found.log_weight[run] > found.log_lost[run] + 1e-5).sum())
        right += sure
        # Sums of scores of order 1, which may be 0.
        np.testing.assert_allclose(
            found.log_weight[run, :sure], expected[:sure], atol=1e-12
        )
        if len(expected) > 4:
            # All that is not in the list is below the bound.
            pairs = zip(found.problem[run], found.column[run].tolist(), strict=True)
            own = {(p, tuple(c)) for p, c in pairs}
            rest = [total for pair, total in known.items() if pair not in own]
            assert max(rest) <= found.log_lost[run] + 1e-5
    assert right > 2 * NUM


def test_gradient_is_that_of_the_chosen():
    log_score, log_weight = draw()
    log_score, log_weight = jnp.asarray(log_score[0]), jnp.asarray(log_weight[0])

    def second(scores, weight):
        return k_best_of_many.k_best_of_many(scores, weight, 3).log_weight[1]

    slopes = jax.jit(jax.grad(second, (0, 1)))(log_score, log_weight)
    found = k_best_of_many.k_best_of_many(log_score, log_weight, 3)
    expected = np.zeros(log_score.shape)
    problem = int(found.problem[1])
    expected[problem, np.arange(N), np.asarray(found.column[1])] = 1
    np.testing.assert_array_equal(slopes[0], expected)
    np.testing.assert_array_equal(slopes[1], np.arange(H) == problem)


def test_a_number_that_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="k is 0 and ways is 1; give at least 1"):
        k_best_of_many.k_best_of_many(jnp.zeros((1, 1, 1)), jnp.zeros(1), 0)
