"""Tests of `jaxtrack.metrics.assignment`; its solver has tests of its own."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.metrics import assignment

match = jax.jit(assignment.match)


def test_distances_are_euclidean_and_smooth_at_zero():
    left = jnp.array([[0.0, 0.0], [3.0, 4.0]])
    right = jnp.array([[0.0, 0.0], [0.0, 8.0], [3.0, 3.0]])
    expected = jnp.array([[0.0, 8.0, 18**0.5], [5.0, 5.0, 1.0]])
    chex.assert_trees_all_close(assignment.distances(left, right), expected)

    slope = jax.grad(lambda x: assignment.distances(x, right)[0, 0])(left)
    chex.assert_trees_all_equal(slope, jnp.zeros((2, 2)))


def test_match_prefers_two_fair_pairs_to_a_good_one():
    truth = jnp.array([[0.0], [4.0], [50.0]])
    estimate = jnp.array([[50.0], [3.0], [70.0], [11.0], [0.0]])
    exists = jnp.array([True, True, True, True, False])
    found = match(truth, jnp.ones(3, bool), estimate, exists, 10.0, 1.0)
    np.testing.assert_array_equal(found.distance, [3.0, 7.0, 0.0])  # not 10, 1, 0
    np.testing.assert_array_equal(found.close, [True, True, True])
    assert (found.num_truth, found.num_estimate) == (3, 4)

    found = match(truth, jnp.arange(3) < 2, estimate, ~exists, 10.0, 1.0)
    np.testing.assert_array_equal(found.distance, [0.0, 10.0, 10.0])
    np.testing.assert_array_equal(found.close, [True, False, False])
    assert (found.num_truth, found.num_estimate) == (2, 1)


@pytest.mark.parametrize(
    ("cutoff", "order", "message"),
    [
        (0.0, 2.0, "cutoff is 0.0; it must be positive"),
        (float("inf"), 2.0, "cutoff is inf"),
        (10.0, 0.5, "order is 0.5; it must be at least 1"),
        (10.0, float("inf"), "order is inf"),
    ],
)
def test_match_rejects_settings_that_make_no_metric(cutoff, order, message):
    empty = jnp.zeros((0, 2)), jnp.zeros(0, bool)
    with pytest.raises(ValueError, match=message):
        assignment.match(*empty, *empty, cutoff, order)
