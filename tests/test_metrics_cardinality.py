"""Tests of `jaxtrack.metrics.cardinality` against plain loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.metrics import cardinality


@pytest.fixture
def counts():
    """True and estimated numbers of 7 runs at 3 scans."""
    rng = np.random.default_rng(0)
    return rng.integers(0, 5, size=(7, 3)), rng.normal(3, 2, size=(7, 3))


def test_bias_and_spread_follow_the_definitions(counts):
    truth, estimated = counts
    for time in range(3):
        errors = [estimated[run, time] - truth[run, time] for run in range(7)]
        mean = sum(errors) / 7
        variance = sum((error - mean) ** 2 for error in errors) / 7
        power = sum(error**2 for error in errors) / 7
        for function, expected in [
            (cardinality.bias, mean),
            (cardinality.spread, variance**0.5),
            (cardinality.rmse, power**0.5),
        ]:
            result = jax.jit(function)(jnp.asarray(truth), jnp.asarray(estimated))
            assert result.shape == (3,)
            np.testing.assert_allclose(result[time], expected, rtol=1e-12)


def test_unsigned_and_whole_counts_go_below_zero():
    truth = jnp.array([[3], [3]], jnp.uint8)
    estimated = jnp.array([[1], [2]], jnp.uint8)
    assert cardinality.bias(truth, estimated) == -1.5


def test_one_run_has_no_spread():
    assert cardinality.spread(jnp.array([[3]]), jnp.array([[5]])) == 0


def test_bias_names_the_shape_it_wanted():
    with pytest.raises(AssertionError, match=r"\(3, 7\) but expected \(7, 3\)"):
        cardinality.bias(jnp.zeros((7, 3)), jnp.zeros((3, 7)))
