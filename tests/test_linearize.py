"""Tests of jaxtrack.linearize against FilterPy, dynamax and finite differences."""

import functools
import warnings

import chex
import filterpy.kalman
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import entries, kalman, linearize
from jaxtrack.models import motion, sensor, turn
from jaxtrack.types import Gaussian

METHODS = {
    "taylor": linearize.taylor,
    "unscented": linearize.unscented,
    "cubature": linearize.cubature,
}
every_method = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())
RADAR = sensor.RangeBearing(
    np.array([2.0, 0.02]), np.array([10.0, -20.0]), np.array(0.3)
)
STRAIGHT = motion.ConstantVelocity(np.array([0.5, 0.8]))
TURN = turn.TurnRate(np.array(0.5), np.array(1e-3))
DETECTION = np.array([161.0, 0.52])


def near_belief():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(4, 4)) * np.array([[6.0], [2.0], [7.0], [1.5]])
    mean = np.array([120.0, -3.0, 95.0, 2.0])
    return Gaussian(mean, root @ root.T + np.diag([4.0, 1.0, 5.0, 1.0]))


def turning_belief():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(5, 5)) * np.array([[4.0], [2.0], [5.0], [1.5], [0.05]])
    mean = np.array([120.0, -30.0, 95.0, 20.0, 0.2])
    return Gaussian(mean, root @ root.T + np.diag([4.0, 1.0, 5.0, 1.0, 1e-3]))


@functools.partial(jax.jit, static_argnums=0)
def cycle(method, belief, turning, detection):
    """One update of a straight track and one prediction of a turning one."""
    seen = linearize.sensor_affine(RADAR, STRAIGHT, belief, method)
    moved = linearize.motion_affine(TURN, turning, jnp.array(1.5), method)
    posterior = kalman.update(belief, seen, detection, RADAR.residual)
    return seen, posterior, moved, kalman.predict(turning, moved)


@functools.cache
def result(name):
    return cycle(METHODS[name], near_belief(), turning_belief(), DETECTION)


def measure(state):
    dx, dy = state[0] - 10, state[2] + 20
    return np.array([np.hypot(dx, dy), np.arctan2(dy, dx) - 0.3])


def move(state, interval):
    x, vx, y, vy, w = state
    a = w * interval
    sin, cos = np.sin(a) / w, (1 - np.cos(a)) / w
    return np.array(
        [
            x + sin * vx - cos * vy,
            np.cos(a) * vx - np.sin(a) * vy,
            y + cos * vx + sin * vy,
            np.sin(a) * vx + np.cos(a) * vy,
            w,
        ]
    )


def difference(function, point):
    steps = 1e-5 * np.eye(point.size)
    ahead, behind = ([function(point + s * e) for e in steps] for s in (1, -1))
    return (np.array(ahead) - np.array(behind)).T / 2e-5


def test_taylor_is_the_extended_kalman_filter():
    belief, turning = near_belief(), turning_belief()
    seen, (posterior, _), moved, predicted = result("taylor")
    jacobian = difference(measure, belief.mean)
    np.testing.assert_allclose(seen.matrix, jacobian, rtol=1e-6, atol=1e-8)
    forward = difference(lambda x: move(x, 1.5), turning.mean)
    np.testing.assert_allclose(moved.matrix, forward, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(predicted.mean, move(turning.mean, 1.5), rtol=1e-12)

    peer = filterpy.kalman.ExtendedKalmanFilter(dim_x=4, dim_z=2)
    peer.x, peer.P, peer.R = (
        belief.mean.copy(),
        belief.cov.copy(),
        np.array(RADAR.cov()),
    )
    peer.update(DETECTION, lambda _: np.array(seen.matrix), measure)
    np.testing.assert_allclose(posterior.mean, peer.x, rtol=1e-9)
    np.testing.assert_allclose(posterior.cov, peer.P, rtol=1e-9, atol=1e-9)


def test_unscented_is_the_unscented_kalman_filter():
    belief, turning = near_belief(), turning_belief()
    _, (posterior, log_density), _, predicted = result("unscented")

    def peer_of(start, dim_x, fx):
        points = filterpy.kalman.JulierSigmaPoints(dim_x, kappa=3.0 - dim_x)
        peer = filterpy.kalman.UnscentedKalmanFilter(dim_x, 2, 1.5, measure, fx, points)
        peer.x, peer.P = start.mean.copy(), start.cov.copy()
        return peer

    still = peer_of(belief, 4, lambda x, dt: x)
    still.R, still.Q = np.array(RADAR.cov()), np.zeros((4, 4))
    still.predict()
    # FilterPy measures its propagated points, which here are those of the prior.
    still.update(DETECTION)
    np.testing.assert_allclose(posterior.mean, still.x, rtol=1e-9)
    np.testing.assert_allclose(posterior.cov, still.P, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(log_density, still.log_likelihood, rtol=1e-9)

    turned = peer_of(turning, 5, move)
    turned.Q = np.array(TURN.noise(1.5))
    turned.predict()
    np.testing.assert_allclose(predicted.mean, turned.x, rtol=1e-9)
    np.testing.assert_allclose(predicted.cov, turned.P, rtol=1e-9, atol=1e-9)


def turning_track(num_scans=8):
    """A belief at the first scan, and detections of a target that turns by 2.4 rad."""
    belief, rng = turning_belief(), np.random.default_rng(5)
    far = RADAR._replace(position=np.array([-400.0, -300.0]))  # away from the wrap
    state, rows = belief.mean + np.array([3.0, 2.0, -4.0, 1.0, 0.02]), []
    for _ in range(num_scans):
        dx, dy = state[[0, 2]] - far.position
        seen = np.array([np.hypot(dx, dy), np.arctan2(dy, dx) - 0.3])
        rows.append(seen + far.noise_std * rng.normal(size=2))
        state = move(state, 1.5)
    return belief, far, np.array(rows)


@functools.partial(jax.jit, static_argnums=0)
def track(method, belief, radar, detections):
    """Filtered and next predicted beliefs of each scan, and the log-density of all."""

    def scan(belief, detection):
        seen = linearize.sensor_affine(radar, TURN, belief, method)
        posterior, log_density = kalman.update(belief, seen, detection, radar.residual)
        motion = linearize.motion_affine(TURN, posterior, jnp.array(1.5), method)
        belief = kalman.predict(posterior, motion)
        return belief, (posterior, belief, log_density)

    filtered, predicted, log_density = jax.lax.scan(scan, belief, detections)[1]
    return filtered, predicted, log_density.sum()


@pytest.mark.parametrize("name", ["taylor", "unscented"])
def test_a_track_agrees_with_dynamax(name, monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its dependencies deprecate one another
        from dynamax import nonlinear_gaussian_ssm as peer
        from dynamax.nonlinear_gaussian_ssm import inference_ekf, inference_ukf

    # It adds 1e-9 to the diagonal of what it solves with, much beside a bearing.
    for module in (inference_ekf, inference_ukf):
        plain = functools.partial(module.psd_solve, diagonal_boost=0.0)
        monkeypatch.setattr(module, "psd_solve", plain)
    belief, radar, detections = turning_track()
    params = peer.ParamsNLGSSM(
        initial_mean=jnp.asarray(belief.mean),
        initial_covariance=jnp.asarray(belief.cov),
        dynamics_function=lambda state: TURN.move(state, 1.5),
        dynamics_covariance=TURN.noise(1.5),
        emission_function=lambda state: radar.measure(state[jnp.array([0, 2])], None),
        emission_covariance=radar.cov(),
    )
    # Our sigma points in its letters: alpha^2 (D + kappa) = 3, one centre weight.
    points = peer.UKFHyperParams(alpha=1.0, beta=0.0, kappa=3 - belief.mean.size)
    filters = {
        "taylor": lambda z: peer.extended_kalman_filter(params, z),
        "unscented": lambda z: peer.unscented_kalman_filter(params, z, points),
    }
    with jax.numpy_rank_promotion("allow"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = jax.jit(filters[name])(detections)
    expected = (
        Gaussian(theirs.filtered_means, theirs.filtered_covariances),
        Gaussian(theirs.predicted_means, theirs.predicted_covariances),
        theirs.marginal_loglik,
    )
    ours = track(METHODS[name], belief, radar, detections)
    chex.assert_trees_all_close(ours, expected, rtol=1e-9, atol=1e-9)


def cubature_moments(function, belief):
    """Mean, covariance and cross-covariance by the cubature rule, as a loop."""
    dim, lower = belief.mean.size, np.linalg.cholesky(belief.cov)
    points = [
        belief.mean + sign * np.sqrt(dim) * lower[:, i]
        for i in range(dim)
        for sign in (1, -1)
    ]
    values = [function(x) for x in points]
    mean = sum(values) / len(values)
    cov = sum(np.outer(v - mean, v - mean) for v in values) / len(values)
    pairs = zip(points, values, strict=True)
    cross = sum(np.outer(x - belief.mean, v - mean) for x, v in pairs) / len(values)
    return mean, cov, cross


def test_cubature_is_the_cubature_kalman_filter():
    belief, turning = near_belief(), turning_belief()
    _, (posterior, _), _, predicted = result("cubature")
    mean, cov, cross = cubature_moments(measure, belief)
    spread = cov + np.array(RADAR.cov())
    gain = cross @ np.linalg.inv(spread)
    expected = belief.mean + gain @ (DETECTION - mean)
    np.testing.assert_allclose(posterior.mean, expected, rtol=1e-9)
    cov = belief.cov - gain @ spread @ gain.T
    np.testing.assert_allclose(posterior.cov, cov, rtol=1e-9, atol=1e-9)
    mean, cov, _ = cubature_moments(lambda x: move(x, 1.5), turning)
    np.testing.assert_allclose(predicted.mean, mean, rtol=1e-9)
    cov = cov + np.array(TURN.noise(1.5))
    np.testing.assert_allclose(predicted.cov, cov, rtol=1e-9, atol=1e-9)


@every_method
def test_affine_function_is_returned_as_it_is(method):
    rng = np.random.default_rng(2)
    matrix, offset = rng.normal(size=(2, 4)), rng.normal(size=2)
    noise = np.array([[2.0, 0.5], [0.5, 1.0]])
    affine = method(lambda x: matrix @ x + offset, near_belief(), noise)
    np.testing.assert_allclose(affine.matrix, matrix, rtol=1e-9)
    np.testing.assert_allclose(affine.offset, offset, rtol=1e-7)
    np.testing.assert_allclose(affine.cov, noise, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", ["unscented", "cubature"])
def test_regressions_know_what_the_line_leaves_out(name):
    seen = result(name)[0]
    extra = seen.cov - RADAR.cov()
    np.testing.assert_array_equal(seen.cov, seen.cov.T)
    assert np.linalg.eigvalsh(extra).min() > -1e-12
    assert np.trace(extra) > 1e-6


@every_method
def test_bearing_across_the_wrap_is_no_jump(method):
    """The same scene seen by a sensor that is turned until the bearing is near pi."""
    belief, turning = near_belief(), turning_belief()
    bearing = measure(belief.mean)[1]
    turned = RADAR._replace(heading=RADAR.heading + bearing - np.pi)
    shifted = np.array([161.0, 0.52 - bearing + np.pi])

    @jax.jit
    def update(radar, detection):
        seen = linearize.sensor_affine(radar, STRAIGHT, belief, method)
        return kalman.update(belief, seen, detection, radar.residual)

    del turning
    chex.assert_trees_all_close(
        update(turned, shifted), update(RADAR, DETECTION), rtol=1e-8, atol=1e-8
    )


@every_method
def test_linear_models_are_taken_exactly(method):
    belief = near_belief()
    moved = linearize.motion_affine(STRAIGHT, belief, jnp.array(1.5), method)
    np.testing.assert_allclose(moved.matrix, STRAIGHT.transition(1.5))
    np.testing.assert_allclose(moved.cov, STRAIGHT.noise(1.5))
    np.testing.assert_array_equal(moved.offset, np.zeros(4))
    place = sensor.Position(np.array([1.0, 2.0]))
    seen = linearize.sensor_affine(place, STRAIGHT, belief, method)
    np.testing.assert_array_equal(seen.matrix, [[1, 0, 0, 0], [0, 0, 1, 0]])
    np.testing.assert_array_equal(seen.cov, np.diag([1.0, 4.0]))


@every_method
def test_gradients_are_right(method):
    belief = jax.tree.map(jnp.asarray, near_belief())

    @jax.jit
    @jax.value_and_grad
    def loss(belief):
        seen = linearize.sensor_affine(RADAR, STRAIGHT, belief, method)
        posterior, log_density = kalman.update(belief, seen, DETECTION, RADAR.residual)
        return log_density + posterior.mean.sum() + posterior.cov.sum()

    slope = loss(belief)[1]
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4))
    step = Gaussian(rng.normal(size=4), root + root.T)
    ahead, behind = (
        loss(jax.tree.map(lambda x, d, s=s: x + s * 1e-5 * d, belief, step))[0]
        for s in (1, -1)
    )
    along = sum((g * d).sum() for g, d in zip(slope, step, strict=True))
    np.testing.assert_allclose((ahead - behind) / 2e-5, along, rtol=1e-6)


SPACE = sensor.AzimuthElevationRange(
    np.array([0.01, 0.02, 3.0]), np.array([1.0, -2.0, 3.0]), np.array(0.3)
)
PLANE = (np.array([10.0, -20.0]), np.array(0.3))
SENSORS = {
    "position": (sensor.Position(np.ones(2)), 4),
    "delayed": (sensor.Delayed(sensor.Position(np.ones(2)), np.array(0.7)), 4),
    "range-bearing": (RADAR, 2),
    "delayed radar": (sensor.Delayed(RADAR, np.array(0.7)), 4),
    "rate": (sensor.RangeBearingRate(np.ones(3), *PLANE), 4),
    "bearing": (sensor.BearingOnly(np.ones(1), *PLANE), 2),
    "space": (SPACE, 3),
}


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_is_expanded_only_in_what_it_looks_at(name):
    """As `taylor` of the whole state, with the zeros known; also one that is linear."""
    looking, num_looked_at = SENSORS[name]
    motion_model = motion.ConstantVelocity(np.ones(3 if name == "space" else 2))
    mean = np.array([120.0, -3.0, 95.0, 2.0, 40.0, 1.0])[: motion_model.dim]
    belief = Gaussian(mean, np.eye(motion_model.dim))

    def measure(state):
        return looking.measure(state[0::2], state[1::2])

    @jax.jit
    def both(belief):
        got = linearize.sensor_affine(looking, motion_model, belief, linearize.taylor)
        columns = got.matrix.T.rows
        known = sum(all(isinstance(x, int) for x in column) for column in columns)
        if not looking.linear:
            assert known == motion_model.dim - num_looked_at
        whole = linearize.taylor(measure, belief, looking.cov())
        return entries.arrays((got, whole))

    got, whole = both(belief)
    chex.assert_trees_all_close(got, whole, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("rate", [0.0, 1e-9, 0.2, -3.0])
def test_a_turn_is_expanded_as_by_autodiff(rate):
    state = jnp.array([120.0, -30.0, 95.0, 20.0, rate])

    @jax.jit
    def both(state):
        moved, matrix = TURN.expand(state, 1.5)
        move = functools.partial(TURN.move, interval=1.5)
        return (moved, entries.dense(matrix)), (move(state), jax.jacfwd(move)(state))

    chex.assert_trees_all_close(*both(state), rtol=1e-12, atol=1e-12)


class Strange:
    """A user's own motion: both indices name the first component."""

    position_index = velocity_index = (0,)


def test_a_component_may_be_position_and_velocity_at_once():
    class Both:
        linear = False

        def measure(self, position, velocity):
            return position**2 + 3 * velocity

        def cov(self):
            return jnp.eye(1)

    belief = Gaussian(jnp.array([1.0, 7.0]), jnp.eye(2))
    got = linearize.sensor_affine(Both(), Strange(), belief, linearize.taylor)
    np.testing.assert_array_equal(np.asarray(got.matrix), [[5.0, 0.0]])


def test_a_linear_sensor_may_scale_and_subtract():
    class Scaled:
        linear = True

        def measure(self, position, velocity):
            return -(2.0 * position / 4 - velocity)

        def cov(self):
            return jnp.eye(2)

    belief = Gaussian(jnp.arange(4.0), jnp.eye(4))
    got = linearize.sensor_affine(Scaled(), STRAIGHT, belief, linearize.taylor)
    want = [[-0.5, 1, 0, 0], [0, 0, -0.5, 1]]
    np.testing.assert_array_equal(np.asarray(got.matrix), want)
