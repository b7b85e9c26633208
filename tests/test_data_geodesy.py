"""The local map against geodesics by Vincenty."""

import math

import numpy as np
import pytest
from reference import vincenty

from jaxtrack.data import geodesy


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
