"""Tests of `trackers.rmm_mht` against a Kalman filter, and of what it tells."""

import functools

import jax
import numpy as np
import pytest
from cases.randomized import NOISE, H, R, matrices, params
from reference import kalman as book

from jaxtrack.models import birth, motion, probability, sensor
from jaxtrack.trackers import rmm_mht
from jaxtrack.types import Scan

pytestmark = pytest.mark.usefixtures("whole_matrices")


def start_of(mean, prob=1.0):
    num = len(mean)
    return birth.MultiBernoulliBirth(
        np.full(num, prob),
        np.array(mean, float),
        np.tile(np.diag([1.0, 0.5, 1.0, 0.5]), (num, 1, 1)),
        np.full((num, 2), 0.5),
    )


ROOM = {
    "max_tracks": 4,
    "max_leaves": 12,
    "max_detections": 5,
    "max_contested": 4,
    "max_new": 2,
    "gate_prob": 1.0,
}


@functools.cache
def runner(**settings):
    tracker = rmm_mht.rmm_mht(**{**ROOM, **settings})

    def run(params, scans):
        state = tracker.init(params, jax.random.key(0))
        step = functools.partial(tracker.step, params)
        return jax.lax.scan(lambda s, x: step(s, x), state, scans)[1]

    return jax.jit(run)


def far_scans(rng, num, seen):
    """Two targets so far apart that nothing is shared."""
    time = np.arange(1, num + 1)[:, None]
    paths = [np.array([-20.0, 10.0]) + time * 0.5, np.array([15.0, -12.0]) - time * 0.3]
    detections = np.stack(paths, 1) + rng.normal(size=(num, 2, 2)) * NOISE
    return Scan(detections, np.array(seen), np.ones(num))


def test_a_single_model_far_apart_is_a_kalman_filter():
    """One model of each scan is right, and no detection is doubtful."""
    rng = np.random.default_rng(3)
    seen = [[1, 1], [1, 0], [1, 1], [0, 1], [1, 1]]
    scans = far_scans(rng, 5, np.array(seen) > 0)
    start = start_of([[-20.0, 0.5, 10.0, 0.5], [15.0, -0.3, -12.0, -0.3]])
    given = params(start, clutter_rate=1e-3)
    alike = given.target.motions[:1] * 2
    target = given.target._replace(
        motions=alike,
        survive=probability.Constant(1.0),
        detect=probability.Constant(0.9),
    )
    births = given.birth._replace(rate=np.array(1e-9))
    given = given._replace(target=target, birth=births)
    found = runner()(given, scans)
    F, Q = matrices(1.0)[0]
    evidence = -5 * (1e-3 + 1e-9)
    for n in range(2):
        m, P = start.mean[n], start.cov[n]
        for t in range(5):
            m, P = book.predict(m, P, F, np.zeros(4), Q)
            evidence += np.log(0.9 if seen[t][n] else 0.1)
            if seen[t][n]:
                m, P, log_density = book.update(
                    m, P, H, np.zeros(2), R, scans.detections[t, n]
                )
                evidence += log_density
            np.testing.assert_allclose(found.mean[t, n], m, rtol=1e-9)
            np.testing.assert_allclose(found.cov[t, n], P, rtol=1e-9, atol=1e-12)
    assert found.exists[:, :2].all()
    assert found.integral.all()
    np.testing.assert_allclose(found.log_evidence.sum(), evidence, rtol=1e-9)


def run_in_turn(params, sensors, detects, scans):
    """Every scan has its own sensor and detection."""
    tracker = rmm_mht.rmm_mht(**ROOM)

    def step(state, now):
        sensor, detect, scan = now
        target = params.target._replace(sensor=sensor, detect=detect)
        return tracker.step(params._replace(target=target), state, scan)

    first = jax.tree.map(lambda x: x[0], (sensors, detects))
    target = params.target._replace(sensor=first[0], detect=first[1])
    state = tracker.init(params._replace(target=target), jax.random.key(0))
    return jax.lax.scan(step, state, (sensors, detects, scans))[1]


@pytest.mark.slow
def test_two_radars_in_turn_are_an_extended_kalman_filter():
    """Detections have ages, and what was seen before keeps its own radar."""
    rng = np.random.default_rng(6)
    num, seen = 6, [1, 1, 0, 1, 0, 1]
    noise_std = np.tile([[0.5, 0.01], [0.8, 0.02]], (3, 1))
    place = np.tile([[0.0, 0.0], [80.0, 10.0]], (3, 1))
    prob = np.tile([0.9, 0.7], 3)
    ages = np.array([0.0, 0.2, 0.1, 0.0, 0.3, 0.4])
    start = start_of([[40.0, 1.0, 30.0, -1.0]])
    given = params(start, clutter_rate=1e-3)
    target = given.target._replace(
        motions=given.target.motions[:1] * 2, survive=probability.Constant(1.0)
    )
    low, high = np.array([0.0, -np.pi]), np.array([200.0, np.pi])
    given = given._replace(
        target=target,
        birth=given.birth._replace(rate=np.array(1e-9)),
        clutter=given.clutter._replace(low=low, high=high),
    )
    path = np.array([40.0, 30.0]) + np.arange(1, num + 1)[:, None] * [1.0, -1.0]
    off = path - place
    polar = np.stack([np.hypot(*off.T), np.arctan2(*off.T[::-1])], 1)
    polar = polar + rng.normal(size=(num, 2)) * noise_std
    detections = np.concatenate([polar, ages[:, None]], 1)[:, None]
    scans = Scan(detections, np.array(seen)[:, None] > 0, np.ones(num))
    radars = sensor.Timed(sensor.RangeBearing(noise_std, place, np.zeros(num)))
    found = jax.jit(run_in_turn)(given, radars, probability.Constant(prob), scans)
    F, Q = matrices(1.0)[0]
    m, P = start.mean[0], start.cov[0]
    evidence = -num * (1e-3 + 1e-9)
    for t in range(num):
        m, P = book.predict(m, P, F, np.zeros(4), Q)
        evidence += np.log(prob[t] if seen[t] else 1 - prob[t])
        if seen[t]:
            x, y = H @ m - ages[t] * m[[1, 3]] - place[t]
            r = np.hypot(x, y)
            slope = np.array([[x / r, y / r], [-y / r**2, x / r**2]])
            J = slope @ (H - ages[t] * np.eye(4)[[1, 3]])
            offset = np.array([r, np.arctan2(y, x)]) - J @ m
            noise = np.diag(noise_std[t] ** 2)
            m, P, log_density = book.update(m, P, J, offset, noise, polar[t])
            evidence += log_density
        np.testing.assert_allclose(found.mean[t, 0], m, rtol=1e-9)
        np.testing.assert_allclose(found.cov[t, 0], P, rtol=1e-9, atol=1e-12)
    assert found.exists[:, 0].all()
    np.testing.assert_allclose(found.log_evidence.sum(), evidence, rtol=1e-8)


def test_a_target_without_models_is_refused():
    given = params()
    given = given._replace(target=given.target.sensor)
    with pytest.raises(ValueError, match="target has no motions; give targets.imm"):
        rmm_mht.rmm_mht(**ROOM).init(given, jax.random.key(0))


def test_missed_targets_go_and_empty_scans_are_harmless():
    start = start_of([[-20.0, 0.5, 10.0, 0.5], [15.0, -0.3, -12.0, -0.3]])
    seen = np.array([[1, 1], [1, 1], [0, 1], [0, 1], [0, 1], [0, 0]]) > 0
    found = runner()(params(start), far_scans(np.random.default_rng(1), 6, seen))
    here = (found.label == 0).any(1)
    # Missed in the third scan for the first time, and decided a scan later.
    np.testing.assert_array_equal(here, [True] * 5 + [False])
    assert (found.label == 1).any(1).all()
    prob = np.where(found.label == 0, found.existence_prob, 0).sum(1)
    assert (np.diff(prob[1:]) < 0).all()
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.log_evidence).all()


def test_a_new_target_is_found_and_reported():
    given = params()
    given = given._replace(birth=given.birth._replace(rate=np.array(0.5)))
    time = np.arange(1, 7)[:, None]
    path = np.array([-5.0, 4.0]) + time * np.array([1.0, -0.5])
    noise = np.random.default_rng(2).normal(size=(6, 1, 2)) * 0.5
    scans = Scan(path[:, None] + noise, np.ones((6, 1), bool), np.ones(6))
    found = runner()(given, scans)
    assert found.exists.sum(1).tolist()[0] == 0
    assert found.exists.sum(1).tolist()[3:] == [1, 1, 1]
    last = found.mean[-1][np.asarray(found.exists[-1])][0]
    np.testing.assert_allclose(last, [1.0, 1.0, 1.0, -0.5], atol=1.5)  # two deviations


@pytest.mark.slow
def test_gradients_equal_differences_where_the_programme_is_integral():
    rng = np.random.default_rng(4)
    start = start_of([[-20.0, 0.5, 10.0, 0.5], [15.0, -0.3, -12.0, -0.3]], 0.9)
    scans = far_scans(rng, 4, np.ones((4, 2)) > 0)
    run, given = runner(), params(start)
    assert run(given, scans).integral.all()

    @jax.jit
    def log_evidence(noise, detect, rate, density, exists):
        motions = tuple(motion.ConstantVelocity(density * np.ones(2)) for _ in "ab")
        target = given.target._replace(
            motions=motions,
            sensor=sensor.Position(noise * np.ones(2)),
            detect=probability.Constant(detect),
        )
        false = given.clutter._replace(rate=rate)
        known = start._replace(existence_prob=exists * np.ones(2))
        changed = given._replace(target=target, clutter=false, start=known)
        return run(changed, scans).log_evidence.sum()

    slopes = jax.jit(jax.grad(log_evidence, (0, 1, 2, 3, 4)))
    at = np.array([1.1, 0.9, 2.0, 0.4, 0.9])
    slope = np.array(slopes(*at))
    for k, size in enumerate(1e-5 * at):
        ahead, behind = (log_evidence(*(at + s * size * np.eye(5)[k])) for s in (1, -1))
        np.testing.assert_allclose(slope[k], (ahead - behind) / (2 * size), rtol=1e-6)
    assert np.isfinite(slopes(*at[:4], 1.0)).all()  # nothing but detections is open


def test_room_that_runs_out_is_told():
    start = start_of([[0.0, 0, 0, 0], [3.0, 0, 0, 0], [0.0, 0, 3.0, 0]])
    crowd = np.random.default_rng(0).normal(size=(4, 9, 2)) * 2
    scans = Scan(crowd, np.ones((4, 9), bool), np.ones(4))
    found = runner()(params(start), scans)
    assert (found.dropped >= 4).all()  # detections beyond the five that find room
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.log_evidence).all()


@pytest.mark.parametrize(
    ("setting", "value", "told"),
    [
        ("num_scans", 0, "num_scans is 0; give at least 1"),
        ("max_misses", 0, "max_misses is 0; give at least 1"),
        ("max_leaves", 1, "max_leaves is 1; give at least 2"),
        ("worth", 1.0, "worth is 1.0; give a probability between 0 and 1"),
        ("missed_prob", 2.0, "missed_prob is 2.0; give a probability"),
        ("gate_prob", 0.0, "gate_prob is 0.0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting, value, told):
    with pytest.raises(ValueError, match=told):
        rmm_mht.rmm_mht(**{setting: value})


def test_more_known_targets_than_room_are_refused():
    tracker = rmm_mht.rmm_mht(**{**ROOM, "max_tracks": 1})
    given = params(start_of(np.zeros((2, 4))))
    with pytest.raises(ValueError, match="start has 2 targets and max_tracks is 1"):
        tracker.init(given, jax.random.key(0))
