"""The filter of known targets against every association history, one by one."""

import functools
import itertools
import types

import jax
import numpy as np
import pytest
from reference import kalman as book
from reference.mixture import moment_match

from jaxtrack import engine, models, targets
from jaxtrack.trackers import hypotheses, single_scan
from jaxtrack.types import Scan

SCANS, SLOTS, DETECT, RATE, WIDTH = 3, 2, 0.8, 1.0, 40.0
START = np.array([[0.0, 1.0], [3.0, -1.0]])
COVS = np.array([[[4.0, 1.0], [1.0, 2.0]], [[3.0, 0.0], [0.0, 1.0]]])


def array(*values):
    return np.array(values, float)


def line_params():
    return single_scan.Params(
        target=targets.single.Params(
            motion=models.motion.ConstantVelocity(array(0.7)),
            sensor=models.sensor.Position(array(1.1)),
            survive=models.probability.Constant(np.array(1.0)),
            detect=models.probability.Constant(np.array(DETECT)),
        ),
        birth=None,
        clutter=models.clutter.UniformClutter(
            np.array(RATE), array(-WIDTH / 2), array(WIDTH / 2)
        ),
        start=models.birth.MultiBernoulliBirth(
            np.ones(2), START, COVS, np.ones((2, 1))
        ),
    )


def scans():
    rng = np.random.default_rng(2)
    points = np.array([[0.5, 2.5], [1.4, 1.2], [2.0, 0.1]])[..., None]
    valid = np.array([[True, True], [True, True], [True, False]])
    return Scan(points + 0.1 * rng.normal(size=points.shape), valid, array(1, 0.5, 1))


@functools.cache
def ran(**choices):
    tracker = hypotheses.hypotheses(targets.single.single(), **choices)
    run = jax.jit(functools.partial(engine.run, tracker))
    return jax.tree.map(np.array, run(line_params(), scans(), jax.random.key(0)))


def every_history():
    """Weight and beliefs of all histories after each scan."""
    params = line_params().target
    branches, rows = [(1.0, [(START[n], COVS[n]) for n in range(2)])], []
    sensor = types.SimpleNamespace(H=np.array([[1.0, 0.0]]), R=np.eye(1) * 1.1**2)
    for points, valid, interval in zip(*scans(), strict=True):
        F = np.array(params.motion.transition(interval))
        Q = np.array(params.motion.noise(interval))
        grown = []
        for weight, pair in branches:
            moved = [book.predict(m, P, F, 0, Q) for m, P in pair]
            for event in itertools.product((-1, *np.flatnonzero(valid)), repeat=2):
                hits = [k for k in event if k >= 0]
                if len(set(hits)) < len(hits):
                    continue
                clutter = (RATE / WIDTH) ** (valid.sum() - len(hits))
                new, after = weight * clutter * np.exp(-RATE), []
                for k, (m, P) in zip(event, moved, strict=True):
                    if k < 0:
                        new *= 1 - DETECT
                    else:
                        m, P, log_g = book.update(
                            m, P, sensor.H, 0, sensor.R, points[k]
                        )
                        new *= DETECT * np.exp(log_g)
                    after.append((m, P))
                grown.append((new, after))
        branches = grown
        rows.append(branches)
    return rows


def test_with_room_for_all_it_is_exact():
    estimates, before = ran(max_hypotheses=400, max_events=10), 1.0
    for t, branches in enumerate(every_history()):
        total = sum(w for w, _ in branches)
        np.testing.assert_allclose(
            estimates.log_evidence[t], np.log(total / before), rtol=1e-10
        )
        before = total
        for n in range(2):
            pool = [(w, *pair[n]) for w, pair in branches]
            mean, cov = moment_match(pool)
            np.testing.assert_allclose(estimates.mean[t, n], mean, rtol=1e-9)
            np.testing.assert_allclose(estimates.cov[t, n], cov, rtol=1e-9)
    np.testing.assert_allclose(estimates.dropped, 0, atol=1e-12)  # a sum less itself


def test_the_best_is_the_heaviest_history():
    estimates = ran(max_hypotheses=400, max_events=10, report="best")
    for t, branches in enumerate(every_history()):
        _, pair = max(branches, key=lambda x: x[0])
        np.testing.assert_allclose(estimates.mean[t], [m for m, _ in pair], rtol=1e-9)


def test_what_finds_no_room_is_said():
    tight = ran(max_hypotheses=3, max_events=10)
    branches = every_history()[0]
    weights = np.sort([w for w, _ in branches])[::-1]
    lost = 1 - weights[:3].sum() / weights.sum()
    np.testing.assert_allclose(tight.dropped[0], 2 * lost, rtol=1e-9)
    few = ran(max_hypotheses=400, max_events=2)
    assert (few.dropped > 0).all()


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"max_hypotheses": 0}, "max_hypotheses is 0"),
        ({"max_events": 0}, "max_events is 0"),
        ({"report": "median"}, "report is 'median'"),
        ({"gate_prob": 0.0}, "gate_prob is 0.0"),
    ],
)
def test_settings_that_make_no_sense(choice, message):
    with pytest.raises(ValueError, match=message):
        hypotheses.hypotheses(targets.single.single(), **choice)


def test_targets_must_be_known():
    tracker = hypotheses.hypotheses(targets.single.single())
    with pytest.raises(ValueError, match="start is None"):
        tracker.init(line_params()._replace(start=None), jax.random.key(0))
