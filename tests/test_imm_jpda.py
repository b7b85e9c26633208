"""IMM-JPDA: with one mode it is JPDA, with targets far apart it is one IMM for each."""

import functools
import types

import jax
import numpy as np
import pytest
from reference import imm as book

from jaxtrack import engine, models, targets
from jaxtrack.targets import blending, likely_modes
from jaxtrack.trackers import jpda, single_scan
from jaxtrack.types import Scan

SCANS, STD = 8, 1.5
SPEEDS = np.array([[2.0, -1.0], [-1.5, 0.5]])
SWITCHING = np.array([[0.9, 0.1], [0.3, 0.7]])
INTERVALS = np.array([1.0, 0.5, 1.5, 1.0, 0.7, 1.2, 1.0, 0.8])


def array(*values):
    return np.array(values, float)


def start(apart, num_modes):
    mean = np.array([[0.0, 2.0, 0.0, -1.0], [apart, -1.5, apart, 0.5]])
    cov = np.tile(np.diag([4.0, 1.0, 4.0, 1.0]), (2, 1, 1))
    modes = np.full((2, num_modes), 1 / num_modes)
    return models.birth.MultiBernoulliBirth(np.ones(2), mean, cov, modes)


def bank_params(densities, detect):
    many = len(densities) > 1
    return targets.imm.Params(
        motions=tuple(models.motion.ConstantVelocity(np.full(2, q)) for q in densities),
        switching=models.switching.MarkovSwitching(
            SWITCHING if many else np.ones((1, 1))
        ),
        sensor=models.sensor.Position(np.full(2, STD)),
        survive=models.probability.Constant(np.array(1.0)),
        detect=models.probability.Constant(np.array(detect)),
    )


def tracker_params(target_params, apart, rate, num_modes):
    low, high = np.full(2, -100.0), np.full(2, apart + 100.0)
    falls = models.clutter.UniformClutter(np.array(rate), low, high)
    return single_scan.Params(target_params, None, falls, start(apart, num_modes))


def scans(apart):
    rng = np.random.default_rng(0)
    time = INTERVALS.cumsum()[:, None, None]
    place = np.array([[0.0, 0.0], [apart, apart]]) + time * SPEEDS
    points = place + STD * rng.normal(size=(SCANS, 2, 2))
    clutter = place.mean(1, keepdims=True) + 4 * rng.normal(size=(SCANS, 2, 2))
    return Scan(
        np.concatenate([points, clutter], 1), np.ones((SCANS, 4), bool), INTERVALS
    )


@functools.cache
def runner(target):
    tracker = jpda.jpda(target, max_tracks=2, gate_prob=1.0)
    return jax.jit(functools.partial(engine.run, tracker))


def ran(target, params, seen):
    found = jax.tree.map(np.array, runner(target)(params, seen, jax.random.key(0)))
    np.testing.assert_array_equal(np.sort(found.label, 1), [[0, 1]] * SCANS)
    order = np.argsort(found.label, 1)
    pick = jax.tree.map(
        lambda x: np.array([x[t][order[t]] for t in range(SCANS)]),
        (found.mean, found.cov, found.mode_prob),
    )
    return (*pick, found.log_evidence)


@pytest.mark.parametrize("way", [blending.by_mixture, blending.by_residual])
def test_with_one_mode_it_is_jpda(way):
    seen, apart = scans(6.0), 6.0
    bank = bank_params([0.4], 0.9)
    plain = targets.single.Params(
        bank.motions[0], bank.sensor, bank.survive, bank.detect
    )
    one = ran(targets.single.single(), tracker_params(plain, apart, 1.0, 1), seen)
    other = ran(targets.imm.imm(blend=way), tracker_params(bank, apart, 1.0, 1), seen)
    for expected, found in zip(one, other, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)  # near zero


@pytest.mark.parametrize("way", [blending.by_mixture, blending.by_residual])
def test_far_apart_it_is_an_imm_for_each(way):
    apart = 500.0
    seen = scans(apart)
    seen = seen._replace(valid=seen.valid & np.array([True, True, False, False]))
    params = bank_params([0.1, 9.0], 0.95)
    mean, cov, modes, _ = ran(
        targets.imm.imm(blend=way), tracker_params(params, apart, 0.0, 2), seen
    )
    begun = start(apart, 2)
    for n in range(2):
        bank = (
            array(0.5, 0.5),
            np.stack([begun.mean[n]] * 2),
            np.stack([begun.cov[n]] * 2),
        )
        for t in range(SCANS):
            model = types.SimpleNamespace(
                F=[np.array(m.transition(INTERVALS[t])) for m in params.motions],
                Q=[np.array(m.noise(INTERVALS[t])) for m in params.motions],
                H=np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]]),
                R=STD**2 * np.eye(2),
                p=SWITCHING,
                survive=np.ones(2),
                detect=np.full(2, 0.95),
            )
            bank, _ = book.predict(model, bank)
            bank, _ = book.correct(model, bank, seen.detections[t, n])
            mu, m, P = bank
            centre = mu @ m
            spread = sum(
                w * (S + np.outer(x - centre, x - centre))
                for w, x, S in zip(mu, m, P, strict=True)
            )
            np.testing.assert_allclose(modes[t, n], mu, rtol=1e-8)
            np.testing.assert_allclose(mean[t, n], centre, rtol=1e-8)
            np.testing.assert_allclose(
                cov[t, n], spread, rtol=1e-7, atol=1e-10
            )  # zeros


def test_likely_modes_that_are_all_active_are_the_imm():
    apart, seen = 6.0, scans(6.0)
    params = bank_params([0.1, 9.0], 0.9)
    all_active = likely_modes.Params(*params, np.array(0.0), np.array(0.9))
    bank = targets.imm.imm(blend=blending.by_mixture)
    one = ran(bank, tracker_params(params, apart, 1.0, 2), seen)
    other = ran(
        likely_modes.likely_modes(), tracker_params(all_active, apart, 1.0, 2), seen
    )
    for expected, found in zip(one, other, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)  # near zero
