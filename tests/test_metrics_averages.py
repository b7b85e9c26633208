"""Tests of `jaxtrack.metrics.averages` against loops, and many repeated studies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.metrics import averages

total = jax.jit(averages.total)


@pytest.mark.parametrize("order", [1.0, 2.0, 3.0])
def test_total_is_the_jackknife_of_the_sum_of_roots(order):
    distance = np.random.default_rng(0).uniform(1, 5, (12, 7))

    def summed(runs):
        value = 0.0
        for t in range(7):
            value += (sum(x[t] ** order for x in runs) / len(runs)) ** (1 / order)
        return value

    without = [summed(np.delete(distance, r, axis=0)) for r in range(12)]
    found = total(jnp.asarray(distance) ** order, order)
    np.testing.assert_allclose(found.value, summed(distance), rtol=1e-12)
    error = np.sqrt(11 / 12 * sum((x - np.mean(without)) ** 2 for x in without))
    np.testing.assert_allclose(found.std_error, error, rtol=1e-10)


def test_standard_error_is_the_spread_of_repeated_studies():
    key = jax.random.key(0)
    # Errors of neighbouring times go together, as those of a track do.
    walks = jnp.cumsum(jax.random.normal(key, (2000, 50, 10)), axis=2)
    found = jax.jit(jax.vmap(averages.total))(walks**2)
    # The spread of 2000 studies is known to 1.6 %.
    np.testing.assert_allclose(
        np.sqrt((found.std_error**2).mean()), found.value.std(), rtol=0.06
    )


def test_a_single_run_and_no_error_at_all():
    assert total(jnp.full((1, 3), 4.0)) == (6, 0)
    zero = total(jnp.zeros((5, 3)))
    assert zero == (0, 0)
    slope = jax.grad(lambda x: averages.total(x).value)(jnp.zeros((5, 3)))
    assert jnp.isfinite(slope).all()


def test_root_mean_is_taken_over_runs():
    power = jnp.array([[9.0, 25.0], [16.0, 25.0]])
    np.testing.assert_allclose(averages.root_mean(power), (12.5**0.5, 5), rtol=1e-12)
