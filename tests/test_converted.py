"""Positions with correlated errors: against polar coordinates, and in a target."""

import jax
import numpy as np
from cases.targets import array, value
from reference import kalman

from jaxtrack.models import motion, probability
from jaxtrack.models.converted import ConvertedRangeBearing, CorrelatedPosition
from jaxtrack.models.sensor import Timed, untimed
from jaxtrack.targets import single
from jaxtrack.types import Gaussian

STD, HERE = np.array([5.0, 0.02]), np.array([30.0, -20.0])
RADAR = ConvertedRangeBearing(STD, HERE)


def cov_by_hand(detection):
    """Errors of range along the line of sight and of bearing across it."""
    x, y = detection - HERE
    r = np.hypot(x, y)
    along, across = np.array([x, y]) / r, np.array([-y, x]) / r
    arc = (r**2 + STD[0] ** 2) * STD[1] ** 2
    return STD[0] ** 2 * np.outer(along, along) + arc * np.outer(across, across)


def test_noise_lies_along_and_across_the_line_of_sight():
    for z in np.array([[800.0, 300.0], [-200.0, 500.0], [31.0, -1000.0]]):
        located = jax.jit(RADAR.locate)(z)
        np.testing.assert_array_equal(located.mean, z)
        np.testing.assert_allclose(located.cov, cov_by_hand(z), rtol=1e-9)
        at, same = untimed(RADAR, z)
        np.testing.assert_allclose(at.cov(), cov_by_hand(z), rtol=1e-9)
        np.testing.assert_array_equal(same, z)


def test_reports_scatter_as_the_noise_says():
    """And their mean is the place: the bias is small where the bound holds."""
    place = np.array([700.0, 400.0])
    white = np.random.default_rng(0).normal(size=(20000, 2))
    draw = jax.jit(jax.vmap(lambda w: RADAR.report(place, 0 * place, w)))
    seen = np.asarray(draw(white))
    cov = cov_by_hand(place)
    spread = np.sqrt(np.diag(cov))
    # Four standard errors of a mean of so many, and a bias of the second order.
    np.testing.assert_allclose(
        (seen.mean(0) - place) / spread, 0, atol=4 / np.sqrt(20000) + 0.02
    )
    error = (np.cov(seen.T) - cov) / np.outer(spread, spread)
    np.testing.assert_allclose(error, 0, atol=4 * np.sqrt(2 / 20000))


def test_gradients_are_finite_at_the_sensor_itself():
    slope = jax.jit(jax.jacrev(lambda z: RADAR.locate(z).cov))(HERE)
    assert np.isfinite(slope).all()


def test_a_target_is_corrected_with_the_noise_of_each_detection():
    params = single.Params(
        motion=motion.ConstantVelocity(array(0.7, 0.7)),
        sensor=RADAR,
        survive=probability.Constant(value(0.97)),
        detect=probability.Constant(value(0.9)),
    )
    prior = Gaussian(
        np.array([700.0, 3.0, 400.0, -5.0]), np.diag([90.0, 4.0, 90.0, 4.0])
    )
    detections = np.array([[690.0, 420.0], [720.0, 390.0]])
    target = single.single()

    @jax.jit
    def seen(params):
        view = target.look(params, target.begin(params, prior, np.ones(1), None))
        corrected = [target.correct(params, view, z) for z in detections]
        return target.score(params, view, detections), corrected

    score, corrected = seen(params)
    H = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    for k, z in enumerate(detections):
        m, P, log_density = kalman.update(*prior, H, 0, cov_by_hand(z), z)
        np.testing.assert_allclose(score[k], log_density + np.log(0.9), rtol=1e-9)
        belief = target.moments(corrected[k])
        np.testing.assert_allclose(belief.mean, m, rtol=1e-9)
        np.testing.assert_allclose(belief.cov, P, rtol=1e-8, atol=1e-9)  # zeros


def test_a_detection_with_its_age_keeps_its_noise():
    z = np.array([800.0, 300.0])
    delayed, ageless = untimed(Timed(RADAR), np.append(z, 2.0))
    np.testing.assert_array_equal(ageless, z)
    np.testing.assert_allclose(delayed.cov(), cov_by_hand(z), rtol=1e-9)
    place, velocity = np.array([8.0, 3.0]), np.array([1.0, -2.0])
    np.testing.assert_allclose(delayed.measure(place, velocity), [6.0, 7.0])


def test_a_correlated_position_is_what_it_says():
    cov = np.array([[4.0, 1.0], [1.0, 3.0]])
    model, z = CorrelatedPosition(cov), np.array([1.0, 5.0])
    np.testing.assert_array_equal(model.cov(), cov)
    np.testing.assert_array_equal(model.measure(z, 0 * z), z)
    np.testing.assert_array_equal(model.residual(z, 2 * z), -z)
    np.testing.assert_array_equal(model.locate(z).cov, cov)
    assert model.num_outputs == 2
