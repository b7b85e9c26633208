"""Births from detections against a loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import models as plain

from jaxtrack.models.birth import DetectionBirth, PoissonBirth
from jaxtrack.models.motion import ConstantAcceleration, ConstantVelocity
from jaxtrack.models.sensor import Position, RangeBearing, Timed
from jaxtrack.models.turn import TurnRate

TWO = np.ones(2)
DETECTIONS = np.array([[50.0, 0.3], [90.0, -2.0], [np.nan, 7.0], [20.0, 3.0]])
VALID = np.array([True, True, False, True])
UNEXPLAINED = np.array([0.9, 0.2, 1.0, 0.3])
RADAR = RangeBearing(np.array([5.0, 0.02]), np.array([30.0, -20.0]), 0.5)
CASES = {
    "cv": (ConstantVelocity(TWO), np.zeros(0), ([0, 2], [1, 3], [])),
    "turn rate": (TurnRate(1.0, 1.0), np.array([0.1]), ([0, 2], [1, 3], [4])),
    "ca": (ConstantAcceleration(TWO), np.array([2.0, 3.0]), ([0, 3], [1, 4], [2, 5])),
}


def birth(extra_std):
    modes = np.array([0.7, 0.2, 0.1])
    return DetectionBirth(0.4, 0.25, np.array([6.0, 8.0]), extra_std, modes)


propose = jax.jit(DetectionBirth.propose)


@pytest.mark.parametrize("case", CASES)
def test_proposals_equal_a_loop_over_the_detections(case):
    motion, extra_std, index = CASES[case]
    model = birth(extra_std)
    got = propose(model, RADAR, motion, DETECTIONS, VALID, UNEXPLAINED, 1.5)
    located = [RADAR.locate(z) for z in np.where(VALID[:, None], DETECTIONS, 0.0)]
    want = plain.detection_birth(
        model, *zip(*located, strict=True), VALID, UNEXPLAINED, 1.5, index
    )
    for k, (existence, mean, cov) in enumerate(want):
        np.testing.assert_allclose(got.existence_prob[k], existence)
        np.testing.assert_allclose(got.mean[k], mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(got.cov[k], cov, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(got.mode_prob[k], model.mode_prob)
    # 0.9 of 1.4 would get 0.39, over the limit; the others share what is theirs.
    np.testing.assert_allclose(got.existence_prob[0], 0.25)
    np.testing.assert_allclose(got.existence_prob[3], 0.4 * 1.5 * 0.3 / 1.4)


@pytest.mark.parametrize("valid", [np.zeros(4, bool), np.ones(4, bool)])
def test_nothing_unexplained_gives_no_births_and_finite_gradients(valid):
    detections = np.where(VALID[:, None], DETECTIONS, 0.0)

    def total(model, unexplained):
        born = model.propose(RADAR, CASES["cv"][0], detections, valid, unexplained, 1.5)
        return born.existence_prob.sum() + born.mean.sum() + born.cov.sum()

    model = birth(np.zeros(0))
    got = propose(model, RADAR, CASES["cv"][0], detections, valid, np.zeros(4), 1.5)
    np.testing.assert_array_equal(got.existence_prob, np.zeros(4))
    assert all(np.isfinite(leaf).all() for leaf in got)
    slope = jax.jit(jax.grad(total, (0, 1)))(model, np.zeros(4))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))


def test_an_aged_detection_is_placed_where_it_was_taken():
    sensor = Timed(Position(TWO))
    detections = np.array([[5.0, 6.0, 0.3]])
    got = propose(
        birth(np.zeros(0)),
        sensor,
        CASES["cv"][0],
        detections,
        np.ones(1, bool),
        jnp.ones(1),
        1.0,
    )
    np.testing.assert_allclose(got.mean, [[5, 0, 6, 0]])


def test_poisson_births_become_at_most_one_a_place():
    rate = jnp.array([0.02, 0.7])
    births = PoissonBirth(rate, jnp.ones((2, 3)), jnp.ones((2, 3, 3)), jnp.ones((2, 1)))
    few = births.at_most_one()
    drawn = np.random.default_rng(0).poisson(rate, (200_000, 2))
    np.testing.assert_allclose(few.existence_prob, (drawn > 0).mean(0), rtol=0.05)
    # Of 200,000 draws the mean has a standard error of up to 0.002.
    short = drawn.mean(0) - few.existence_prob
    np.testing.assert_allclose(short, rate + jnp.exp(-rate) - 1, atol=3e-3)
    assert few.mean is births.mean
