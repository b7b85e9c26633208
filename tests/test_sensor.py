"""Sensors against rotations in NumPy, near the wrap and on top of the target."""

import jax
import numpy as np
import pytest
from reference import models as plain

from jaxtrack.models import polar
from jaxtrack.models.sensor import (
    AzimuthElevationRange,
    BearingOnly,
    Delayed,
    Position,
    RangeBearing,
    RangeBearingRate,
    Timed,
    untimed,
)

HERE2, HERE3, HEADING = np.array([30.0, -20.0]), np.array([30.0, -20.0, 5.0]), 2.5
TWO, THREE = np.array([5.0, 0.02]), np.array([0.02, 0.01, 5.0])
SENSORS = {
    "position": Position(np.array([1.0, 2.0, 3.0])),
    "range-bearing": RangeBearing(TWO, HERE2, HEADING),
    "range-bearing-rate": RangeBearingRate(np.append(TWO, 0.5), HERE2, HEADING),
    "bearing-only": BearingOnly(TWO[1:], HERE2, HEADING),
    "azimuth-elevation-range": AzimuthElevationRange(THREE, HERE3, HEADING),
}
every_sensor = pytest.mark.parametrize("name", SENSORS)


def axes(name):
    return 2 if "bearing" in name else 3


def detection_by_hand(name, place, velocity):
    if name == "position":
        return place
    if name == "azimuth-elevation-range":
        return np.array(plain.spherical(place, HERE3, HEADING))
    distance, bearing = plain.polar(place, HERE2, HEADING)
    rate = (place - HERE2) @ velocity / distance
    every = {"range-bearing": [distance, bearing], "bearing-only": [bearing]}
    return np.array(every.get(name, [distance, bearing, rate]))


@jax.jit
def measured(sensor, places, velocities):
    return jax.vmap(sensor.measure)(places, velocities)


@jax.jit
def slopes(sensor, place, velocity):
    return jax.jacrev(type(sensor).measure, (0, 1, 2))(sensor, place, velocity)


@every_sensor
def test_measurement_is_that_of_the_turned_frame(name):
    rng = np.random.default_rng(0)
    places, velocities = rng.normal(0, 100, (2, 40, axes(name)))
    got = measured(SENSORS[name], places, velocities)
    want = [detection_by_hand(name, *x) for x in zip(places, velocities, strict=True)]
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-12)


@every_sensor
def test_noise_is_independent_and_counted(name):
    sensor = SENSORS[name]
    np.testing.assert_allclose(sensor.cov(), np.diag(sensor.noise_std**2))
    assert sensor.num_outputs == len(sensor.noise_std)
    assert sensor.linear == (name == "position")


@every_sensor
def test_gradients_agree_with_finite_differences(name):
    place = np.array([80.0, 45.0, -60.0])[: axes(name)]
    velocity = np.array([3.0, -7.0, 2.0])[: axes(name)]
    by_sensor, by_place, by_velocity = slopes(SENSORS[name], place, velocity)

    def at(place, velocity, **fields):
        sensor = SENSORS[name]._replace(**fields)
        return np.asarray(measured(sensor, place[None], velocity[None])[0])

    want = plain.jacobian(lambda x: at(x, velocity), place)
    np.testing.assert_allclose(by_place, want, atol=1e-7)
    want = plain.jacobian(lambda x: at(place, x), velocity)
    np.testing.assert_allclose(by_velocity, want, atol=1e-7)
    if name != "position":
        want = plain.jacobian(lambda x: at(place, velocity, heading=x[0]), [HEADING])
        np.testing.assert_allclose(by_sensor.heading, want[:, 0], atol=1e-7)
        np.testing.assert_allclose(by_sensor.position, -by_place, atol=1e-12)


@every_sensor
def test_values_and_gradients_are_finite_at_the_sensor_and_overhead(name):
    sensor = SENSORS[name]
    here = HERE3[: axes(name)]
    for place in (here, here + np.eye(axes(name))[-1]):
        leaves = jax.tree.leaves(slopes(sensor, place, np.ones(axes(name))))
        leaves += [measured(sensor, place[None], np.ones((1, axes(name))))]
        assert all(np.isfinite(leaf).all() for leaf in leaves)


def test_gradients_in_float32_are_finite_at_the_sensor():
    with jax.enable_x64(False):
        sensor = jax.tree.map(np.float32, SENSORS["range-bearing-rate"])
        got = slopes(sensor, np.float32(HERE2), np.ones(2, np.float32))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(got))
        assert {leaf.dtype for leaf in jax.tree.leaves(got)} == {np.dtype("float32")}


@pytest.mark.parametrize(
    ("name", "angles"),
    [
        ("range-bearing", [1]),
        ("range-bearing-rate", [1]),
        ("bearing-only", [0]),
        ("azimuth-elevation-range", [0, 1]),
        ("position", []),
    ],
)
def test_residuals_are_wrapped_in_their_angles_only(name, angles):
    sensor = SENSORS[name]
    num = sensor.num_outputs
    high, low = np.full(num, np.pi - 0.1), np.full(num, -np.pi + 0.2)
    want = high - low
    want[angles] = -0.3
    residual = jax.jit(type(sensor).residual)
    np.testing.assert_allclose(residual(sensor, high, low), want)
    np.testing.assert_allclose(residual(sensor, low, high), -want)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_wrapped_angles_lie_in_the_half_open_turn_and_keep_their_direction(dtype):
    pi = dtype(np.pi)
    edge = [np.nextafter(x, x + d, dtype=dtype) for x in (pi, -pi) for d in (-1, 1)]
    angles = np.array(
        [0, 1e-6, -1e-6, pi, -pi, *edge, *np.linspace(-60, 60, 999)], dtype
    )
    with jax.enable_x64(dtype is np.float64):
        wrapped = np.asarray(jax.jit(polar.wrap)(angles))
    assert wrapped.dtype == dtype
    assert (wrapped >= -pi).all()
    assert (wrapped < pi).all()
    np.testing.assert_array_equal(wrapped[:3], angles[:3])
    gap = np.exp(1j * angles.astype(float)) - np.exp(1j * wrapped.astype(float))
    assert abs(gap).max() < 100 * np.finfo(dtype).eps
    # The slope is one, on the edges as well.
    slope = jax.jit(jax.vmap(jax.grad(polar.wrap)))(angles.astype(float))
    np.testing.assert_array_equal(slope, np.ones(len(angles)))


def test_planar_detections_are_located_to_first_order():
    for name in ("range-bearing", "range-bearing-rate"):
        sensor = SENSORS[name]
        detection = np.array([3000.0, -2.0, 9.0])[: sensor.num_outputs]

        def place(z):
            away = z[1] + HEADING
            return HERE2 + z[0] * np.array([np.cos(away), np.sin(away)])

        got = jax.jit(type(sensor).locate)(sensor, detection)
        np.testing.assert_allclose(got.mean, place(detection))
        slope = plain.jacobian(place, detection[:2], 1e-4)
        want = slope @ np.diag(TWO**2) @ slope.T
        np.testing.assert_allclose(got.cov, want, rtol=1e-4)
        back = measured(sensor, got.mean[None], np.zeros((1, 2)))[0]
        np.testing.assert_allclose(back[:2], detection[:2])


def test_spatial_detections_are_located_to_first_order():
    sensor = SENSORS["azimuth-elevation-range"]
    detection = np.array([-2.0, 0.6, 3000.0])
    got = jax.jit(type(sensor).locate)(sensor, detection)

    def place(z):
        return plain.unspherical(z, HERE3, HEADING)

    np.testing.assert_allclose(got.mean, place(detection))
    slope = plain.jacobian(place, detection, 1e-4)
    want = slope @ np.diag(THREE**2) @ slope.T
    np.testing.assert_allclose(got.cov, want, rtol=1e-3)
    back = measured(sensor, got.mean[None], np.zeros((1, 3)))[0]
    np.testing.assert_allclose(back, detection)


def test_positions_locate_themselves():
    got = SENSORS["position"].locate(np.array([7.0, 8.0, 9.0]))
    np.testing.assert_array_equal(got.mean, [7, 8, 9])
    np.testing.assert_allclose(got.cov, np.diag([1.0, 4.0, 9.0]))


def test_located_covariance_is_never_singular():
    at_sensor = SENSORS["range-bearing"].locate(np.zeros(2))
    assert np.linalg.eigvalsh(at_sensor.cov).min() > 1e-3
    overhead = SENSORS["azimuth-elevation-range"].locate(np.array([1.0, np.pi / 2, 0]))
    assert np.linalg.eigvalsh(overhead.cov).min() > 1e-6


@every_sensor
def test_an_aged_detection_is_expected_where_the_target_was(name):
    sensor, age = SENSORS[name], 2.5
    rng = np.random.default_rng(1)
    place, velocity = rng.normal(0, 100, (2, axes(name)))
    detection = np.append(detection_by_hand(name, place, velocity), age)
    delayed, ageless = untimed(Timed(sensor), detection)
    assert isinstance(delayed, Delayed)
    np.testing.assert_array_equal(ageless, detection[:-1])
    got = jax.jit(Delayed.measure)(delayed, place + age * velocity, velocity)
    np.testing.assert_allclose(got, detection[:-1], rtol=1e-9, atol=1e-12)


def test_timed_and_delayed_sensors_delegate_the_rest():
    sensor = SENSORS["range-bearing"]
    detection, other = np.array([50.0, 3.0]), np.array([40.0, -3.0])
    for wrapper in (Timed(sensor), Delayed(sensor, 2.0)):
        np.testing.assert_array_equal(wrapper.cov(), sensor.cov())
        want = sensor.residual(detection, other)
        np.testing.assert_array_equal(wrapper.residual(detection, other), want)
        assert wrapper.num_outputs == sensor.num_outputs
        assert wrapper.linear == sensor.linear
    want = sensor.measure(HERE2 + 9.0, np.ones(2))
    np.testing.assert_array_equal(Timed(sensor).measure(HERE2 + 9.0, np.ones(2)), want)
    timed = Timed(sensor).locate(np.append(detection, 2.0))
    want = sensor.locate(detection)
    np.testing.assert_array_equal(timed.mean, want.mean)
    np.testing.assert_array_equal(timed.cov, want.cov)
    same, unchanged = untimed(sensor, detection)
    assert same is sensor
    assert unchanged is detection
