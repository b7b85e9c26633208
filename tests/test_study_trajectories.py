"""Tests of the scores of whole runs."""

import types

import jax.numpy as jnp
import numpy as np

from jaxtrack.scenarios import xia2019, xia2019_coalescing, xia2019_spread
from jaxtrack.study import trajectories as study
from jaxtrack.trackers import trajectories


def test_estimates_with_one_label_are_one_trajectory():
    """Whatever slot they are in, and with gaps where none is reported."""
    told = types.SimpleNamespace(
        mean=jnp.arange(6.0).reshape(3, 2, 1),
        cov=jnp.ones((3, 2, 1, 1)),
        exists=jnp.array([[True, True], [True, False], [True, True]]),
        label=jnp.array([[4, 7], [4, 7], [7, 4]]),
    )
    found = trajectories.assemble(study.known(told), max_trajectories=3)
    assert found.label.tolist() == [4, 7, -1]
    assert found.alive.T.tolist()[:2] == [[True, True, True], [True, False, True]]
    np.testing.assert_array_equal(found.mean[:, 0, 0], [0.0, 2.0, 5.0])
    np.testing.assert_array_equal(found.mean[:, 1, 0], [1.0, 0.0, 4.0])
    early = trajectories.assemble(study.known(told), 3, now=1)
    assert early.alive.sum(0).tolist() == [2, 1, 0]


def test_targets_of_xia_are_born_and_die_on_time():
    for truth in (xia2019_spread.truth(1), xia2019_coalescing.truth()):
        there = np.asarray(truth.exists)
        ends = sorted((np.flatnonzero(x)[[0, -1]] + 1).tolist() for x in there.T)
        assert ends == [list(x) for x in zip(xia2019.BORN, xia2019.DIED, strict=True)]


def test_spread_targets_of_xia_never_meet():
    truth = xia2019_spread.truth(3)
    where, there = np.asarray(truth.state)[..., [0, 2]], np.asarray(truth.exists)
    gap = np.linalg.norm(where[:, :, None] - where[:, None], axis=-1)
    both = there[:, :, None] & there[:, None] & ~np.eye(12, dtype=bool)
    assert gap[both].min() >= xia2019_spread.APART
    starts = [where[np.argmax(x), n] for n, x in enumerate(there.T)]
    corner = {tuple(np.sign(x)) for x in starts[:3]}
    assert (np.abs(np.abs(starts) - 50) < 8).all()  # four standard deviations
    assert len(corner) == 3


def test_paths_of_xia_move_as_the_filters_believe():
    """What is left after a second's motion has the covariance of the noise."""
    rng = np.random.default_rng(1)
    path = xia2019.walk(np.zeros((500, 4)), 20, rng)
    left = (path[1:] - path[:-1] @ xia2019.STEP.T).reshape(-1, 4)
    # Covariances of 9500 draws are known to some two per cent of the largest.
    np.testing.assert_allclose(np.cov(left.T), xia2019.NOISE, atol=5e-4)
    state = np.asarray(xia2019_coalescing.truth().state)
    left = (state[1:] - state[:-1] @ xia2019.STEP.T).reshape(-1, 4)
    assert np.abs(np.cov(left.T) - xia2019.NOISE).max() < 2.5e-3
