"""Tests of `trackers.estimators` against lists of who is there."""

import itertools

import jax
import numpy as np
import pytest

from jaxtrack.trackers import estimators

H, N = 4, 3


def draw(seed):
    rng = np.random.default_rng(seed)
    prob, there = rng.dirichlet(np.ones(H)), rng.random((H, N))
    there[rng.random((H, N)) < 0.2] = 0.0
    there[rng.random((H, N)) < 0.2] = 1.0
    return prob, there


def listed(prob, there):
    """Every hypothesis with who is there: (row, who) and its probability."""
    for row, who in itertools.product(range(H), itertools.product((0, 1), repeat=N)):
        odds = np.where(who, there[row], 1 - there[row])
        yield row, np.array(who, bool), prob[row] * odds.prod()


choose = jax.jit(
    lambda prob, there: [
        estimators.choose(name, prob, there, 0.4) for name in estimators.NAMES
    ]
)


def test_estimators_choose_what_they_say():
    for seed in range(50):
        prob, there = draw(seed)
        heaviest, number, certain = choose(prob, there)
        row = prob.argmax()
        assert heaviest[0] == row
        np.testing.assert_array_equal(heaviest[1], there[row] > 0.4)
        every = list(listed(prob, there))
        best = max(every, key=lambda one: one[2])
        assert certain[0] == best[0]
        np.testing.assert_array_equal(certain[1], best[1])
        counts = np.zeros(N + 1)
        for _, who, weight in every:
            counts[who.sum()] += weight
        so_many = [one for one in every if one[1].sum() == counts.argmax()]
        best = max(so_many, key=lambda one: one[2])
        assert number[0] == best[0]
        np.testing.assert_array_equal(number[1], best[1])


def test_an_estimator_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="estimator is 'mean'; give one of heaviest"):
        estimators.check("mean")
