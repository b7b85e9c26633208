import chex
import jax
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from reference import kalman as book

from jaxtrack import kalman, kalman_parallel
from jaxtrack.kalman_parallel import Segment
from jaxtrack.types import Affine, Gaussian


def outcome(module, prior, motions, sensors, detections, detected):
    filtered = module.filter(prior, motions, sensors, detections, detected)
    return filtered, module.smooth(filtered, motions)


sequential = jax.jit(lambda *track: outcome(kalman, *track))
parallel = jax.jit(lambda *track: outcome(kalman_parallel, *track))


@pytest.mark.parametrize("seed", range(3))
def test_parallel_results_equal_sequential_ones(seed):
    track = book.random_track(seed, num_scans=5)
    expected = sequential(*track)
    chex.assert_trees_all_close(parallel(*track), expected, rtol=1e-9, atol=1e-8)


def test_parallel_results_equal_sequential_ones_without_any_detection():
    *track, _ = book.random_track(0, num_scans=5)
    track = (*track, np.zeros(5, bool))
    expected = sequential(*track)
    chex.assert_trees_all_close(parallel(*track), expected, rtol=1e-9, atol=1e-8)


def test_one_scan_is_enough():
    track = book.random_track(0, num_scans=1, num_axes=1)
    expected = sequential(*track)
    chex.assert_trees_all_close(parallel(*track), expected, rtol=1e-12)
    chex.assert_trees_all_equal(expected[1], expected[0].filtered)


def test_gradients_are_right_whatever_stands_in_a_missing_detection():
    prior, *models, detected = book.random_track(0, num_scans=3, num_axes=1)
    vector, unravel = ravel_pytree((prior, *models))

    @jax.jit
    @jax.value_and_grad
    def loss(vector):
        prior, motions, sensors, detections = unravel(vector)
        prior, motions, sensors = map(book.symmetric, (prior, motions, sensors))
        track = (prior, motions, sensors, detections, detected)
        filtered = kalman_parallel.filter(*track)
        return book.weighted_sum([filtered.log_density, *filtered.filtered])

    by_gradient, by_differences = book.slopes(loss, vector)
    np.testing.assert_allclose(by_gradient, by_differences, rtol=1e-6)

    models[1].matrix[1] = models[2][1] = np.nan  # the scan without detection
    spoiled = ravel_pytree((prior, *models))[0]
    chex.assert_trees_all_close(loss(spoiled), loss(vector))


def random_segment(rng, dim=3):
    ahead = Affine(
        rng.normal(size=(dim, dim)), rng.normal(size=dim), book.random_cov(rng, dim)
    )
    return Segment(ahead, rng.normal(size=dim), book.random_cov(rng, dim))


def test_segments_join_associatively_and_in_order():
    rng = np.random.default_rng(0)
    first, second, third = (random_segment(rng) for _ in range(3))
    join = jax.jit(kalman_parallel.join)
    left = join(join(first, second), third)
    right = join(first, join(second, third))
    chex.assert_trees_all_close(left, right, rtol=1e-9, atol=1e-9)
    assert not np.allclose(join(first, second).vector, join(second, first).vector)


def test_segment_of_a_scan_tells_what_an_update_from_a_known_state_tells():
    """Its information is the curvature of the detection's log-density in the state."""
    _, motions, sensors, detections, _ = book.random_track(0, num_scans=1)
    motion, sensor = jax.tree.map(lambda x: x[0], (motions, sensors))
    state = np.array([100.0, -20, 30, 4])

    @jax.jit
    def compare(state):
        def told(state):
            belief = Gaussian(motion.matrix @ state + motion.offset, motion.cov)
            after, log_density = kalman.update(belief, sensor, detections[0])
            return log_density, after

        segment = kalman_parallel.segment(motion, sensor, detections[0])
        (mean, offset, cov), vector, information = segment
        slope, after = jax.grad(told, has_aux=True)(state)
        theirs = (after.mean, after.cov, slope)
        return theirs, (mean @ state + offset, cov, vector - information @ state)

    theirs, ours = compare(state)
    chex.assert_trees_all_close(ours, theirs, rtol=1e-9, atol=1e-9)


def test_affine_maps_chain_in_order():
    rng = np.random.default_rng(1)
    first, second = random_segment(rng).ahead, random_segment(rng).ahead
    both = jax.jit(kalman_parallel.chain)(first, second)
    state = rng.normal(size=3)
    between = first.matrix @ state + first.offset
    expected = second.matrix @ between + second.offset
    np.testing.assert_allclose(both.matrix @ state + both.offset, expected)
    spread = second.matrix @ first.cov @ second.matrix.T + second.cov
    np.testing.assert_allclose(both.cov, spread)
