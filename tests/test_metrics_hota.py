"""Tests of `jaxtrack.metrics.hota` against all matchings tried one by one."""

import numpy as np
import pytest
from reference import metrics as reference
from test_metrics_identity import frame, random_frames

from jaxtrack.metrics import hota


def scores(frames, cutoff=10.0):
    return hota.hota([frame(*each) for each in frames], cutoff)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("cutoff", [5.0, 12.0])
def test_scores_follow_the_definitions(seed, cutoff):
    frames = random_frames(seed, num_frames=40)
    result = scores(frames, cutoff)
    np.testing.assert_allclose(result[:3], reference.hota(frames, cutoff), rtol=1e-12)
    np.testing.assert_allclose(result.curve.mean(), result.hota, rtol=1e-12)
    assert (np.diff(result.curve) <= 1e-12).all()  # rounding


def test_perfect_tracks_score_one():
    frames = [({5: (k, 0), 9: (k, 50)}, {1: (k, 0), 2: (k, 50)}) for k in range(4)]
    assert scores(frames)[:4] == (1, 1, 1, 1)


def test_a_track_broken_in_two_costs_association_only():
    frames = [({1: (0, 0)}, {7 if k < 5 else 8: (0, 0)}) for k in range(10)]
    result = scores(frames)
    np.testing.assert_allclose(result[:4], (0.5**0.5, 1, 0.5, 1), rtol=1e-12)


def test_distance_costs_thresholds():
    # A similarity of 0.5, at which the pair counts still, is 10 of 19 thresholds.
    result = scores([({1: (0, 0)}, {7: (3, 4)})] * 3)
    np.testing.assert_allclose(result[:3], [10 / 19] * 3, rtol=1e-12)
    np.testing.assert_allclose(result.localisation, (10 * 0.5 + 9) / 19, rtol=1e-12)


def test_matches_that_fit_over_all_time_come_first():
    truth = {1: (0, 0)}
    frames = [(truth, {7: (0, 0)})] * 9 + [(truth, {7: (2, 0), 8: (1, 0)})]
    result = scores(frames)
    np.testing.assert_allclose(result.curve[0], (10 / 11) ** 0.5, rtol=1e-12)


def test_nothing_to_get_wrong_scores_one():
    assert scores([])[:4] == (1, 1, 1, 1)
    assert scores([({}, {})])[:4] == (1, 1, 1, 1)
    for frames in [({1: (0, 0)}, {})], [({}, {1: (0, 0)})]:
        assert scores(frames)[:3] == (0, 0, 0)
    assert scores([({1: (0, 0)}, {7: (np.nan, 0)})])[:3] == (0, 0, 0)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, float("nan"), float("inf")])
def test_a_bad_cutoff_is_rejected(cutoff):
    with pytest.raises(ValueError, match="cutoff is .*; it must be positive"):
        hota.hota([], cutoff)
