"""Tests of `jaxtrack.metrics.identity` against all pairings tried one by one."""

import numpy as np
import pytest
from reference import metrics as reference

from jaxtrack.metrics import identity


def frame(truth, track):
    """A frame from dictionaries of identity to position."""
    spots = [np.array(list(each.values()), float) for each in (truth, track)]
    return identity.Frame(
        np.array(list(truth)), spots[0], np.array(list(track)), spots[1]
    )


def scores(frames, max_distance=10.0):
    return identity.id_scores([frame(*each) for each in frames], max_distance)


def random_frames(seed, num_frames=60):
    """Three targets that walk about in a small room; four labels come and go."""
    rng = np.random.default_rng(seed)
    where = rng.uniform(0, 20, size=(3, 2))
    frames = []
    for _ in range(num_frames):
        where = where + rng.normal(0, 3, size=(3, 2))
        truth = {f"ship {i}": where[i] for i in range(3) if rng.random() < 0.8}
        labels = rng.permutation(4)[: rng.integers(0, 5)]
        spots = [where[rng.integers(3)] + rng.normal(0, 3, 2) for _ in labels]
        frames.append((truth, dict(zip(labels.tolist(), spots, strict=True))))
    return frames


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("max_distance", [3.0, 8.0])
def test_scores_follow_the_definitions(seed, max_distance):
    frames = random_frames(seed)
    result = scores(frames, max_distance)
    num_truths = sum(len(truth) for truth, _ in frames)
    num_reports = sum(len(track) for _, track in frames)
    num_switches, num_matched, far = reference.switches(frames, max_distance)

    expected = reference.idf1(frames, max_distance)
    np.testing.assert_allclose(result[:3], expected, rtol=1e-12)
    assert result.num_switches == num_switches
    assert result.num_matched == num_matched
    assert result.num_missed == num_truths - num_matched
    assert result.num_false == num_reports - num_matched
    assert result.num_truths == num_truths
    wrong = (num_truths - num_matched) + (num_reports - num_matched) + num_switches
    np.testing.assert_allclose(result.mota, 1 - wrong / num_truths, rtol=1e-12)
    np.testing.assert_allclose(result.motp, np.mean(far), rtol=1e-12)


def test_perfect_tracks_score_one():
    frames = [({5: (k, 0), 9: (k, 50)}, {1: (k, 0), 2: (k, 50)}) for k in range(4)]
    assert scores(frames) == (1.0, 1.0, 1.0, 0, 8, 0, 0, 8, 1.0, 0.0)


def test_two_labels_that_change_places_are_two_switches():
    here, there = (0, 0), (50, 0)
    truth = {1: here, 2: there}
    frames = [(truth, {7: here, 8: there})] * 3 + [(truth, {7: there, 8: here})]
    result = scores(frames)
    assert result.num_switches == 2
    assert result.idf1 == 0.75


def test_a_target_keeps_its_label_while_another_is_nearer():
    frames = [({1: (0, 0)}, {7: (1, 0)}), ({1: (0, 0)}, {8: (0, 0), 7: (9, 0)})]
    assert scores(frames).num_switches == 0
    assert scores(frames, max_distance=5.0).num_switches == 1


def test_a_label_is_remembered_over_a_gap():
    here = (0, 0)
    seen, gap = ({1: here}, {7: here}), ({1: here}, {})
    assert scores([seen, gap, ({}, {}), seen]).num_switches == 0
    assert scores([seen, gap, ({1: here}, {8: here})]).num_switches == 1


def test_of_two_targets_with_the_same_label_the_later_keeps_it():
    both = {1: (0, 0), 2: (2, 0)}
    first, second = ({1: (0, 0)}, {7: (0, 0)}), ({2: (2, 0)}, {7: (2, 0)})
    together = both, {7: (1, 0), 8: (1, 0)}
    # The earlier one goes on to label 8; what follows shows which it was.
    assert scores([first, second, together, second]).num_switches == 1
    assert scores([second, first, together, first]).num_switches == 1
    assert scores([first, second, together, first]).num_switches == 2


def test_the_distance_itself_is_near_enough():
    frames = [({1: (0, 0)}, {7: (6, 8)})]
    assert scores(frames, 10.0).num_matched == 1
    assert scores(frames, 9.99).num_matched == 0


def test_more_matches_go_before_shorter_ones():
    # The nearest pair (2, 8) would leave target 1 and label 7 alone.
    frames = [({1: (0,), 2: (9,)}, {7: (18,), 8: (9.5,)})]
    assert scores(frames, 10.0).num_matched == 2


def test_the_order_within_a_frame_changes_nothing():
    frames = random_frames(3)
    turned = [
        (dict(reversed(truth.items())), dict(reversed(track.items())))
        for truth, track in frames
    ]
    assert scores(turned) == scores(frames)


def test_nothing_to_get_wrong_scores_one():
    assert scores([])[:4] == (1.0, 1.0, 1.0, 0)
    assert scores([({}, {})])[:4] == (1.0, 1.0, 1.0, 0)
    assert scores([({1: (0, 0)}, {})])[:3] == (0.0, 1.0, 0.0)
    assert scores([({}, {1: (0, 0)})])[:3] == (0.0, 0.0, 1.0)
    assert scores([({}, {})])[-2:] == (1.0, 0.0)
    assert scores([({}, {1: (0, 0)})])[-2:] == (0.0, 0.0)


def test_a_position_that_is_not_finite_is_near_nothing():
    result = scores([({1: (0, 0)}, {7: (np.nan, 0)})])
    assert (result.num_matched, result.idf1) == (0, 0.0)


def test_hundreds_of_targets_and_a_thousand_labels_are_scored():
    rng = np.random.default_rng(0)
    where = rng.uniform(0, 1e4, size=(300, 2))
    ids = np.arange(300)
    frames = []
    for k in range(100):
        where = where + rng.normal(0, 20, size=(300, 2))
        clutter = rng.uniform(0, 1e4, size=(100, 2))
        reports = np.concatenate([where, clutter])
        names = np.append(
            ids if k < 50 else ids + 300, 600 + np.arange(100) * 4 + k % 4
        )
        frames.append(identity.Frame(ids, where, names, reports))
    result = identity.id_scores(frames, max_distance=1e-3)
    assert result.num_switches == 300
    assert result.num_matched == 30_000
    assert result.idf1 == 2 * 15_000 / 70_000


@pytest.mark.parametrize("max_distance", [0.0, -1.0, float("nan"), float("inf")])
def test_a_bad_distance_is_rejected(max_distance):
    with pytest.raises(ValueError, match="max_distance is .*; it must be positive"):
        identity.id_scores([], max_distance)


def test_bad_frames_are_rejected():
    one, two = np.zeros((1, 2)), np.zeros((2, 2))
    a, aa = np.array([4]), np.array([4, 4])
    good = identity.Frame(a, one, a, one)
    with pytest.raises(ValueError, match="true_id of frame 1 has an identity twice"):
        identity.id_scores([good, identity.Frame(aa, two, a, one)], 1.0)
    with pytest.raises(ValueError, match="label of frame 0 has an identity twice"):
        identity.id_scores([identity.Frame(a, one, aa, two)], 1.0)
    with pytest.raises(ValueError, match="1 identities and 2 positions"):
        identity.id_scores([identity.Frame(a, one, a, two)], 1.0)
