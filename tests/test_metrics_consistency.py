"""Tests of `jaxtrack.metrics.consistency` on simulated errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxtrack.metrics import consistency

NUM_RUNS = 400


@pytest.fixture
def simulated():
    """Errors [R, D] and the covariance [D, D] that they were drawn with."""
    rng = np.random.default_rng(0)
    lower = np.tril(rng.normal(size=(4, 4))) + 3 * np.eye(4)
    errors = rng.normal(size=(NUM_RUNS, 4)) @ lower.T
    return jnp.asarray(errors), jnp.asarray(lower @ lower.T)


@pytest.mark.parametrize("function", [consistency.nees, consistency.nis])
def test_nees_and_nis_follow_the_definition(function, simulated):
    errors, cov = simulated
    expected = [error @ np.linalg.inv(cov) @ error for error in np.asarray(errors)]
    result = jax.jit(jax.vmap(function, (0, None)))(errors, cov)
    np.testing.assert_allclose(result, expected, rtol=1e-10)


def test_average_nees_is_inside_the_bounds_only_if_the_covariance_is_right(simulated):
    errors, cov = simulated
    low, high = consistency.chi2_bounds(4, NUM_RUNS)
    average = jax.jit(lambda e, c: jax.vmap(consistency.nees, (0, None))(e, c).mean())
    assert low < average(errors, cov) < high
    assert average(errors, cov / 1.2) > high
    assert average(errors, cov * 1.2) < low


def test_bounds_hold_the_probability_they_were_asked_for():
    rng = np.random.default_rng(1)
    averages = rng.chisquare(3, size=(20_000, 5)).mean(1)
    low, high = consistency.chi2_bounds(3, 5, prob=0.9)
    np.testing.assert_allclose((averages < low).mean(), 0.05, atol=0.006)
    np.testing.assert_allclose((averages > high).mean(), 0.05, atol=0.006)


def test_bounds_are_those_of_the_tables():
    # Chi-square with 100 degrees of freedom: 2.5 % at 74.22, 97.5 % at 129.56.
    bounds = consistency.chi2_bounds(2, 50)
    np.testing.assert_allclose(bounds, (74.22 / 50, 129.56 / 50), atol=1e-4)


def test_nees_has_correct_gradients(simulated):
    errors, cov = simulated
    check_grads(jax.jit(consistency.nees), (errors[0], cov), order=1, modes=["rev"])


def test_nees_names_the_shape_it_wanted():
    with pytest.raises(AssertionError, match=r"\(3, 3\) but expected \(2, 2\)"):
        consistency.nees(jnp.zeros(2), jnp.eye(3))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 5), "dim is 0; it must be at least 1"),
        ((2, 0), "num_runs is 0; it must be at least 1"),
        ((2, 5, 95), "prob is 95; it must be between 0 and 1"),
    ],
)
def test_bounds_reject_bad_settings(arguments, message):
    with pytest.raises(ValueError, match=message):
        consistency.chi2_bounds(*arguments)
