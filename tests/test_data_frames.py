"""Detections and truth in pandas tables, against loops and round trips."""

import math

import numpy as np
import pandas
import pytest

from jaxtrack.data import clock, frames, rows, scans, tables
from jaxtrack.data.errors import DataError
from jaxtrack.scenarios.world import Truth

START = "2020-06-30T23:59:58.500"


def some_scans():
    """Irregular; two detections at one time, then nothing, then one, then three."""
    return scans.fill_scans(
        [0, 0, 2, 3, 3, 3],
        np.arange(12.0).reshape(6, 2) / 7.0,
        [0.0, 0.3, 4.7, 5.0],
        first_interval=2.5,
    )


def assert_same_scans(got, expected):
    for name, one in expected.scan._asdict().items():
        np.testing.assert_array_equal(getattr(got.scan, name), one)
    np.testing.assert_array_equal(got.time, expected.time)


@pytest.mark.parametrize("start", [None, START])
def test_scans_come_back_from_a_table(start):
    frame = frames.detections_frame(some_scans(), ("e", "n"), start)
    assert list(frame) == ["time", "e", "n"]
    again, began = frames.scans_from_frame(frame, ("e", "n"), first_interval=2.5)
    assert_same_scans(again, some_scans())
    assert began == start
    # The empty scan is the third row.
    np.testing.assert_array_equal(
        again.row, [[0, 1, -1], [-1, -1, -1], [3, -1, -1], [4, 5, 6]]
    )
    for t, slot in zip(*np.nonzero(again.row >= 0), strict=True):
        seen = frame.iloc[again.row[t, slot]][["e", "n"]].to_numpy(float)
        np.testing.assert_array_equal(again.scan.detections[t, slot], seen)


def test_a_table_has_a_row_for_each_detection_and_each_empty_scan():
    frame = frames.detections_frame(some_scans(), start=START)
    assert str(frame["time"][2]) == "2020-06-30 23:59:58.800000"
    assert frame[["x", "y"]].isna().to_numpy().sum() == 2
    np.testing.assert_array_equal(frame["x"][3], 4.0 / 7.0)
    np.testing.assert_array_equal(
        (frame["time"] - frame["time"][0]).dt.total_seconds(),
        [0.0, 0.0, 0.3, 4.7, 5.0, 5.0, 5.0],
    )


def test_one_detection_and_none_at_all():
    one = pandas.DataFrame({"time": [7.0], "x": [1], "y": [2.0]})
    got, _ = frames.scans_from_frame(one)
    assert got.scan.detections.tolist() == [[[1.0, 2.0]]]
    assert got.scan.interval.tolist() == [1.0]
    nothing, start = frames.scans_from_frame(one.iloc[:0])
    assert nothing.scan.detections.shape == (0, 1, 2)
    assert nothing.scan.interval.shape == (0,)
    assert start is None
    assert len(frames.detections_frame(nothing)) == 0
    blind = pandas.DataFrame({"time": [1.0, 2.0], "x": [None] * 2, "y": [None] * 2})
    got, _ = frames.scans_from_frame(blind)
    assert got.scan.valid.tolist() == [[False], [False]]
    assert (got.row == -1).all()


def test_time_zones_go_to_utc_and_texts_are_read():
    texts = ["2020-06-30T14:00:00", "2020-06-30T14:00:02.25"]
    stamps = pandas.to_datetime(texts, format="ISO8601")
    zoned = stamps.tz_localize("Europe/Paris")
    for times in (zoned, [x.isoformat() for x in zoned]):
        frame = pandas.DataFrame({"time": times, "x": [0.0, 1.0], "y": [0.0, 1.0]})
        got, start = frames.scans_from_frame(frame)
        assert start == "2020-06-30T12:00:00"
        assert got.time.tolist() == [0.0, 2.25]


def test_a_start_before_the_first_scan_is_kept():
    late = some_scans()._replace(time=some_scans().time + 60.0)
    frame = frames.detections_frame(late, start=START)
    again, start = frames.scans_from_frame(frame, start=START)
    assert start == START
    np.testing.assert_array_equal(again.time, late.time)


def test_a_hundred_thousand_rows_come_back():
    rng = np.random.default_rng(1)
    time = np.sort(rng.integers(0, 30_000, 100_000)) / 8.0
    big = scans.group_scans(time, rng.normal(size=(100_000, 2)))
    frame = frames.detections_frame(big, start=START)
    assert len(frame) == 100_000
    again, _ = frames.scans_from_frame(frame, start=START)
    np.testing.assert_array_equal(again.scan.detections, big.scan.detections)
    np.testing.assert_array_equal(again.time, big.time)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"y": None}, "has no column 'y'; it has time, x: rename one"),
        ({"time": [0.0, math.nan]}, "column 'time', row b: 'nan' is not a finite"),
        ({"time": [2.0, 1.0]}, "column 'time', row b: '1.0' is earlier than the row"),
        ({"time": ["0", "soon"]}, "row b: 'soon' is not a finite number"),
        ({"time": pandas.to_datetime(["2020", None])}, "row b: 'NaT' is no time"),
        ({"x": [1.0, math.inf]}, "column 'x', row b: 'inf' is not a finite number"),
        ({"x": [1.0, "far"]}, "column 'x', row b: 'far' is not a finite number"),
        ({"x": [1.0, math.nan]}, "row b: 'nan' stands beside .* give all of x, y"),
    ],
)
def test_wrong_tables_get_one_sentence(columns, message):
    good = {"time": [0.0, 1.0], "x": [1.0, 2.0], "y": [3.0, 4.0]}
    given = {name: x for name, x in (good | columns).items() if x is not None}
    with pytest.raises(DataError, match=message) as raised:
        frames.scans_from_frame(pandas.DataFrame(given, index=["a", "b"]))
    assert str(raised.value).count("\n") == 0


def test_names_must_be_as_many_as_values():
    with pytest.raises(ValueError, match="names has x, but there are 2 components"):
        frames.detections_frame(some_scans(), ("x",))
    with pytest.raises(ValueError, match="'x' would name two columns; give each a"):
        frames.detections_frame(some_scans(), ("x", "x"))
    with pytest.raises(ValueError, match="'target' would name two columns"):
        frames.truth_frame(some_truth(), ("x", "target", "y", "vy"))


def test_two_columns_of_one_name_are_refused():
    frame = frames.detections_frame(some_scans())[["time", "x", "y", "x"]]
    with pytest.raises(DataError, match="has several columns 'x'; keep one of them"):
        frames.scans_from_frame(frame)
    frame = frames.truth_frame(some_truth(), NAMES)[["time", "target", "time", *NAMES]]
    with pytest.raises(DataError, match="has several columns 'time'; keep one"):
        frames.truth_from_frame(frame, NAMES)


# Truth.


def some_truth():
    rng = np.random.default_rng(2)
    exists = np.array([[True, False, True], [True, True, False], [False, True, True]])
    state = np.where(exists[..., None], rng.normal(size=(3, 3, 4)), 0.0)
    return Truth(state, exists, np.array([0.0, 0.7, 3.0]))


NAMES = ("x", "vx", "y", "vy")


@pytest.mark.parametrize("start", [None, START])
@pytest.mark.parametrize("ids", [np.array([3, 5, 40]), np.array(["a", "b", "c"])])
def test_truth_comes_back_from_a_table(ids, start):
    frame = frames.truth_frame(some_truth(), NAMES, ids, start)
    shuffled = frame.sample(frac=1.0, random_state=0)
    again, truth, began = frames.truth_from_frame(shuffled, NAMES)
    assert again.tolist() == ids.tolist()
    assert began == start
    for got, expected in zip(truth, some_truth(), strict=True):
        np.testing.assert_array_equal(got, expected)


def test_times_without_targets_come_back_if_they_are_told():
    truth = some_truth()
    gone = truth._replace(exists=truth.exists & [[True], [False], [True]])
    frame = frames.truth_frame(gone, NAMES)
    _, again, _ = frames.truth_from_frame(frame, NAMES, times=truth.time)
    np.testing.assert_array_equal(again.exists, gone.exists)
    assert not again.state[1].any()
    with pytest.raises(DataError, match="row 2.* is of 3 s, when there is no scan"):
        frames.truth_from_frame(frame, NAMES, times=[0.0, 0.7])
    ids, empty, _ = frames.truth_from_frame(frame.iloc[:0], NAMES)
    assert (len(ids), empty.state.shape) == (0, (0, 0, 4))


def test_a_table_of_tracks_is_read_by_label():
    truth = some_truth()
    label = np.array([[7, 2, 9]] * 3)
    cov = np.broadcast_to(np.eye(4), (3, 3, 4, 4))
    estimates = Tracks(truth.state, cov, label, truth.exists, 0.5 * truth.exists)
    table = tables.tracks_table(truth.time, estimates, (0, 2), (1, 3), start=START)
    ids, got, start = frames.truth_from_frame(table, NAMES, "label")
    assert ids.tolist() == [2, 7, 9]
    assert start == START
    np.testing.assert_array_equal(got.exists, truth.exists[:, [1, 0, 2]])
    np.testing.assert_array_equal(got.state, truth.state[:, [1, 0, 2]])


class Tracks:
    def __init__(self, mean, cov, label, exists, existence_prob):
        self.mean, self.cov, self.label = mean, cov, label
        self.exists, self.existence_prob = exists, existence_prob


def test_wrong_truth_gets_one_sentence():
    frame = frames.truth_frame(some_truth(), NAMES)
    twice = pandas.concat([frame, frame.iloc[2:3]])
    with pytest.raises(DataError, match=r"rows 2 and 6.* both of 0 at 0\.7 s; keep"):
        frames.truth_from_frame(twice, NAMES)
    nobody = frame.astype({"target": object})
    nobody.loc[1, "target"] = None
    with pytest.raises(DataError, match="column 'target', row 1: 'N.*' is no identity"):
        frames.truth_from_frame(nobody, NAMES)
    frame.loc[4, "vy"] = math.nan
    with pytest.raises(DataError, match="column 'vy', row 4: 'nan' is not a finite"):
        frames.truth_from_frame(frame, NAMES)
    with pytest.raises(DataError, match="row 0, counted from 0, is .*nan.*leave rows"):
        rows.truth_from_rows([0.0], [1], [[math.nan]])


def test_times_must_rise():
    with pytest.raises(
        ValueError, match=r"times\[1\] is 0.0, not after the one before"
    ):
        rows.truth_from_rows([0.0], [1], [[1.0]], [1.0, 0.0])


def test_rows_that_would_fill_the_memory_are_refused():
    many = np.arange(10_000)
    with pytest.raises(DataError, match="10000 times of 10000 identities do not fit"):
        rows.truth_from_rows(many, many, np.zeros((10_000, 1)))


# The clock.


def test_times_of_a_clock_come_back_to_the_nanosecond():
    rng = np.random.default_rng(3)
    ticks = rng.integers(0, 26 * 86_400 * 10**9, 1000)
    stamps = np.datetime64("1999-12-31T23:59:59.123456789") + ticks.astype("m8[ns]")
    seconds, start = clock.seconds_after(stamps)
    np.testing.assert_array_equal(clock.to_stamps(seconds, start), stamps)
    assert seconds.min() == 0.0
    expected = [(int(x) - int(ticks.min())) / 1e9 for x in ticks]
    np.testing.assert_array_equal(seconds, expected)


def test_a_start_may_have_a_time_zone_and_must_be_a_time():
    noon = np.array(["2020-06-30T12:00:00"], "M8[s]")
    seconds, start = clock.seconds_after(noon, "2020-06-30T13:00:00+02:00")
    assert (seconds.tolist(), start) == ([3600.0], "2020-06-30T11:00:00")
    with pytest.raises(DataError, match="start is 'now'; give an ISO time such as"):
        clock.to_stamps([0.0], "now")
    with pytest.raises(DataError, match=r"time\[1\] is missing \(NaT\)"):
        clock.seconds_after(np.array(["2020", "NaT"], "M8[s]"))
