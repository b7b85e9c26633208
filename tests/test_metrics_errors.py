"""Errors of labelled tracks against loops over targets."""

from typing import NamedTuple

import jax
import numpy as np

from jaxtrack.metrics import errors
from jaxtrack.models import motion

MOTION = motion.ConstantVelocity(np.ones(2))


class Estimate(NamedTuple):
    """What the errors look at, with a leading T."""

    mean: np.ndarray
    label: np.ndarray
    exists: np.ndarray
    mode_prob: np.ndarray


def scene(seed=0, scans=30, num=3, slots=5):
    """Targets, and tracks in any order of which some are strangers or not reported."""
    rng = np.random.default_rng(seed)
    label = np.stack([rng.permutation(slots + 2)[:slots] for _ in range(scans)])
    return (
        rng.normal(size=(scans, num, 4)),
        rng.random((scans, num)) < 0.8,
        Estimate(
            mean=rng.normal(size=(scans, slots, 4)),
            label=label,
            exists=rng.random((scans, slots)) < 0.7,
            mode_prob=rng.random((scans, slots, 3)),
        ),
    )


def test_errors_are_those_of_the_track_with_the_target_for_label():
    state, there, estimates = scene()
    found = jax.jit(lambda *x: errors.errors(*x, MOTION))(state, there, estimates)
    num_tracked = 0
    for t, n in np.ndindex(there.shape):
        slots = [
            s
            for s in range(5)
            if estimates.exists[t, s] and estimates.label[t, s] == n and there[t, n]
        ]
        assert found.tracked[t, n] == bool(slots)
        want = np.zeros(2)
        if slots:
            gap = estimates.mean[t, slots[0]] - state[t, n]
            want = np.array([np.hypot(*gap[[0, 2]]), np.hypot(*gap[[1, 3]])])
            num_tracked += 1
        np.testing.assert_allclose(found.position[t, n], want[0])
        np.testing.assert_allclose(found.velocity[t, n], want[1])
    assert 0 < num_tracked < there.size


def test_values_are_picked_by_label():
    _, _, estimates = scene()
    pick = jax.jit(lambda e: errors.of_labels(e.mode_prob, e, 3))
    values, there = map(np.asarray, pick(estimates))
    for t, n in np.ndindex(there.shape):
        slots = (estimates.label[t] == n) & estimates.exists[t]
        assert there[t, n] == slots.any()
        want = estimates.mode_prob[t, slots][0] if slots.any() else np.zeros(3)
        np.testing.assert_array_equal(values[t, n], want)


def test_root_mean_square_counts_the_runs_that_have_a_track():
    values = np.array([[3.0, 5.0, 7.0], [4.0, 0.0, 9.0]])
    tracked = np.array([[True, True, False], [True, False, False]])
    rms = jax.jit(errors.rms)(values, tracked)
    np.testing.assert_allclose(rms, [np.sqrt(12.5), 5.0, 0.0])


def test_errors_and_their_gradients_are_finite_where_a_track_is_exact_or_missing():
    state, there, estimates = scene()

    @jax.jit
    @jax.grad
    def slope(mean):
        found = errors.errors(state, there, estimates._replace(mean=mean), MOTION)
        spread = errors.rms(found.position, found.tracked)
        return spread.sum() + found.velocity.sum()

    same = np.repeat(state[:, :1], 5, axis=1)
    for mean in (estimates.mean, same):
        assert np.isfinite(slope(mean)).all()
