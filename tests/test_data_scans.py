"""Scans of recorded detections and their truth, against loops."""

import math

import numpy as np
import pytest

from jaxtrack.data import scans
from jaxtrack.data.errors import DataError


def group_by_the_book(time, xy, period, max_empty):
    """Fills window after window, one detection at a time."""
    windows, k = [], 0
    while k < len(time):
        end = time[0] + (len(windows) + 1) * period
        rows = []
        while k < len(time) and time[k] < end:
            rows.append(k)
            k += 1
        windows.append((end, rows))
    kept, run = [], 0
    for end, rows in windows:
        run = 0 if rows else run + 1
        if run <= max_empty:
            kept.append((end, rows, [(*xy[k], end - time[k]) for k in rows]))
    return kept


@pytest.mark.parametrize("max_empty", [0, 2, 100])
def test_windows_follow_the_clock(max_empty):
    rng = np.random.default_rng(3)
    time = np.sort(np.concatenate([rng.uniform(5, 20, 40), rng.uniform(60, 70, 9)]))
    xy = rng.normal(size=(49, 2))
    got = scans.group_scans(time, xy, 1.5, ages=True, max_empty=max_empty)
    expected = group_by_the_book(time, xy, 1.5, max_empty)
    np.testing.assert_allclose(got.time, [end for end, _, _ in expected])
    np.testing.assert_allclose(got.scan.interval[1:], np.diff(got.time))
    assert got.scan.interval[0] == 1.5
    assert got.scan.detections.shape[1] == max(len(rows) for _, rows, _ in expected)
    for t, (_, rows, values) in enumerate(expected):
        assert list(got.row[t][got.scan.valid[t]]) == rows
        assert not got.scan.detections[t][~got.scan.valid[t]].any()
        np.testing.assert_allclose(
            got.scan.detections[t, : len(rows)], np.reshape(values, (-1, 3))
        )


def test_equal_times_form_a_scan_of_irregular_intervals():
    got = scans.group_scans([3.0, 4.0, 4.0, 9.0, 9.0, 9.0, 11.0], np.ones((7, 2)))
    np.testing.assert_array_equal(got.time, [3.0, 4.0, 9.0, 11.0])
    np.testing.assert_array_equal(got.scan.interval, [2.0, 1.0, 5.0, 2.0])
    np.testing.assert_array_equal(got.scan.valid.sum(axis=1), [1, 2, 3, 1])
    np.testing.assert_array_equal(got.row[2], [3, 4, 5])
    assert got.scan.detections.dtype == np.float64


def test_times_on_the_edge_belong_to_the_window_they_begin():
    time = 0.1 * np.arange(1000)
    got = scans.group_scans(time, np.ones((1000, 2)), period=0.1, ages=True)
    assert got.scan.detections.shape == (1000, 1, 3)
    np.testing.assert_allclose(got.scan.detections[:, 0, 2], 0.1)


@pytest.mark.parametrize("period", [None, 60.0])
def test_one_detection_is_a_scan(period):
    got = scans.group_scans([7.0], [[1.0, 2.0]], period)
    assert got.scan.detections.shape == (1, 1, 2)
    assert got.scan.interval[0] == (period or 1.0)


def test_a_gap_of_ten_years_becomes_one_interval():
    decade = 3.2e8
    got = scans.group_scans([0.0, decade + 1.0], np.ones((2, 2)), 60.0, max_empty=3)
    assert list(got.scan.valid[:, 0]) == [True, False, False, False, True]
    np.testing.assert_allclose(got.scan.interval[:4], 60.0)
    assert got.scan.interval[4] == pytest.approx(decade - 180.0, abs=60.0)
    assert got.scan.interval[1:].sum() == pytest.approx(got.time[-1] - got.time[0])


def test_full_scans_keep_the_first_and_say_what_was_dropped():
    time = [0.0, 0.0, 0.0, 1.0, 2.0, 2.0]
    with pytest.warns(
        UserWarning, match=r"3 of 6 .* in 2 scans.* at 0 s, has 3; raise"
    ):
        got = scans.group_scans(time, np.arange(12.0).reshape(6, 2), max_detections=1)
    np.testing.assert_array_equal(got.dropped, [2, 0, 1])
    np.testing.assert_array_equal(got.row, [[0], [3], [4]])
    np.testing.assert_array_equal(got.scan.detections[1, 0], [6.0, 7.0])
    roomy = scans.group_scans(time, np.ones((6, 2)), max_detections=5)
    assert roomy.row.shape == (3, 5)
    assert not roomy.dropped.any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"period": 0.0}, "period is 0.0; give seconds above 0"),
        ({"period": math.nan}, "period is nan"),
        ({"max_detections": 0}, "max_detections is 0; give 1 or more"),
        ({"max_empty": -1}, "max_empty is -1"),
        ({"time": [1.0, 0.0]}, r"time\[1\] is 0.0, .*sort the detections"),
        ({"time": [1.0, math.nan]}, r"time\[1\] is nan"),
        ({"time": []}, "give at least one"),
        ({"time": [0.0]}, r"time has shape \(1,\) and xy \(2, 2\)"),
    ],
)
def test_wrong_scans_get_one_sentence(settings, message):
    time = settings.pop("time", [0.0, 1.0])
    with pytest.raises(ValueError, match=message):
        scans.group_scans(time, np.ones((2 if len(time) else 0, 2)), **settings)


def test_scans_beyond_memory_are_refused():
    time = np.concatenate([np.zeros(20_000), np.arange(1.0, 10_000.0)])
    with pytest.raises(DataError, match=r"10000 scans of 20000 slots do not fit"):
        scans.group_scans(time, np.ones((len(time), 2)))


@pytest.mark.parametrize("scan", [-1, 2])
def test_detections_of_no_scan_are_refused(scan):
    with pytest.raises(ValueError, match=f"scan_of has {scan}, but there are 2 scans"):
        scans.fill_scans([0, scan], np.ones((2, 1)), [0.0, 1.0])


def test_detections_out_of_order_fill_the_slots_of_their_scans():
    measured = np.arange(10.0).reshape(5, 2)
    got = scans.fill_scans([2, 0, 2, 0, 2], measured, [1.0, 4.0, 5.5], 0.25)
    assert got.row.tolist() == [[1, 3, -1], [-1, -1, -1], [0, 2, 4]]
    np.testing.assert_array_equal(got.scan.detections[2], measured[[0, 2, 4]])
    np.testing.assert_array_equal(got.scan.detections[0], [*measured[[1, 3]], [0, 0]])
    assert got.scan.interval.tolist() == [0.25, 3.0, 1.5]


# Truth.


def truth_by_the_book(time, xy, rows, at, max_gap):
    """Where one target is at one time, from its rows; None if it is nowhere."""
    for k in rows:
        if time[k] == at:
            return xy[k]
    before = [k for k in rows if time[k] < at]
    after = [k for k in rows if time[k] > at]
    if not before or not after:
        return None
    i, j = max(before, key=lambda k: time[k]), min(after, key=lambda k: time[k])
    if time[j] - time[i] > max_gap:
        return None
    share = (at - time[i]) / (time[j] - time[i])
    return xy[i] + share * (xy[j] - xy[i])


@pytest.mark.parametrize("max_gap", [0.0, 2.0, np.inf])
def test_truth_is_interpolated_between_reports(max_gap):
    rng = np.random.default_rng(5)
    time = rng.choice(np.arange(0.0, 20.0, 0.5), 36, replace=False)
    xy, who = rng.normal(size=(36, 2)), rng.choice(["b", "c", "", "a"], 36)
    at = np.arange(-1.0, 22.0, 0.25)
    ids, position, exists = scans.truth_at(time, xy, who, at, max_gap)
    assert list(ids) == ["a", "b", "c"]
    assert position.shape == (len(at), 3, 2)
    assert np.isfinite(position).all()
    for n, name in enumerate(ids):
        rows = np.flatnonzero(who == name)
        for t, moment in enumerate(at):
            place = truth_by_the_book(time, xy, rows, moment, max_gap)
            assert exists[t, n] == (place is not None)
            if place is not None:
                np.testing.assert_allclose(position[t, n], place, atol=1e-12)


def test_truth_takes_the_first_of_two_reports_at_one_time():
    ids, position, exists = scans.truth_at(
        [0.0, 1.0, 1.0, 2.0], [[0, 0], [1, 5], [9, 9], [2, 6]], [7, 7, 7, 7], [1.0, 1.5]
    )
    assert list(ids) == ["7"]
    assert exists.all()
    np.testing.assert_allclose(position[:, 0], [[1.0, 5.0], [1.5, 5.5]])
