"""MOTChallenge text, against loops over its lines and round trips."""

import types

import numpy as np
import pytest

from jaxtrack.data import motchallenge
from jaxtrack.data.errors import DataError


@pytest.fixture
def read(tmp_path):
    """Writes a text to det.txt and reads it."""

    def write_and_read(text):
        path = tmp_path / "det.txt"
        path.write_text(text)
        return motchallenge.read_boxes(path)

    return write_and_read


def assert_same(got, expected):
    for name, one in expected._asdict().items():
        np.testing.assert_array_equal(getattr(got, name), one)


def random_boxes(rng, num, world=False, kinds=False):
    """Lines in no order, with unknown values as the files have them."""
    unknown = np.full(num, -1)
    place = rng.normal(size=(num, 3)) if world else np.full((num, 3), -1.0)
    return motchallenge.Boxes(
        frame=rng.integers(1, num // 3 + 2, num),
        id=unknown,
        box=rng.uniform(0.0, 1e3, (num, 4)),
        confidence=rng.uniform(size=num),
        world=place,
        kind=rng.integers(1, 13, num) if kinds else unknown,
        visibility=rng.uniform(size=num) if kinds else np.full(num, -1.0),
    )


@pytest.mark.parametrize(
    ("world", "kinds"), [(False, False), (True, False), (False, True)]
)
def test_lines_come_back_as_they_were(tmp_path, world, kinds):
    boxes = random_boxes(np.random.default_rng(4), 40, world, kinds)
    motchallenge.write_boxes(tmp_path / "a.txt", boxes)
    assert_same(motchallenge.read_boxes(tmp_path / "a.txt"), boxes)
    first = (tmp_path / "a.txt").read_text().splitlines()[0].split(",")
    assert len(first) == (9 if kinds else 10)
    assert first[:2] == [str(boxes.frame[0]), "-1"]
    assert world or kinds or first[7:] == ["-1", "-1", "-1"]


def test_a_hundred_thousand_lines_come_back(tmp_path):
    boxes = random_boxes(np.random.default_rng(5), 100_000)
    motchallenge.write_boxes(tmp_path / "big.txt", boxes)
    again = motchallenge.read_boxes(tmp_path / "big.txt")
    assert_same(again, boxes)
    scans = motchallenge.scans_from_boxes(again, 30.0)
    assert scans.scan.valid.sum() == 100_000


def test_frames_become_scans_as_in_a_loop():
    boxes = random_boxes(np.random.default_rng(6), 50)
    scans = motchallenge.scans_from_boxes(boxes, 25.0, "box", num_frames=30)
    assert scans.scan.detections.shape[0] == 30
    np.testing.assert_allclose(scans.scan.interval, 0.04, rtol=1e-12)
    for t in range(30):
        lines = [k for k in range(50) if boxes.frame[k] == t + 1]
        assert scans.time[t] == t / 25.0
        assert scans.row[t][scans.scan.valid[t]].tolist() == lines
        for slot, k in enumerate(lines):
            left, top, width, height = boxes.box[k]
            centre = [left + width / 2, top + height / 2]
            got = scans.scan.detections[t, slot]
            np.testing.assert_array_equal(got, [*centre, width, height])
        assert not scans.scan.detections[t][len(lines) :].any()


def test_frames_before_the_first_line_are_empty_scans(read):
    scans = motchallenge.scans_from_boxes(read("3,-1,1,1,2,2,1\n"), 30.0)
    assert scans.scan.valid.tolist() == [[False], [False], [True]]


def test_places_in_the_world_are_in_two_or_three_dimensions(read):
    flat = read("1,-1,-1,-1,-1,-1,0.5,3,4,-1\n2,-1,-1,-1,-1,-1,1,5,-1,-1\n")
    places = motchallenge.measured(flat, "world")
    assert places.tolist() == [[3.0, 4.0], [5.0, -1.0]]
    high = read("1,-1,-1,-1,-1,-1,0.5,3,4,0\n")
    scans = motchallenge.scans_from_boxes(high, 10.0, "world")
    assert scans.scan.detections.tolist() == [[[3.0, 4.0, 0.0]]]
    with pytest.raises(
        DataError, match='Line 0, .* in frame 1 has no place .*"centre"'
    ):
        motchallenge.measured(read("1,-1,1,1,2,2,1\n"), "world")


def test_short_lines_spaces_and_blank_lines_are_read(read):
    boxes = read("2, 1, 10, 20, 4, 6, 1\n\n1,2,5,6,7,8,0.25\n\n")
    assert boxes.frame.tolist() == [2, 1]
    assert boxes.id.tolist() == [1, 2]
    assert (boxes.world == -1).all()
    assert (boxes.kind == -1).all()
    truth = read("1,3,10,20,4,6,1,7,0.5\n")
    assert (truth.kind.tolist(), truth.visibility.tolist()) == ([7], [0.5])


def test_an_empty_file_is_a_recording_without_detections(read, tmp_path):
    boxes = read("")
    assert len(boxes.frame) == 0
    scans = motchallenge.scans_from_boxes(boxes, 30.0, num_frames=3)
    assert scans.scan.valid.tolist() == [[False]] * 3
    assert motchallenge.scans_from_boxes(boxes, 30.0).time.shape == (0,)
    ids, truth = motchallenge.truth_from_boxes(boxes, 30.0, num_frames=3)
    assert (len(ids), truth.state.shape) == (0, (3, 0, 2))
    motchallenge.write_boxes(tmp_path / "none.txt", boxes)
    assert_same(motchallenge.read_boxes(tmp_path / "none.txt"), boxes)


def test_tracks_are_written_and_read_back_as_truth(tmp_path):
    rng = np.random.default_rng(7)
    exists = np.array([[True, True], [False, False], [False, True], [True, False]])
    estimates = types.SimpleNamespace(
        mean=np.round(rng.uniform(100.0, 200.0, (4, 2, 4))),
        label=np.array([[8, 3]] * 4),
        exists=exists,
        existence_prob=rng.uniform(size=(4, 2)),
    )
    boxes = motchallenge.boxes_from_estimates(estimates, (0, 2), size=(40.0, 90.0))
    assert boxes.frame.tolist() == [1, 1, 3, 4]
    assert boxes.id.tolist() == [3, 8, 3, 8]
    assert boxes.confidence[0] == estimates.existence_prob[0, 1]
    path = tmp_path / "tracks.txt"
    motchallenge.write_boxes(path, boxes)
    again = motchallenge.read_boxes(path)
    assert_same(again, boxes)
    ids, truth = motchallenge.truth_from_boxes(again, 2.0)
    assert ids.tolist() == [3, 8]
    assert truth.time.tolist() == [0.0, 0.5, 1.0, 1.5]
    np.testing.assert_array_equal(truth.exists, exists[:, ::-1])
    there = estimates.mean[:, ::-1][..., [0, 2]]
    np.testing.assert_array_equal(truth.state[truth.exists], there[truth.exists])
    flat = motchallenge.boxes_from_estimates(estimates, (0, 2))
    assert (flat.box == -1).all()
    np.testing.assert_array_equal(flat.world[0], [*estimates.mean[0, 1, [0, 2]], -1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3 4 5 6 7\n", "has a single column; separate columns by commas"),
        ("1,2,3,4,5,6\n", "has 6 columns; give 7 .frame, id, .* 9 .* or 10"),
        ("1,2,3,4,5,6,7\n1,2,3\n", "column 'bb_top', row 2: a blank cell is not a fin"),
        ("1,2,3,4,5,6,7\n1,2,3,4,5,6,7,8\n", "has 8 columns; give 7"),
        ("1,2,3,4,5,6,7,8,9,10,11\n", "a row has more cells than 10.; separate its"),
        ("\n0,2,3,4,5,6,7\n", "column 'frame', row 2: '0' is below 1"),
        ("1,2,,4,5,6,7\n", "column 'bb_left', row 1: a blank cell is not"),
        ("1.5,2,3,4,5,6,7\n", "column 'frame', row 1: '1.5' is not a whole number"),
        ("1,-1,3,nan,5,6,7\n", "column 'bb_top', row 1: 'nan' is not a finite"),
        ("frame,id,a,b,c,d,e\n", "column 'frame', row 1: 'frame' is not a finite"),
    ],
)
def test_wrong_files_get_one_sentence(read, text, message):
    with pytest.raises(DataError, match=rf"det\.txt.*{message}") as raised:
        read(text)
    assert "\n" not in str(raised.value)


def test_a_height_that_only_some_lines_know_is_not_made_up(read):
    boxes = read("1,-1,1,1,2,2,1,3,4,5\n2,-1,1,1,2,2,1,6,7,-1\n")
    with pytest.raises(DataError, match="Line 1, .* in frame 2 has no z .*every z to"):
        motchallenge.measured(boxes, "world")
    boxes.world[:, 2] = -1
    places = motchallenge.measured(boxes, "world")
    assert places.tolist() == [[3.0, 4.0], [6.0, 7.0]]


@pytest.mark.parametrize(
    ("lead", "index", "size", "message"),
    [
        ((), (0, 2), 5.0, r"size is 5.0; give \(width, height\) in pixels"),
        ((), (0, 2), (5.0, 0.0), r"size is \(5.0, 0.0\); give"),
        ((), (0,), None, r"position_index is \(0,\); give 2 or 3 components"),
        ((), (0, 1, 2, 3), None, "give 2 or 3 components"),
        ((), (0, 1, 2), (5.0, 5.0), "give 2 components"),
        ((2,), (0, 2), None, r"exists has shape \(2, 3, 1\), not \[T, N\]; give .*one"),
    ],
)
def test_estimates_that_make_no_lines_get_one_sentence(lead, index, size, message):
    estimates = types.SimpleNamespace(
        mean=np.ones((*lead, 3, 1, 4)),
        label=np.ones((*lead, 3, 1), int),
        exists=np.ones((*lead, 3, 1), bool),
        existence_prob=np.ones((*lead, 3, 1)),
    )
    with pytest.raises(ValueError, match=message):
        motchallenge.boxes_from_estimates(estimates, index, size)


def test_wrong_settings_get_one_sentence(read, tmp_path):
    boxes = read("3,-1,1,1,2,2,1\n")
    with pytest.raises(ValueError, match="frame_rate is 0; give frames a second above"):
        motchallenge.scans_from_boxes(boxes, 0)
    with pytest.raises(DataError, match="num_frames is 2, but a line is of frame 3"):
        motchallenge.scans_from_boxes(boxes, 30.0, num_frames=2)
    with pytest.raises(ValueError, match="what is 'corner'; give .centre"):
        motchallenge.measured(boxes, "corner")
    with pytest.raises(DataError, match="Line 0, .* in frame 3 has the id -1"):
        motchallenge.truth_from_boxes(boxes, 30.0)
    twice = read("1,5,1,1,2,2,1\n1,5,1,1,2,2,1\n")
    with pytest.raises(DataError, match="rows 0 and 1, .* both of 5 at 0 s"):
        motchallenge.truth_from_boxes(twice, 30.0)
    both = random_boxes(np.random.default_rng(8), 3, world=True, kinds=True)
    with pytest.raises(DataError, match="A line has room for x, y, z or for class"):
        motchallenge.write_boxes(tmp_path / "both.txt", both)
    with pytest.raises(DataError, match="cannot be written"):
        motchallenge.write_boxes(tmp_path / "none" / "a.txt", boxes)
    with pytest.raises(DataError, match="does not exist"):
        motchallenge.read_boxes(tmp_path / "missing.txt")
