"""The association family against sums over all events, and what the family shares."""

import functools
import types

import jax
import numpy as np
import pytest
from reference import association as book

from jaxtrack import models, targets
from jaxtrack.trackers import jpda, pda, single_scan
from jaxtrack.types import Gaussian, Scan

KEY = jax.random.key(0)
DETECTIONS = np.array([[0.3], [2.0], [1.1], [9.0]])
PRIOR = Gaussian(
    np.array([[0.0, 1.0], [2.0, -1.0], [0.8, 0.2]]),
    np.array([np.eye(2), [[2.0, 0.5], [0.5, 1.0]], [[1.0, -0.3], [-0.3, 2.0]]]),
)
EXISTS = np.array([0.9, 0.4, 0.75])
INTERVAL = 0.5


def array(*values):
    return np.array(values, float)


def line_params(survive=0.95, detect=0.8):
    return single_scan.Params(
        target=targets.single.Params(
            motion=models.motion.ConstantVelocity(array(0.7)),
            sensor=models.sensor.Position(array(0.9)),
            survive=models.probability.Constant(np.array(survive)),
            detect=models.probability.Constant(np.array(detect)),
        ),
        birth=None,
        clutter=models.clutter.UniformClutter(np.array(2.0), array(-10), array(10)),
        start=starting(EXISTS),
    )


def starting(existence_prob):
    num = len(existence_prob)
    prior = jax.tree.map(lambda x: x[:num], PRIOR)
    return models.birth.MultiBernoulliBirth(existence_prob, *prior, np.ones((num, 1)))


def line_model(params):
    motion, sensor = params.target.motion, params.target.sensor
    return types.SimpleNamespace(
        F=np.array(motion.transition(INTERVAL)),
        Q=np.array(motion.noise(INTERVAL)),
        H=np.array([[1.0, 0.0]]),
        R=np.array(sensor.cov()),
        survive=float(params.target.survive.value),
        detect=float(params.target.detect.value),
    )


def once(tracker, params, valid):
    """The estimate of one scan."""

    @jax.jit
    def run(params):
        scan = Scan(DETECTIONS, valid, np.array(INTERVAL))
        return tracker.step(params, tracker.init(params, KEY), scan)[1]

    return jax.tree.map(np.array, run(params))


@functools.cache
def stepped(maker, num=3, survive=0.95, detect=0.8, certain=False, **choices):
    """One scan of three tracks seeded with given existence, and the sum over events."""
    params = line_params(survive, detect)
    target = targets.single.single()
    tracker = maker(target, max_tracks=4, gate_prob=1.0, **choices)
    exists = np.ones(num) if certain else EXISTS[:num]
    valid = np.array([True, True, True, False])
    params = params._replace(start=starting(exists))
    estimate = once(tracker, params, valid)
    tracks = list(zip(exists, *params.start[1:3], strict=True))
    expected = book.step(
        tracks, line_model(params), DETECTIONS[:3], np.full(3, 2.0 / 20), 2.0
    )
    return estimate, expected


def assert_as_summed(estimate, expected, order):
    density, tracks = expected
    np.testing.assert_allclose(estimate.log_evidence, np.log(density), rtol=1e-10)
    for slot, n in enumerate(order):
        r, mean, cov, cause = tracks[n]
        assert estimate.label[slot] == n
        np.testing.assert_allclose(estimate.existence_prob[slot], r, rtol=1e-10)
        np.testing.assert_allclose(estimate.mean[slot], mean, rtol=1e-9)
        np.testing.assert_allclose(estimate.cov[slot], cov, rtol=1e-9)
        found = estimate.association_prob[slot]
        np.testing.assert_allclose(found[:3], cause[1:], rtol=1e-9)
        assert found[3] == 0  # not valid
        np.testing.assert_allclose(found.sum(), 1, rtol=1e-12)


def test_jipda_is_the_sum_over_all_events():
    estimate, expected = stepped(jpda.jipda)
    order = np.argsort([-r for r, *_ in expected[1]])
    assert_as_summed(estimate, expected, order)
    assert estimate.exact[:3].all()


def test_jpda_is_the_sum_over_all_events_of_targets_that_exist():
    estimate, expected = stepped(jpda.jpda, survive=1.0, certain=True)
    assert_as_summed(estimate, expected, range(3))


@pytest.mark.parametrize("max_events", [400])
def test_enough_likeliest_events_are_all(max_events):
    estimate, expected = stepped(jpda.jipda, max_events=max_events)
    order = np.argsort([-r for r, *_ in expected[1]])
    assert_as_summed(estimate, expected, order)


def test_one_track_alone_is_pda_and_ipda():
    assert_as_summed(*stepped(pda.ipda, num=1), [0])
    assert_as_summed(*stepped(pda.pda, num=1, survive=1.0, certain=True), [0])


def test_existence_of_a_track_taken_for_certain():
    """The likelihood ratio of all events with it to all without it."""
    params = line_params()
    estimate, _ = stepped(jpda.jpda)
    model, survive = line_model(params), 0.95
    clutter = np.full(3, 2.0 / 20)
    model.survive = 1.0

    def density(members):
        tracks = [(1.0, PRIOR.mean[n], PRIOR.cov[n]) for n in members]
        return book.step(tracks, model, DETECTIONS[:3], clutter, 2.0)[0]

    for n in range(3):
        ratio = density(range(3)) / density([m for m in range(3) if m != n])
        r = EXISTS[n] * survive
        slot = list(estimate.label).index(n)
        np.testing.assert_allclose(
            estimate.existence_prob[slot], r * ratio / (1 - r + r * ratio), rtol=1e-9
        )


def test_a_gate_hides_what_is_far():
    params, target = line_params(survive=1.0), targets.single.single()
    tracker = jpda.jpda(target, max_tracks=4, gate_prob=0.5, gate_in_missed=True)
    params = params._replace(start=starting(np.ones(1)))
    estimate = once(tracker, params, np.array([True, True, True, False]))
    # Position and velocity have variance 1, apart; then the motion's and the sensor's.
    std = np.sqrt(1 + 0.5**2 + 0.7 * 0.5**3 / 3 + 0.9**2)
    inside = abs(DETECTIONS[:3, 0] - 0.5) / std < 0.6744897501960817
    np.testing.assert_array_equal(estimate.association_prob[0, :3] > 0, inside)
    g = np.exp(-(((DETECTIONS[:3, 0] - 0.5) / std) ** 2) / 2) / (
        std * np.sqrt(2 * np.pi)
    )
    weight = np.append(np.where(inside, 0.8 * g / 0.1, 0.0), 1 - 0.8 * 0.5)
    found = estimate.association_prob[0][np.array([0, 1, 2, 4])]
    np.testing.assert_allclose(found, weight / weight.sum(), rtol=1e-9)


def test_a_scan_without_clutter_is_explained_by_its_targets():
    """Where clutter is impossible the event that leaves least unexplained wins."""
    params = line_params(survive=1.0)
    none = params.clutter._replace(rate=np.array(0.0))
    params = params._replace(clutter=none, start=starting(np.ones(2)))
    tracker = jpda.jpda(targets.single.single(), max_tracks=4, gate_prob=1.0)
    estimate = once(tracker, params, np.array([True, True, False, False]))
    np.testing.assert_allclose(estimate.association_prob[:2, :2].sum(1), 1)
    assert np.isfinite(estimate.log_evidence)


def test_known_places_need_existence():
    params = line_params()._replace(
        birth=models.birth.PoissonBirth(
            array(0.1), PRIOR.mean[:1], PRIOR.cov[:1], np.ones((1, 1))
        )
    )
    tracker = pda.pda(targets.single.single())
    scan = Scan(DETECTIONS, np.ones(4, bool), np.array(INTERVAL))
    with pytest.raises(ValueError, match="birth is a PoissonBirth"):
        tracker.step(params, tracker.init(params, KEY), scan)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"max_tracks": 0}, "max_tracks is 0"),
        ({"max_births": -1}, "max_births is -1"),
        ({"start_threshold": 2.0}, "start_threshold is 2.0"),
        ({"gate_prob": 0.0}, "gate_prob is 0.0"),
    ],
)
def test_settings_that_make_no_sense(choice, message):
    with pytest.raises(ValueError, match=message):
        pda.pda(targets.single.single(), **choice)


def test_more_targets_at_the_start_than_room():
    tracker = pda.pda(targets.single.single(), max_tracks=2)
    with pytest.raises(ValueError, match="start has 3 targets and max_tracks is 2"):
        tracker.init(line_params(), KEY)


def test_more_events_than_none():
    with pytest.raises(ValueError, match="max_events is 0"):
        jpda.jpda(targets.single.single(), max_events=0)


def test_evidence_without_a_track_is_that_of_clutter():
    params = line_params()._replace(start=None)
    tracker = pda.pda(targets.single.single(), max_tracks=2)
    estimate = once(tracker, params, np.array([True, True, False, False]))
    np.testing.assert_allclose(
        estimate.log_evidence, 2 * np.log(2.0 / 20) - 2.0, rtol=1e-12
    )
    assert not estimate.exists.any()


def test_a_sure_detection_that_fails_stays_finite():
    params = line_params(survive=1.0, detect=1.0)._replace(start=starting(np.ones(2)))
    tracker = jpda.jpda(targets.single.single(), max_tracks=3)
    estimate = once(tracker, params, np.zeros(4, bool))
    np.testing.assert_allclose(estimate.association_prob[:2, 4], 1.0)
    np.testing.assert_allclose(estimate.log_evidence, -2 * 200.0 - 2.0)
    for leaf in jax.tree.leaves(estimate):
        assert np.isfinite(leaf).all()
