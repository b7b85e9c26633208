"""Whole scenes of the CBMeMBer filter with one Gaussian a track; its settings."""

import numpy as np
import pytest
from cases.lines import compiled, scans_of

from jaxtrack.models import birth, clutter, motion, probability, sensor
from jaxtrack.targets import single
from jaxtrack.trackers import cbmember

STRAIGHT = single.Params(
    motion=motion.ConstantVelocity(np.array([0.05])),
    sensor=sensor.Position(np.array([0.5])),
    survive=probability.Constant(np.array(0.99)),
    detect=probability.Constant(np.array(0.97)),
)
CLUTTER = clutter.UniformClutter(np.array(0.5), np.array([-60.0]), np.array([60.0]))


def test_labels_stay_with_crossing_targets_and_a_newborn_gets_a_new_one():
    rng = np.random.default_rng(0)
    times = np.arange(16)
    paths = np.stack([-22.0 + 3 * times, 23.0 - 3 * times], 1)
    rows = [list(rng.permutation(row + 0.3 * rng.normal(size=2))) for row in paths]
    for t in range(10, 16):
        rows[t].append(-22.0 + 3 * (t - 10) + 0.3 * rng.normal())
    births = birth.MultiBernoulliBirth(
        existence_prob=np.full(2, 0.05),
        mean=np.array([[-22.0, 0.0], [23.0, 0.0]]),
        cov=np.tile(np.diag([1.0, 16.0]), (2, 1, 1)),
        mode_prob=np.ones((2, 1)),
    )
    tracker = cbmember.cbmember(single.single(), max_tracks=8, max_parents=4)
    params = cbmember.Params(STRAIGHT, births, CLUTTER)
    estimates = compiled(tracker)(params, scans_of(rows, 3, 1.0))
    newborn = -22.0 + 3 * (times - 10)
    followed = [], [], []
    for t in range(2, 16):
        for path, labels in zip((*paths[t], newborn[t]), followed, strict=True):
            near = np.abs(estimates.mean[t, :, 0] - path) < 1.5
            crossing = np.abs(paths[t, 0] - paths[t, 1]) < 4
            found = estimates.label[t][estimates.exists[t] & near]
            if labels is not followed[2] or t >= 12:
                labels.extend([] if crossing else found)
    first, second, third = (set(labels) for labels in followed)
    assert len(first) == len(second) == len(third) == 1
    assert len(first | second | third) == 3
    assert min(map(len, followed)) >= 4
    assert (estimates.exists[4:9].sum(1) == 2).all()
    assert (estimates.exists[13:].sum(1) == 3).all()


def test_an_unexplained_detection_starts_a_track():
    births = birth.DetectionBirth(
        rate=np.array(0.1),
        max_existence_prob=np.array(0.2),
        velocity_std=np.array([3.0]),
        extra_std=np.zeros(0),
        mode_prob=np.ones(1),
    )
    tracker = cbmember.cbmember(single.single(), max_tracks=6, max_births=2)
    params = cbmember.Params(STRAIGHT, births, CLUTTER)
    rows = [[], [-5.0], [-3.0], [-1.0, 30.0], [1.0], [3.0, -40.0]]
    estimates = compiled(tracker)(params, scans_of(rows, 3, 1.0))
    assert not estimates.exists[:2].any()
    for t in (3, 4, 5):
        assert estimates.exists[t].sum() == 1
        assert abs(estimates.mean[t, 0, 0] - (2 * t - 7)) < 1
        assert estimates.label[t, 0] == estimates.label[3, 0]
    # The first detection is born with rate * interval, all of it unexplained, and
    # meets its second detection with what the first taught.
    r = 0.1 * 0.99
    spread = 0.25 + 9 + 0.05 / 3 + 0.25
    g = np.exp(-(2.0**2) / spread / 2) / np.sqrt(2 * np.pi * spread)
    odds = r * 0.97 * g / (1 - r * 0.97)
    share = odds / (odds + 0.5 / 120)
    expected = share * (1 - r) / (1 - r * 0.97)
    np.testing.assert_allclose(estimates.existence_prob[2, 0], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"max_tracks": 0}, "max_tracks is 0; give at least 1"),
        ({"max_births": 0}, "max_births is 0"),
        ({"max_parents": 0}, "max_parents is 0"),
        ({"max_updated": 0}, "max_updated is 0"),
        ({"prune_threshold": 1.0}, "prune_threshold is 1.0"),
        ({"report_threshold": -0.1}, "report_threshold is -0.1"),
    ],
)
def test_bad_settings_are_named(setting, words):
    with pytest.raises(ValueError, match=words):
        cbmember.cbmember(single.single(), **setting)
