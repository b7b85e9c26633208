"""PHD and CPHD filters in a field of view, with births that nobody foresaw."""

import functools

import jax
import numpy as np
import pytest

from jaxtrack.models import birth, clutter, motion, probability, sensor
from jaxtrack.targets import single
from jaxtrack.trackers import cphd, phd
from jaxtrack.types import Scan

SCANS, SLOTS = 40, 12
RADIUS = 100.0
# One crosses the disc of view, one is born in the middle of it after 15 s.
CROSSING = np.array([[-180.0 + 9.0 * t, 20.0] for t in range(SCANS)])
INSIDE = np.array([[10.0, -40.0 + 2.0 * t] for t in range(SCANS)])


def params(maker):
    area = np.full(2, 200.0)
    target = single.Params(
        motion=motion.ConstantVelocity(np.full(2, 0.1)),
        sensor=sensor.Position(np.full(2, 2.0)),
        survive=probability.Constant(np.array(0.99)),
        detect=probability.InsideDisc(
            np.array(0.9), np.zeros(2), np.array(RADIUS), np.array(2.0)
        ),
    )
    births = birth.DetectionBirth(
        rate=np.array(0.05),
        max_existence_prob=np.array(0.05),
        velocity_std=np.full(2, 8.0),
        extra_std=np.zeros(0),
        mode_prob=np.ones(1),
    )
    falls = clutter.UniformClutter(np.array(3.0), -area, area)
    return maker(target, births, falls)


def simulate(seed):
    """Nobody is seen outside the disc; clutter is everywhere."""
    rng = np.random.default_rng(seed)
    detections = rng.uniform(-200, 200, (SCANS, SLOTS, 2))
    valid = np.zeros((SCANS, SLOTS), bool)
    for t in range(SCANS):
        valid[t, : min(rng.poisson(3.0), SLOTS - 2)] = True
        for slot, (path, since) in enumerate([(CROSSING, 0), (INSIDE, 15)], SLOTS - 2):
            there = t >= since and np.hypot(*path[t]) < RADIUS
            if there and rng.random() < 0.9:
                detections[t, slot] = path[t] + rng.normal(size=2) * 2.0
                valid[t, slot] = True
    return Scan(detections, valid, np.ones(SCANS))


@functools.cache
def tracked(maker):
    """Twenty runs: what was reported, and the gradient of the evidence."""
    module = {"phd": phd, "cphd": cphd}[maker]
    tracker = getattr(module, maker)(single.single(), max_components=20)

    def evidence(values, scans):
        state = tracker.init(values, jax.random.key(0))
        _, told = jax.lax.scan(functools.partial(tracker.step, values), state, scans)
        return told.log_evidence.sum(), told

    run = jax.jit(jax.vmap(jax.grad(evidence, has_aux=True), (None, 0)))
    many = [simulate(seed) for seed in range(20)]
    return run(params(module.Params), jax.tree.map(lambda *x: np.stack(x), *many))


@pytest.mark.parametrize("maker", ["phd", "cphd"])
def test_everything_stays_finite(maker):
    for leaf in jax.tree.leaves(tracked(maker)):
        assert np.isfinite(leaf).all()


@pytest.mark.parametrize("maker", ["phd", "cphd"])
def test_who_is_in_view_is_found_and_who_is_not_is_not_forgotten_at_once(maker):
    _, told = tracked(maker)
    place, exists = np.array(told.mean)[..., ::2], np.array(told.exists)

    def found(path, times):
        near = np.linalg.norm(place[:, times] - path[None, times, None], axis=-1) < 15
        return (near & exists[:, times]).any(-1).mean()

    assert found(INSIDE, np.arange(19, SCANS)) > 0.8
    assert found(CROSSING, np.arange(13, 30)) > 0.8
    # Beyond the rim a miss says nothing: it is expected for as long as it may live.
    assert found(CROSSING, np.arange(33, 36)) > 0.5
    reported = exists.sum(-1)
    assert reported[:, :8].mean() < 0.35
    assert abs(reported[:, 22:28].mean() - 2) < 0.4
