"""Intervals of learned numbers, against those of the free numbers."""

import functools
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax
import pytest
from cases import learning
from cases.learning import start, watched, watcher
from scipy import special

from jaxtrack import learn
from jaxtrack.constraints import Constraint, Probability
from jaxtrack.learn import intervals
from jaxtrack.types import Array, Scan, Tracker

NEWTON = optax.lbfgs()


def both(p):
    return p.std, p.mean


@functools.cache
def fit():
    return learn.fit(watcher, start(), watched(), NEWTON, where=both, num_steps=40)


def test_a_fit_tells_intervals_of_its_free_numbers():
    found, known = fit().params, fit().information
    std = np.sqrt(np.diag(known.cov))
    assert known.names == ["mean", "std"]
    expected = np.exp(np.log(found.std) + std[1] * np.array([-2, 2]))
    np.testing.assert_allclose(known.interval["std"], expected, rtol=1e-6)
    mean = found.mean + 2 * known.std_error["mean"] * np.array([-1, 1])
    np.testing.assert_allclose(known.interval["mean"], mean, rtol=1e-12)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """Of the deviation of 5 normal numbers, whose estimate is far from normal."""
    rng = np.random.default_rng(0)
    z = rng.normal(size=(4000, 5)) * 2
    std = np.sqrt((z**2).mean(1))
    error = std / np.sqrt(2 * 5)
    low, high = intervals.interval("positive", std, error).T
    inside = ((low < 2) & (high > 2)).mean()
    plain = (np.abs(std - 2) < 2 * error).mean()
    # Both of 4,000, with standard deviations of 0.005 and 0.004.
    assert plain < 0.87
    assert 0.91 < inside < 0.96


@pytest.mark.parametrize("kind", ["probability", "below", "simplex", "jumps"])
def test_probabilities_are_taken_by_their_odds(kind):
    value, error = np.array([[0.2, 0.8], [0.999, 0.001]]), 0.05
    found = intervals.interval(kind, value, np.full((2, 2), error))
    slope = 1 / value + 1 / (1 - value)
    for side, sign in enumerate((-2, 2)):
        expected = special.expit(special.logit(value) + sign * error * slope)
        np.testing.assert_allclose(found[..., side], expected, rtol=1e-10)
    assert ((found >= 0) & (found <= 1)).all()


def test_probabilities_stay_within_their_bounds():
    found = intervals.interval("below", 0.4, 0.1, low=0.1, high=0.5)
    odds = np.log(3.0) + np.array([-2, 2]) * 0.1 / 0.4 / (0.75 * 0.25)
    expected = 0.1 + 0.4 * special.expit(odds)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert found[1] < 0.5
    rounded = intervals.interval("below", [0.5, 0.1], [0.1, 0.1], low=0.1, high=0.5)
    np.testing.assert_allclose(rounded, [[0.3, 0.5], [0.1, 0.3]], rtol=1e-12)


class Ordered(NamedTuple):
    t1: Annotated[Array, Constraint("below", "t2")]
    t2: Probability


def test_a_fit_tells_thresholds_between_those_they_are_ordered_by():
    """Of shares of numbers below each; t1 is near to t2, and little is known."""

    def step(params, state, scan):
        share = jnp.stack([params.t1, params.t2 - params.t1, 1 - params.t2])
        told = (scan.detections[0] * jnp.log(share)).sum()
        return state, learning.Told(told, share[None], jnp.ones(1))

    seen = np.repeat(np.eye(3), (9, 1, 2), axis=0)[:, None]
    scans = Scan(seen, np.ones((12, 1), bool), np.ones(12))
    counter = Tracker(lambda params, key: jnp.zeros(()), step)
    first = Ordered(np.array(0.5), np.array(0.6))
    fit = learn.fit(counter, first, scans, NEWTON, num_steps=40)
    np.testing.assert_allclose(fit.params.t1, 9 / 12, rtol=1e-4)
    np.testing.assert_allclose(fit.params.t2, 10 / 12, rtol=1e-4)
    low, high = fit.information.interval["t1"]
    assert 0 < low < 9 / 12 < high < fit.params.t2
    low, high = fit.information.interval["t2"]
    assert 0 < low < 10 / 12 < high < 1


def test_of_a_covariance_the_variances_are_positive():
    cov = np.array([[4.0, -1.0], [-1.0, 2.0]])
    found = intervals.interval("covariance", cov, np.ones((2, 2)))
    np.testing.assert_allclose(found[0, 0], 4 * np.exp([-0.5, 0.5]))
    np.testing.assert_allclose(found[0, 1], [-3.0, 1.0])
    np.testing.assert_allclose(found[1, 1], 2 * np.exp([-1.0, 1.0]))


@pytest.mark.parametrize(
    ("kind", "value", "error", "expected"),
    [
        ("positive", 2.0, np.inf, (0.0, np.inf)),
        ("positive", 2.0, 0.0, (2.0, 2.0)),
        ("positive", 0.0, 0.0, (0.0, 0.0)),
        ("positive", 2.0, np.nan, (np.nan, np.nan)),
        ("positive", 0.0, 1e-9, (0.0, np.inf)),
        ("probability", 0.3, np.inf, (0.0, 1.0)),
        ("probability", 1.0, 0.0, (1.0, 1.0)),
        ("real", -1.0, np.inf, (-np.inf, np.inf)),
        ("real", -1.0, 0.25, (-1.5, -0.5)),
    ],
)
def test_what_is_not_known_or_does_not_move(kind, value, error, expected):
    found = intervals.interval(kind, np.array(value), np.array(error))
    np.testing.assert_array_equal(found, expected)
