"""Tables of tracks as they are written to a file."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.data import files, tables
from jaxtrack.data.errors import DataError


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
