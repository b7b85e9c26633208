"""Stone Soup's detections, tracks and ground truth: round trips and messages."""

import datetime
import types

import numpy as np
import pytest

from jaxtrack.data import scans, stonesoup
from jaxtrack.data.errors import DataError
from jaxtrack.scenarios.world import Truth

NOON = datetime.datetime(2020, 6, 30, 12)
START = "2020-06-30T12:00:00"


def after(seconds):
    return NOON + datetime.timedelta(seconds=seconds)


def some_scans():
    """Irregular; two detections at one time, nothing, then three; sorted in a scan."""
    measured = [[1.0, 9.0], [1.0, 10.0], [-3.0, 1.0], [-2.0, 0.5], [7.0, 0.1]]
    return scans.fill_scans([0, 0, 2, 2, 2], measured, [0.0, 0.3, 4.7])


@pytest.mark.parametrize("index", [None, (1, 0)])
def test_detections_come_back(index):
    from stonesoup.types.detection import Detection

    pairs = stonesoup.detections_from_scans(some_scans(), START, index)
    assert [stamp for stamp, _ in pairs] == [after(0.0), after(0.3), after(4.7)]
    assert [len(some) for _, some in pairs] == [2, 0, 3]
    assert {type(x) for _, some in pairs for x in some} == {Detection}
    assert all(x.timestamp == stamp for stamp, some in pairs for x in some)
    first = sorted(np.ravel(x.state_vector).tolist() for x in pairs[0][1])
    swapped = [[9.0, 1.0], [10.0, 1.0]]
    assert first == (swapped if index else [[1.0, 9.0], [1.0, 10.0]])
    seen = stonesoup.scans_from_detections(pairs, index)
    assert seen.start == START
    np.testing.assert_array_equal(seen.scans.time, some_scans().time)
    for name, one in some_scans().scan._asdict().items():
        np.testing.assert_array_equal(getattr(seen.scans.scan, name), one)


def test_a_slot_leads_to_the_object_and_its_source():
    from stonesoup.types.detection import Clutter, Detection, TrueDetection
    from stonesoup.types.groundtruth import GroundTruthPath

    ada = GroundTruthPath(id="Ada")
    sources = [[ada, None, None], [None] * 3, [None, ada, ada]]
    model = object()
    pairs = stonesoup.detections_from_scans(
        some_scans(), START, sources=sources, measurement_model=model
    )
    plain = Detection([5.0, 5.0], timestamp=after(9.0))
    seen = stonesoup.scans_from_detections([*pairs, (after(9.0), {plain})])
    kinds = [
        [type(seen.detections[k]) for k in row if k >= 0] for row in seen.scans.row
    ]
    assert kinds == [
        [TrueDetection, Clutter],
        [],
        [Clutter, TrueDetection, TrueDetection],
        [Detection],
    ]
    true = seen.detections[seen.scans.row[0, 0]]
    assert true.groundtruth_path is ada
    assert true.measurement_model is model
    for t, slot in zip(*np.nonzero(seen.scans.row >= 0), strict=True):
        vector = np.ravel(seen.detections[seen.scans.row[t, slot]].state_vector)
        np.testing.assert_array_equal(vector, seen.scans.scan.detections[t, slot])


def test_bearings_become_numbers_after_the_range():
    from stonesoup.types.angle import Bearing
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import StateVector

    one = Detection(StateVector([Bearing(0.25), 70.0]), timestamp=NOON)
    seen = stonesoup.scans_from_detections([(NOON, [one])], index=(1, 0))
    assert seen.scans.scan.detections.tolist() == [[[70.0, 0.25]]]
    assert seen.scans.scan.detections.dtype == np.float64


def test_any_order_of_entries_comes_back():
    turned = scans.fill_scans([0], [[1.0, 2.0, 3.0]], [0.0])
    pairs = stonesoup.detections_from_scans(turned, START, (2, 0, 1))
    assert [np.ravel(x.state_vector).tolist() for x in pairs[0][1]] == [[2.0, 3.0, 1.0]]
    seen = stonesoup.scans_from_detections(pairs, (2, 0, 1))
    assert seen.scans.scan.detections.tolist() == [[[1.0, 2.0, 3.0]]]


def test_time_zones_and_empty_sets():
    zone = datetime.timezone(datetime.timedelta(hours=2))
    there = NOON.replace(tzinfo=zone)
    later = there + datetime.timedelta(seconds=2)
    seen = stonesoup.scans_from_detections([(there, set()), (later, set())], (0, 1))
    assert seen.start == "2020-06-30T10:00:00"
    assert seen.scans.scan.detections.shape == (2, 1, 2)
    assert not seen.scans.scan.valid.any()
    nothing = stonesoup.scans_from_detections([], (0, 1))
    assert nothing.scans.time.shape == (0,)
    assert stonesoup.detections_from_scans(nothing.scans, START) == []


def test_tracks_have_a_state_where_a_label_is_reported():
    from stonesoup.types.state import GaussianState

    rng = np.random.default_rng(11)
    estimates = types.SimpleNamespace(
        mean=rng.normal(size=(3, 2, 4)),
        cov=rng.normal(size=(3, 2, 4, 4)),
        label=np.array([[8, 3], [8, 3], [3, 8]]),
        exists=np.array([[True, True], [False, False], [False, True]]),
    )
    tracks = stonesoup.tracks_from_estimates(estimates, [0.0, 1.5, 4.0], START)
    by_id = {track.id: track for track in tracks}
    assert sorted(by_id) == ["3", "8"]
    assert [x.timestamp for x in by_id["8"]] == [after(0.0), after(4.0)]
    assert [x.timestamp for x in by_id["3"]] == [after(0.0)]
    for state, (t, n) in zip(by_id["8"], [(0, 0), (2, 1)], strict=True):
        assert type(state) is GaussianState
        np.testing.assert_array_equal(np.ravel(state.mean), estimates.mean[t, n])
        np.testing.assert_array_equal(np.asarray(state.covar), estimates.cov[t, n])
    ids, truth, _ = stonesoup.truth_from_paths(tracks)
    assert ids.tolist() == ["3", "8"]
    np.testing.assert_array_equal(truth.exists, [[True, True], [False, True]])
    np.testing.assert_array_equal(truth.state[1, 1], estimates.mean[2, 1])


@pytest.mark.parametrize("ids", [None, np.array(["Ada", "Bob", "Eve"])])
def test_truth_comes_back_from_paths(ids):
    rng = np.random.default_rng(12)
    exists = np.array([[True, False, True], [False] * 3, [True, True, False]])
    state = np.where(exists[..., None], rng.normal(size=(3, 3, 4)), 0.0)
    truth = Truth(state, exists, np.array([0.0, 0.7, 3.0]))
    paths = stonesoup.paths_from_truth(truth, START, ids)
    named = {path.id: [x.timestamp for x in path] for path in paths}
    first = "0" if ids is None else "Ada"
    assert named[first] == [after(0.0), after(3.0)]
    times = [after(seconds) for seconds in truth.time]
    names, again, start = stonesoup.truth_from_paths(paths, timestamps=times)
    assert names.tolist() == (["0", "1", "2"] if ids is None else ids.tolist())
    assert start == START
    for got, expected in zip(again, truth, strict=True):
        np.testing.assert_array_equal(got, expected)
    _, crop, _ = stonesoup.truth_from_paths(paths, (2, 0))
    np.testing.assert_array_equal(crop.state, truth.state[[0, 2]][..., [2, 0]])


def test_of_two_states_at_one_time_the_later_counts():
    from stonesoup.types.state import State
    from stonesoup.types.track import Track

    track = Track([State([1.0], timestamp=NOON), State([2.0], timestamp=NOON)])
    _, truth, _ = stonesoup.truth_from_paths([track])
    assert truth.state.tolist() == [[[2.0]]]


def test_wrong_objects_get_one_sentence():
    from stonesoup.types.detection import Detection
    from stonesoup.types.groundtruth import GroundTruthPath, GroundTruthState

    with pytest.raises(DataError, match="timestamp 1, 2020-06-30 12:00:00, is not aft"):
        stonesoup.scans_from_detections([(NOON, set()), (NOON, set())], (0,))
    with pytest.raises(DataError, match="timestamp 0, counted from 0, is None; give"):
        stonesoup.scans_from_detections([(None, set())], (0,))
    with pytest.raises(
        DataError, match="no state to tell how many values .*give index"
    ):
        stonesoup.scans_from_detections([(NOON, set())])
    lost = Detection([np.nan, 1.0], timestamp=NOON)
    with pytest.raises(
        DataError, match=r"\[nan  1.\] at 2020-06-30 12:00:00 is not fi"
    ):
        stonesoup.scans_from_detections([(NOON, {lost})])
    with pytest.raises(
        ValueError, match=r"index is \(0, 2\); give each of 0 to 1 once"
    ):
        stonesoup.detections_from_scans(some_scans(), START, (0, 2))
    flat = Detection([1.0], timestamp=NOON), Detection([2.0, 3.0], timestamp=NOON)
    with pytest.raises(DataError, match="has 2 entries, but that at .* has 1; read"):
        stonesoup.scans_from_detections([(NOON, flat)])
    with pytest.raises(
        ValueError, match=r"index is \(0, 1\), .* give numbers from 0 to"
    ):
        stonesoup.scans_from_detections([(NOON, flat[:1])], (0, 1))
    several = types.SimpleNamespace(mean=0, cov=0, exists=np.ones((2, 3, 1), bool))
    with pytest.raises(ValueError, match=r"shape \(2, 3, 1\), not \[T, N\]; give the"):
        stonesoup.tracks_from_estimates(several, [0.0], START)
    path = GroundTruthPath([GroundTruthState([0.0], timestamp=after(1.0))])
    with pytest.raises(DataError, match="row 0.* is of 1 s, when there is no scan"):
        stonesoup.truth_from_paths([path], timestamps=[NOON])


def test_stonesoup_is_asked_for_by_its_extra(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "stonesoup.types.track", None)
    empty = types.SimpleNamespace(mean=0, cov=0, label=0, exists=0)
    with pytest.raises(DataError, match=r'pip install "jaxtrack\[stonesoup\]"'):
        stonesoup.tracks_from_estimates(empty, [], START)
