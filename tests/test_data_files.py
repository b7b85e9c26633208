"""Recorded detections: files read, and refused in one sentence."""

import sys

import numpy as np
import pytest

from jaxtrack.data import files
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


def test_a_hundred_thousand_rows_are_read_whole(tmp_path):
    rows = [f"{i},40.{i % 1000:03},-74.{i % 999:03},{i % 300}" for i in range(100_000)]
    path = tmp_path / "big.csv"
    path.write_text("\n".join(["time,lat,lon,name", *rows]))
    table = files.read_detections(path)
    np.testing.assert_array_equal(table.time, np.arange(100_000.0))
    assert np.isfinite(table.xy).all()
    assert len(set(table.other["name"])) == 300


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
