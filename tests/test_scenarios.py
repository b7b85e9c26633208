"""Tests of the published scenarios: the truth, what the sensor sees, the table."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import scenarios
from jaxtrack.models import clutter, motion, probability, sensor
from jaxtrack.scenarios import turning_aircraft, world, yuan2013

NAMES = sorted(set(scenarios.MAKERS) - {"two-sensors"})  # of one sensor


@functools.cache
def simulated(name, runs=40):
    """Scans of many runs, and the scenario."""
    scenario = scenarios.make(name)
    keys = jax.random.split(jax.random.key(0), runs)
    return scenario, jax.jit(jax.vmap(lambda key: scenario.simulate(key)[1]))(keys)


def test_targets_of_yuan_are_born_and_die_as_in_table_1():
    exists = np.array(yuan2013.truth().exists)
    seconds = [(np.flatnonzero(there)[[0, -1]] + 1).tolist() for there in exists.T]
    assert seconds == [[1, 30], [1, 35], [10, 42], [20, 50]]


def test_targets_of_yuan_turn_at_their_rates_and_keep_to_the_region():
    truth = yuan2013.truth()
    state, exists = np.array(truth.state), np.array(truth.exists)
    assert np.abs(state[exists][:, [0, 2]]).max() < yuan2013.REGION
    heading = np.unwrap(np.arctan2(state[:, :, 3], state[:, :, 1]), axis=0)
    turned = np.diff(heading, axis=0)
    # Seconds 15 and 16 of target 1, 20 and 21 of 2, 30 and 31 of 3 and 4.
    for n, last, rates in (
        (0, 15, (0, np.pi / 20)),
        (1, 20, (np.pi / 30, 0)),
        (2, 30, (np.pi / 15, 0)),
        (3, 30, (0, -np.pi / 30)),
    ):
        np.testing.assert_allclose(turned[last - 2 : last, n], rates, atol=1e-12)


def test_targets_of_yuan_start_where_they_may_be_born():
    truth = yuan2013.truth()
    for n, place in enumerate((0, 1, 2, 0)):
        first = int(np.argmax(truth.exists[:, n]))
        start = truth.state[first, n, jnp.array([0, 2])]
        np.testing.assert_allclose(start, yuan2013.BIRTH_PLACES[place])


def test_aircraft_fly_west_south_west_and_keep_their_distance():
    truth = turning_aircraft.truth(5.0)
    velocity = np.array(truth.state[:, :, [1, 3]])
    for k, direction in ((0, (-1, 0)), (25, (-1, 0)), (50, (0, -1)), (99, (-1, 0))):
        expected = turning_aircraft.SPEED * np.array([direction] * 3)
        np.testing.assert_allclose(velocity[k], expected, atol=1e-9)
    place = np.array(truth.state[:, :, [0, 2]])
    gap = np.linalg.norm(place[:, 1] - place[:, 0], axis=1)
    np.testing.assert_allclose(gap, 1000.0)
    assert (place > turning_aircraft.REGION_LOW).all()
    assert (place < turning_aircraft.REGION_HIGH).all()


def test_aircraft_fly_the_same_path_at_any_interval():
    rough, fine = (turning_aircraft.truth(step) for step in (10.0, 1.0))
    np.testing.assert_allclose(rough.state, fine.state[::10][:50], atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_number_of_detections_is_as_expected(name):
    scenario, scans = simulated(name)
    truth = np.array(scenario.world.truth.exists).sum(1)
    detected = scenario.world.detect.prob(0, scenario.world.truth.state[0, 0], 0.0)
    expected = scenario.world.clutter.rate + detected * truth
    spread = np.sqrt((scenario.world.clutter.rate + 1) * 50 / scans.valid[..., 0].size)
    found = scans.valid.sum(2).mean()
    assert abs(found - expected.mean()) < 4 * spread
    if scenario.world.clutter.rate > 0:
        assert not scans.valid[..., -1].any()  # the capacity is never reached
    assert (scans.interval > 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_detections_scatter_around_the_truth(name):
    scenario, scans = simulated(name)
    seen, model = scenario.world, scenario.world.sensor
    state = seen.truth.state[25, -1]
    expected = model.measure(state[jnp.array([0, 2])], state[jnp.array([1, 3])])
    cov = (model.at(expected) if hasattr(model, "at") else model).cov()
    error = (
        jax.vmap(jax.vmap(model.residual, (0, None)), (0, None))(
            scans.detections[:, 25], expected
        )
        / jnp.sqrt(jnp.diagonal(cov))[None, None]
    )
    distance = jnp.linalg.norm(error, axis=-1)
    nearest = jnp.where(scans.valid[:, 25], distance, jnp.inf).min(1)
    # The length of two standard normal errors has the median 1.18.
    assert 0.7 < jnp.median(nearest) < 1.7


def test_each_of_two_sensors_sees_its_own_disc():
    scenario = scenarios.make("two-sensors", clutter_rate=0.0)
    keys = jax.random.split(jax.random.key(0), 20)
    simulate = jax.jit(jax.vmap(lambda key: scenario.simulate(key)[1]))
    scans, seen = simulate(keys), scenario.world
    first = jax.tree.map(lambda x: x[0], scans)
    places = jax.eval_shape(lambda x: world.shown(x, seen.sensor), first)
    assert places.detections.shape == (60, 2 * scenario.max_detections, 2)
    for k, (scan, own) in enumerate(zip(scans.each, seen.detect, strict=True)):
        prob = jax.jit(jax.vmap(jax.vmap(lambda x, own=own: own.prob(0, x, 0.0))))
        expected = jnp.where(seen.truth.exists, prob(seen.truth.state), 0.0).sum()
        found = scan.valid.sum() / len(keys)
        assert abs(found - expected) < 4 * jnp.sqrt(expected / len(keys))
        where = jax.jit(jax.vmap(lambda z, k=k: seen.sensor[k].locate(z).mean))
        away = where(scan.detections[scan.valid]) - own.centre[None]
        assert jnp.linalg.norm(away, axis=1).max() < own.radius + 200.0


def test_a_target_without_noise_is_seen_where_it_is():
    truth = world.Truth(
        jnp.arange(8.0).reshape(2, 1, 4), jnp.array([[True], [False]]), jnp.arange(2.0)
    )
    scans = jax.jit(world.observe, static_argnums=6)(
        jax.random.key(0),
        truth,
        motion.ConstantVelocity(jnp.ones(2)),
        sensor.Position(jnp.full(2, 1e-9)),
        probability.Constant(jnp.array(1.0)),
        clutter.UniformClutter(jnp.array(0.0), jnp.zeros(2), jnp.ones(2)),
        3,
    )
    np.testing.assert_allclose(scans.detections[0, 0], [0.0, 2.0], atol=1e-7)
    np.testing.assert_array_equal(scans.valid, [[1, 0, 0], [0, 0, 0]])


def test_targets_are_kept_when_clutter_overflows():
    scenario = scenarios.make("yuan2013-linear", detect_prob=1.0)
    full = jax.jit(lambda key: world.observe(key, *scenario.world, 5))
    scans = full(jax.random.key(0))
    place = scenario.world.truth.state[0, :2, jnp.array([0, 2])].T
    np.testing.assert_allclose(scans.detections[0, :2], place, atol=5 * 8)


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("yuan2013", {}, "no scenario is called 'yuan2013'; there are"),
        ("yuan2013-linear", {"cluter_rate": 3}, "no setting 'cluter_rate'; it has"),
    ],
)
def test_unknown_names_are_told(name, settings, message):
    with pytest.raises(ValueError, match=message):
        scenarios.make(name, **settings)
