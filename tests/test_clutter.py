"""Clutter: densities that integrate to the rate, samples that follow them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.models.clutter import PolarClutter, UniformClutter

LOW, HIGH = np.array([-100.0, 50.0]), np.array([300.0, 250.0])
UNIFORM = UniformClutter(4.0, LOW, HIGH)
# The sensor stands in the box, so that all bearings and range 0 occur.
RADAR, HEADING = np.array([60.0, 90.0]), 2.5
POLAR = PolarClutter(4.0, LOW, HIGH, RADAR, HEADING)


@jax.jit
def log_densities(clutter, detections):
    return jax.vmap(clutter.log_density)(detections)


@jax.jit
def samples(clutter):
    keys = jax.random.split(jax.random.key(3), 4000)
    return jax.vmap(lambda key: clutter.sample(key, 12))(keys)


def places(detections):
    angle = detections[..., 1] + HEADING
    away = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return RADAR + detections[..., :1] * away


def test_uniform_density_is_rate_over_volume_inside_the_box_and_nothing_outside():
    detections = np.array([[0, 60, 9], [299, 249, 9], [0, 49, 9], [301, 60, 9.0]])
    want = np.log([4 / 80000, 4 / 80000, 1, 1])
    want[2:] = -np.inf
    np.testing.assert_allclose(log_densities(UNIFORM, detections), want)


def test_polar_density_integrates_to_the_rate():
    distance, bearing = np.arange(300) + 0.5, np.linspace(-np.pi, np.pi, 400, False)
    grid = np.stack(np.meshgrid(distance, bearing), axis=-1).reshape(-1, 2)
    density = np.exp(log_densities(POLAR, grid))
    np.testing.assert_allclose(density.sum() * 2 * np.pi / 400, 4.0, rtol=2e-3)


def test_polar_density_grows_with_range_inside_and_is_nothing_outside():
    # East of the sensor the box ends 240 m away.
    east = np.array([[100.0, -HEADING, 0], [200.0, -HEADING, 0], [250, -HEADING, 0]])
    want = [np.log(4 * 100 / 80000), np.log(4 * 200 / 80000), -np.inf]
    np.testing.assert_allclose(log_densities(POLAR, east), want)


@pytest.mark.parametrize("clutter", [UNIFORM, POLAR], ids=["uniform", "polar"])
def test_samples_fill_the_box_evenly_in_poisson_number(clutter):
    detections, valid = map(np.asarray, samples(clutter))
    assert detections.shape == (4000, 12, 2)
    if clutter is POLAR:
        assert (detections[..., 0] >= 0).all()
        assert (abs(detections[..., 1]) <= np.pi).all()
        detections = places(detections)
    assert (detections >= LOW).all()
    assert (detections <= HIGH).all()
    share = (detections[valid] - LOW) / (HIGH - LOW)
    np.testing.assert_allclose(share.mean(0), 0.5, atol=0.01)
    np.testing.assert_allclose(share.var(0), 1 / 12, atol=0.003)
    np.testing.assert_allclose(np.cov(share.T)[0, 1], 0, atol=0.003)
    count = valid.sum(1)
    np.testing.assert_allclose([count.mean(), count.var()], 4.0, rtol=0.06)
    assert (valid == (np.arange(12) < count[:, None])).all()


def test_a_full_scan_is_cut_at_the_capacity():
    _, valid = samples(UNIFORM._replace(rate=100.0))
    assert np.asarray(valid).all()


def test_gradients_are_finite_and_right():
    @jax.jit
    def slope(rate, detection):
        def total(rate, detection):
            polar = POLAR._replace(rate=rate).log_density(detection)
            uniform = UNIFORM._replace(rate=rate).log_density(detection)
            return jnp.where(rate > 0, polar + uniform, 0.0)

        return jax.grad(total, (0, 1))(rate, detection)

    # (100, -HEADING) lies inside the polar box, but not the uniform one.
    by_rate, by_detection = slope(4.0, np.array([100.0, -HEADING]))
    np.testing.assert_allclose(by_rate, 1 / 4)
    np.testing.assert_allclose(by_detection, [1 / 100, 0])
    for rate, detection in ((0.0, [100.0, 0.0]), (4.0, [0.0, 0.0])):
        got = slope(rate, np.array(detection))
        assert all(np.isfinite(leaf).all() for leaf in got)
