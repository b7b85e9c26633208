"""Recorded data: files read and refused, the map, scans, truth and tables of tracks."""

import math
import sys
import time as clock
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from reference import vincenty

from jaxtrack.data import files, geodesy, scans, tables
from jaxtrack.data.errors import DataError, import_pandas


@pytest.fixture
def read(tmp_path):
    """Writes a text to f.csv and reads it."""

    def write_and_read(text, **settings):
        path = tmp_path / "f.csv"
        path.write_text(text)
        return files.read_detections(path, **settings)

    return write_and_read


# Files that are right.


def test_metres_and_seconds_are_taken_as_they_are(read):
    table = read("y,Time,X,name\n1,100,2,Ada\n\n3,100.5,-4e2,\n")
    np.testing.assert_array_equal(table.time, [100.0, 100.5])
    np.testing.assert_array_equal(table.xy, [[2.0, 1.0], [-400.0, 3.0]])
    assert list(table.other) == ["name"]
    assert list(table.other["name"]) == ["Ada", ""]
    assert table.origin is None
    assert table.start is None


def test_iso_times_count_from_the_earliest_in_utc(read):
    table = read(
        "time,x,y\n2020-06-30T23:59:59,0,0\n2020-07-01 02:00:01.25+02:00,1,1\n"
    )
    np.testing.assert_allclose(table.time, [0.0, 2.25], rtol=0, atol=1e-9)
    assert table.start == "2020-06-30T23:59:59"


def test_degrees_become_metres_about_the_given_origin(read):
    table = read("time,LON,LAT\n0,-74.0,40.01\n0,-73.99,40.0\n", origin=(40.0, -74.0))
    np.testing.assert_allclose(table.xy[0], [0.0, 1110.35], atol=0.01)
    np.testing.assert_allclose(table.xy[1], [853.94, 0.05], atol=0.01)
    assert table.origin == (40.0, -74.0)


def test_columns_may_be_named(read):
    table = read("T,E,n,lat\n1,2,3,4\n", columns={"time": "t", "x": "E", "y": "N"})
    np.testing.assert_array_equal(table.xy, [[2.0, 3.0]])
    assert list(files.further_column(table, "LAT")) == ["4"]


def test_degrees_are_preferred_to_metres_only_if_asked_for(read):
    text = "time,x,y,lat,lon\n1,2,3,4,5\n"
    assert read(text).origin is None
    assert read(text, columns={"lat": "lat"}).origin == (4.0, 5.0)


def test_sorting_moves_whole_rows(read):
    table = read("time,x,y,name\n2,20,21,b\n1,10,11,a\n2,30,31,c\n", sort=True)
    np.testing.assert_array_equal(table.time, [1.0, 2.0, 2.0])
    np.testing.assert_array_equal(table.xy[:, 0], [10.0, 20.0, 30.0])
    assert list(table.other["name"]) == ["a", "b", "c"]


def test_hundred_thousand_rows_are_read_in_two_seconds(tmp_path):
    rows = [f"{i},40.{i % 1000:03},-74.{i % 999:03},{i % 300}" for i in range(100_000)]
    path = tmp_path / "big.csv"
    path.write_text("\n".join(["time,lat,lon,name", *rows]))
    begun = clock.process_time()
    table = files.read_detections(path)
    assert clock.process_time() - begun < 2.0
    assert table.xy.shape == (100_000, 2)


def test_the_harbour_is_read_without_settings():
    before = set(sys.modules)
    table = files.read_detections(files.harbour_path())
    assert "tracktable_data" not in set(sys.modules) - before
    assert len(table.time) == 8689
    assert table.time[-1] == 3599.0
    assert len(set(files.further_column(table, "MMSI"))) == 295
    assert np.abs(table.xy).max() < 40_000.0


# Files that are wrong.


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"f\.csv has no detections; it needs a header"),
        ("time,x,y\n\n", r"f\.csv has no detections"),
        ("x,y\n1,2\n", r"no column 'time'; it has x, y: rename one"),
        ("time,x\n1,2\n", r"no column 'y'.*\(x and y, or lat and lon\)"),
        ("time,lat\n1,2\n", r"no column 'lon'"),
        ("time,a\n1,2\n", r"no column 'x'"),
        ("time;x;y\n1;2;3\n", r"separate the columns by commas"),
        ("time,x,y\n1,2,3\n\n2,a1,3\n", r"'x', row 4: 'a1' is not a finite number"),
        ("time,x,y\n1,2,3\n2,3,\n", r"'y', row 3: a blank cell is not"),
        ("time,x,y\n1,nan,3\n", r"'x', row 2: 'nan' is not a finite number"),
        ("time,x,y\n1,inf,3\n", r"'x', row 2: 'inf' is not a finite number"),
        ("time,x,y\nnoon,2,3\n", r"'time', row 2: 'noon' is neither seconds nor"),
        ("time,x,y\n2020-01-01,2,3\n7,2,3\n", r"row 3: '7' is neither seconds"),
        ("time,x,y\n7,2,3\n2020-01-01,2,3\n", r"row 3: '2020-01-01' is not a finite"),
        ("time,x,y\n1,2,3\n2,2,3\n1.5,2,3\n", r"row 4: '1.5' is earlier.*sort=True"),
        ("time,lat,lon\n1,-90.5,0\n", r"'lat', row 2: '-90.5' is outside -90 to 90"),
        ("time,lat,lon\n1,0,181\n", r"'lon', row 2: '181' is outside -180 to 180"),
        ("time,x,y\n1,2,3,4\n", r"a row has more cells than the header"),
        ("time,x,y\n1,2,3\n1,2,3,4\n", r"Expected 3 fields in line 3, saw 4"),
    ],
)
def test_a_wrong_file_gets_one_sentence(read, text, message):
    with pytest.raises(DataError, match=message) as caught:
        read(text)
    assert "f.csv" in str(caught.value)
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_not_text_gets_one_sentence(tmp_path):
    with pytest.raises(DataError, match=r"none\.csv does not exist; check"):
        files.read_detections(tmp_path / "none.csv")
    with pytest.raises(DataError, match=r"cannot be read \(Is a directory\)"):
        files.read_detections(tmp_path)
    (tmp_path / "picture.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(DataError, match=r"save it as UTF-8 text"):
        files.read_detections(tmp_path / "picture.csv")


def test_a_wrong_name_gets_the_names_there_are(read):
    with pytest.raises(ValueError, match="key 'lng'; use only time, x, y, lat, lon"):
        read("time,x,y\n1,2,3\n", columns={"lng": "x"})
    with pytest.raises(DataError, match="no column 'when'; it has time, x, y"):
        read("time,x,y\n1,2,3\n", columns={"time": "when"})
    with pytest.raises(DataError, match="no further column 'ship'; choose one of boat"):
        files.further_column(read("time,x,y,boat\n1,2,3,a\n"), "ship")


def test_a_missing_package_gets_its_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(DataError, match=r'pip install "jaxtrack\[io\]"'):
        import_pandas()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(DataError, match=r'pip install "jaxtrack\[data\]"'):
        files.harbour_path()


# The map.


def points_around(lat0, lon0, radius, seed=0, num=60):
    """Points within a radius in metres of an origin, in degrees."""
    rng = np.random.default_rng(seed)
    away, angle = radius * np.sqrt(rng.uniform(size=num)), rng.uniform(0, 7, size=num)
    return geodesy.to_degrees(away * np.cos(angle), away * np.sin(angle), (lat0, lon0))


def test_the_reference_gives_the_published_geodesic():
    """Flinders Peak to Buninyong, Geocentric Datum of Australia technical manual."""
    distance, azimuth = vincenty.inverse(
        -37.95103341666667, 144.42486788888888, -37.65282113888889, 143.92649552777777
    )
    assert distance == pytest.approx(54972.271, abs=1e-3)
    assert math.degrees(azimuth) % 360 == pytest.approx(306.86815833, abs=1e-5)


@pytest.mark.parametrize("lat0", [-60.0, 0.1, 40.65, 75.0])
def test_the_map_keeps_places_and_lengths_within_fifty_kilometres(lat0):
    lat, lon = points_around(lat0, -74.0, 50e3)
    x, y, _ = geodesy.to_local(lat, lon, (lat0, -74.0))
    for k in range(len(lat)):
        away, azimuth = vincenty.inverse(lat0, -74.0, lat[k], lon[k])
        assert x[k] == pytest.approx(away * math.sin(azimuth), abs=2.0)
        assert y[k] == pytest.approx(away * math.cos(azimuth), abs=2.0)
        length, _ = vincenty.inverse(lat[k - 1], lon[k - 1], lat[k], lon[k])
        drawn = math.hypot(x[k] - x[k - 1], y[k] - y[k - 1])
        assert drawn == pytest.approx(length, rel=1e-4)


@pytest.mark.parametrize("origin", [(0.0, 0.0), (40.65, -74.0), (-75.0, 179.9)])
@pytest.mark.parametrize("radius", [1.0, 50e3, 5000e3])
def test_the_map_can_be_undone(origin, radius):
    rng = np.random.default_rng(1)
    x, y = radius * rng.uniform(-1, 1, size=(2, 50))
    lat, lon = geodesy.to_degrees(x, y, origin)
    assert np.all((lon >= -180.0) & (lon < 180.0))
    east, north, _ = geodesy.to_local(lat, lon, origin)
    np.testing.assert_allclose(east, x, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(north, y, rtol=1e-9, atol=1e-7)


def test_the_origin_is_the_median_even_across_the_date_line():
    x, y, origin = geodesy.to_local([10.0, 10.2, 10.1], [179.9, -179.9, -179.8])
    assert origin == pytest.approx((10.1, -179.9))
    assert np.abs(x).max() < 23e3
    np.testing.assert_allclose(y[:2], [-11060.0, 11060.0], atol=30.0)


def test_one_point_is_its_own_origin():
    x, y, origin = geodesy.to_local([51.5], [-0.1])
    assert origin == (51.5, -0.1)
    np.testing.assert_allclose([x[0], y[0]], 0.0, atol=1e-6)


# Scans.


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


# Tables of tracks.


class Estimates(NamedTuple):
    mean: jnp.ndarray
    cov: jnp.ndarray
    label: jnp.ndarray
    exists: jnp.ndarray
    existence_prob: jnp.ndarray


def estimates():
    """Two scans, three slots, states [x, vx, y, vy]; the labels are out of order."""
    mean = jnp.arange(24.0).reshape(2, 3, 4)
    cov = mean[..., None] ** 2 * jnp.eye(4)[None, None]
    label = jnp.array([[5, 2, 9], [5, 9, 2]])
    exists = jnp.array([[True, True, False], [False, True, True]])
    return Estimates(mean, cov, label, exists, mean[..., 0] / 24.0)


def test_table_of_tracks_has_one_row_for_each_reported_target(tmp_path):
    table = tables.tracks_table([3.0, 4.5], estimates(), (0, 2), (1, 3))
    names = ["time", "label", "x", "y", "vx", "vy", "std_x", "std_y", "existence_prob"]
    assert list(table) == names
    expected = [
        [3.0, 2, 4, 6, 5, 7, 4, 6, 4 / 24],
        [3.0, 5, 0, 2, 1, 3, 0, 2, 0 / 24],
        [4.5, 2, 20, 22, 21, 23, 20, 22, 20 / 24],
        [4.5, 9, 16, 18, 17, 19, 16, 18, 16 / 24],
    ]
    np.testing.assert_allclose(table.to_numpy(float), expected)
    tables.write_tracks(tmp_path / "tracks.csv", table)
    again = files.read_detections(tmp_path / "tracks.csv")
    np.testing.assert_allclose(again.xy, np.array(expected)[:, 2:4])
    assert list(again.other["label"]) == ["2", "5", "2", "9"]
    with pytest.raises(DataError, match="cannot be written"):
        tables.write_tracks(tmp_path / "none" / "tracks.csv", table)


def test_table_of_tracks_knows_degrees_and_the_clock(tmp_path):
    origin, start = (40.65, -74.0), "2020-06-30T23:59:57"
    table = tables.tracks_table([3.0, 4.5], estimates(), (0, 2), (1, 3), origin, start)
    assert table["time"][0] == "2020-07-01T00:00:00.000"
    assert table["time"][3] == "2020-07-01T00:00:01.500"
    tables.write_tracks(tmp_path / "tracks.csv", table)
    again = files.read_detections(
        tmp_path / "tracks.csv", {"lat": "lat", "lon": "lon"}, origin=origin
    )
    np.testing.assert_allclose(again.xy, table[["x", "y"]].to_numpy(), atol=0.01)
    np.testing.assert_allclose(again.time, [0.0, 0.0, 1.5, 1.5])


def test_a_table_of_no_tracks_has_its_columns():
    nothing = estimates()._replace(exists=jnp.zeros((2, 3), bool))
    table = tables.tracks_table(
        [3.0, 4.5], nothing, (0, 2), (1, 3), (40.0, -74.0), "2020"
    )
    assert len(table) == 0
    assert list(table)[-2:] == ["lat", "lon"]
