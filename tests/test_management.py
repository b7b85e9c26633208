"""The rules of track management, each story told in plain Python."""

import math

import jax
import numpy as np
import pytest

from jaxtrack.trackers import management
from jaxtrack.trackers.management import Existence, MofN, ScoreTest
from jaxtrack.types import Gaussian


def told(rule, detected, log_ratio=None, existence_prob=None, num_hits=1):
    """After how many scans a track is confirmed and dropped; None is never."""
    detected = np.array(detected, float)
    ratios = np.ones(len(detected)) if log_ratio is None else np.array(log_ratio)
    probs = np.full(len(detected), 0.5) if existence_prob is None else existence_prob

    @jax.jit
    def scan(record, hit, ratio, prob):
        record = management.record(record, hit[None], ratio[None])
        confirmed = record.confirmed | rule.confirms(record, prob[None])
        record = record._replace(confirmed=confirmed)
        return record, confirmed[0], rule.drops(record, prob[None])[0]

    record = management.begin(np.array([0.1]), num_hits)
    confirmed, dropped = None, None
    for i, story in enumerate(zip(detected, ratios, np.array(probs), strict=True), 1):
        record, is_confirmed, is_dropped = scan(record, *story)
        if is_confirmed and confirmed is None:
            confirmed = i
        if is_dropped and dropped is None:
            dropped = i
    return confirmed, dropped


@pytest.mark.parametrize(
    ("detected", "expected"),
    [
        ([1, 1, 1], (2, None)),  # with the first detection, three
        ([0, 1, 0, 1], (4, None)),  # three of five
        ([0, 1, 0, 0], (None, 4)),  # two of five, and no more to come
        ([0, 0, 0], (None, 3)),  # four scans are gone, and three hits out of reach
        ([1, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1], (2, 11)),  # five misses in a row
        ([0.4, 0.6, 0.6], (3, None)),  # detected if likelier than not
    ],
)
def test_m_of_n_counts(detected, expected):
    rule = MofN(confirm_hits=3, confirm_scans=5, drop_misses=5, drop_scans=5)
    assert told(rule, detected) == expected


def test_m_of_n_by_counting_in_python():
    """Random stories against lists of hits."""
    rule = MofN(confirm_hits=2, confirm_scans=4, drop_misses=3, drop_scans=6)
    rng = np.random.default_rng(0)
    for story in rng.random((60, 12)) < 0.45:
        hits, confirmed, dropped = [True], None, None
        for i, hit in enumerate(story, 1):
            hits.append(hit)
            if confirmed is None and sum(hits[-4:]) >= 2:
                confirmed = i
            if confirmed is None:
                gone = sum(hits[-4:]) + max(4 - len(hits), 0) < 2
            else:
                gone = len(hits[-6:]) - sum(hits[-6:]) >= 3
            if gone and dropped is None:
                dropped = i
        assert told(rule, story) == (confirmed, dropped)


def test_a_detection_that_says_nothing_is_no_hit():
    rule = MofN(confirm_hits=2, confirm_scans=3)
    assert told(rule, [1, 1, 1], [-0.1, 0.0, 0.1]) == (None, 2)
    assert told(rule, [1, 1, 1], [-0.1, 0.1, 0.1]) == (2, None)


def test_two_points_count_two():
    assert told(MofN(3, 5), [1], num_hits=2) == (1, None)


def test_score_test_is_wald():
    rule = ScoreTest(false_confirm_prob=0.01, false_drop_prob=0.05, drop_fall=4.0)
    high, low = math.log(0.95 / 0.01), math.log(0.05 / 0.99)
    third = high / 3
    assert told(rule, [1] * 4, [third] * 4) == (3, None)
    assert told(rule, [1] * 4, [0.99 * third] * 4) == (4, None)
    assert told(rule, [0] * 3, [0.6 * low] * 3) == (None, 2)
    # Once confirmed it goes by how far it has fallen, not by the low threshold.
    assert told(rule, [1] * 6, [high + 1, 3, -1, -2, -0.9, -0.2]) == (1, 6)


def test_existence_by_threshold():
    rule = Existence(confirm_prob=0.8, drop_prob=0.1)
    story = np.array([0.5, 0.81, 0.5, 0.2, 0.09])
    assert told(rule, [1] * 5, existence_prob=story) == (2, 5)


def test_wald_keeps_its_promise():
    """Tracks of clutter and of targets, by the sequential test on Gaussian scores."""
    rule = ScoreTest(false_confirm_prob=0.02, false_drop_prob=0.05, drop_fall=1e9)
    rng = np.random.default_rng(1)
    mean, num, length = 0.7, 4000, 80
    # Log-likelihood ratios of N(mean, 1) against N(0, 1).
    for shift, limit in ((0.0, rule.false_confirm_prob), (mean, rule.false_drop_prob)):
        x = rng.normal(size=(length, num)) + shift
        ratio = mean * x - mean**2 / 2

        def scan(carry, log_ratio):
            record, decided = carry
            record = management.record(record, np.ones(num), log_ratio)
            yes = rule.confirms(record, np.ones(num))
            no = rule.drops(record, np.ones(num))
            verdict = jax.numpy.where(yes, 1, jax.numpy.where(no, -1, 0))
            decided = jax.numpy.where(decided == 0, verdict, decided)
            return (record, decided), None

        start = management.begin(np.full(num, 0.1), 1), np.zeros(num, int)
        (_, decided), _ = jax.jit(lambda x, s=start, f=scan: jax.lax.scan(f, s, x))(
            ratio
        )
        wrong = (np.array(decided) == (1 if shift == 0 else -1)).mean()
        assert (np.array(decided) != 0).mean() > 0.99
        # Wald's bound, and three standard errors of the count.
        assert wrong <= limit * 1.05 + 3 * math.sqrt(limit / num)


def test_duplicates_give_way_to_who_ranks_higher():
    mean = np.array([[0.0, 0.0], [1.0, 0.0], [1.5, 0.0], [50.0, 0.0], [0.0, 0.0]])
    cov = np.tile(np.diag([1.0, 4.0]), (5, 1, 1))
    rank = np.array([0.5, 1.9, 0.7, 0.2, 0.0])
    find = jax.jit(lambda r: management.duplicates(Gaussian(mean, cov), r, 0.6))
    # 0.5 between the first two, 0.125 between the next; the last slot is empty.
    np.testing.assert_array_equal(find(rank), [True, False, True, False, False])
    equal = find(np.full(5, 0.5))
    np.testing.assert_array_equal(equal, [False, True, True, False, True])


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (MofN(4, 3), "confirm takes 4 of 3 scans"),
        (MofN(2, 3, 40, 40), "drop takes 40 of 40 scans"),
        (MofN(2.5, 3), "confirm takes 2.5 of 3 scans"),
        (ScoreTest(false_confirm_prob=1.5), "false_confirm_prob is 1.5"),
        (ScoreTest(false_drop_prob=0.0), "false_drop_prob is 0.0"),
        (ScoreTest(drop_fall=-1.0), "drop_fall is -1.0"),
        (ScoreTest(0.5, 0.9), "are 0.5 and 0.9; give two that add up to less"),
        (Existence(drop_prob=-0.1), "drop_prob is -0.1"),
        (Existence(0.1, 0.5), "drop_prob is 0.5 and confirm_prob is 0.1"),
    ],
)
def test_rules_that_make_no_sense(rule, message):
    with pytest.raises(ValueError, match=message):
        management.check(rule)
