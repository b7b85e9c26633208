"""Tests of `trackers.trajectories`: which report of a scan is the last one."""

import jax
import numpy as np
import pytest

from jaxtrack.trackers import trajectories

SCANS, SIZE = 6, 3


def reported():
    """Of two tracks; a mean says of which scan it is, and in which it was reported."""
    told = np.arange(SCANS)[:, None, None]
    scan = told - (SIZE - 1) + np.arange(SIZE)[None, None]
    shape = (SCANS, 2, SIZE)
    mean = np.stack(np.broadcast_arrays(10.0 * scan, told, np.zeros(shape)), -1)
    alive = np.broadcast_to(scan >= 0, shape) & (np.arange(2) < 2)[None, :, None]
    return trajectories.Paths(
        mean=mean[..., :2],
        cov=np.tile(np.eye(2), (*shape, 1, 1)),
        filtered=mean[..., :2],
        alive_prob=np.full(shape, 0.75),
        alive=alive,
        label=np.tile([4, 7], (SCANS, 1)),
    )


@pytest.mark.parametrize("now", [None, 5, 9, 3, 0])
def test_each_scan_is_as_it_was_last_reported(now):
    told = jax.jit(trajectories.latest, static_argnums=1)(reported(), now)
    last = min(5 if now is None else now, 5)
    for scan in range(SCANS):
        there = scan <= last
        assert told.exists[scan].all() == told.exists[scan].any() == there
        np.testing.assert_array_equal(told.label[scan], [4, 7] if there else [-1, -1])
        np.testing.assert_array_equal(told.existence_prob[scan], 0.75 * there)
        if there:
            expected = [10.0 * scan, min(scan + SIZE - 1, last)]
            np.testing.assert_array_equal(told.mean[scan], [expected, expected])


@pytest.mark.parametrize(
    ("now", "label", "prob"), [(5, 7, 0.9), (4, -1, 0.0), (2, 4, 0.6)]
)
def test_of_alive_trajectories_each_scan_is_told_of_those_that_are_there(
    now, label, prob
):
    """Track 4 is not there any more from scan 3 on, and 7 only in the last one."""
    plain, scan = reported(), np.arange(SCANS)[:, None]
    there = np.stack([scan < 3, scan == 5], 1)
    likely = np.stack([0.2 * scan * (scan < 4) + 0.2, 0.1 * scan + 0.4], 1)
    begun = plain.alive
    paths = plain._replace(
        begun=begun, alive=begun & there, alive_prob=np.where(begun, likely, 0.0)
    )
    told = jax.jit(trajectories.latest, static_argnums=1)(paths, now)
    track = {4: 0, 7: 1, -1: 0}[label]
    for then in range(SCANS):
        here = then <= now and label >= 0
        assert told.exists[then].sum() == told.exists[then, track] == here
        assert told.label[then].tolist().count(label) == (
            1 if here else 2 * (label < 0)
        )
        np.testing.assert_allclose(told.existence_prob[then, track], prob * here)
        if here:
            expected = [10.0 * then, min(then + SIZE - 1, now)]
            np.testing.assert_array_equal(told.mean[then, track], expected)


def test_births_are_told_of_each_trajectory():
    prob = np.array([[0.5, 0.3, 0.2], [0.9, 0.1, 0.0]])
    paths = reported()._replace(birth_prob=np.tile(prob, (SCANS, 1, 1)))
    paths.birth_prob[:2], paths.label[:2] = 0.7, -1  # they began later
    told = jax.jit(trajectories.assemble, static_argnums=1)(paths, 3)
    assert told.label.tolist() == [4, 7, -1]
    np.testing.assert_array_equal(told.birth_prob, [*prob, np.zeros(3)])
    assert trajectories.assemble(reported(), 3).birth_prob is None
