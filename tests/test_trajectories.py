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
