"""Linear motion models against matrix exponentials and quadrature."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from reference import models as plain

from jaxtrack import linearize
from jaxtrack.entries import arrays
from jaxtrack.models.acceleration import KnownAcceleration
from jaxtrack.models.motion import (
    ConstantAcceleration,
    ConstantVelocity,
    OrnsteinUhlenbeck,
    PiecewiseAcceleration,
    Singer,
)
from jaxtrack.models.turn import CoordinatedTurn, TurnRate
from jaxtrack.types import Gaussian

ONE, TWO, THREE = np.array([0.7]), np.array([0.5, 2.0]), np.array([0.5, 2.0, 9.0])
CASES = {
    "cv 1-D": (ConstantVelocity(ONE), plain.constant_velocity(ONE)),
    "cv 3-D": (ConstantVelocity(THREE), plain.constant_velocity(THREE)),
    "ca 2-D": (ConstantAcceleration(TWO), plain.constant_acceleration(TWO)),
    "ca 3-D": (ConstantAcceleration(THREE), plain.constant_acceleration(THREE)),
    "singer 1-D": (Singer(ONE, 3 * ONE), plain.singer(ONE, 3 * ONE)),
    "singer 3-D": (
        Singer(THREE, 3 * THREE[::-1]),
        plain.singer(THREE, 3 * THREE[::-1]),
    ),
    "ou 3-D": (
        OrnsteinUhlenbeck(THREE, 3 * THREE[::-1]),
        plain.ornstein_uhlenbeck(THREE, 3 * THREE[::-1]),
    ),
    "singer 2-D": (Singer(TWO, 3 * TWO[::-1]), plain.singer(TWO, 3 * TWO[::-1])),
    "ou 2-D": (
        OrnsteinUhlenbeck(TWO, 3 * TWO[::-1]),
        plain.ornstein_uhlenbeck(TWO, 3 * TWO[::-1]),
    ),
}
INTERVALS = np.array([1e-3, 0.3, 1.4, 1.6, 5.9, 6.1, 25.0])
# What the axes share is seen on one and on three; two are for the slow tests.
every_case = pytest.mark.parametrize(
    "case",
    [pytest.param(x, marks=[pytest.mark.slow] if "2-D" in x else []) for x in CASES],
)


@functools.cache
def noises(case):
    drift, density = CASES[case][1]
    return [plain.noise(drift, density, t) for t in INTERVALS]


@jax.jit
def matrices(motion, intervals):
    return jax.vmap(lambda t: arrays((motion.transition(t), motion.noise(t))))(
        intervals
    )


@every_case
def test_transition_and_noise_solve_the_differential_equation(case):
    motion, (drift, _) = CASES[case]
    transition, noise = matrices(motion, INTERVALS)
    for t, got in zip(INTERVALS, transition, strict=True):
        want = plain.transition(drift, t)
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-13)
    for t, got, want in zip(INTERVALS, noise, noises(case), strict=True):
        atol = 0 if t < 1 else 1e-12  # the quadrature's own, where its terms cancel
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=atol)


@every_case
def test_two_parts_of_an_interval_equal_the_whole(case):
    motion, _ = CASES[case]
    whole, noise = map(np.asarray, matrices(motion, INTERVALS))
    first, noise_first = map(np.asarray, matrices(motion, 0.3 * INTERVALS))
    second, noise_second = map(np.asarray, matrices(motion, 0.7 * INTERVALS))
    np.testing.assert_allclose(second @ first, whole, rtol=1e-9, atol=1e-12)
    through = second @ noise_first @ second.swapaxes(1, 2) + noise_second
    np.testing.assert_allclose(through, noise, rtol=1e-9, atol=1e-12)


@every_case
def test_no_time_moves_nothing_and_adds_nothing(case):
    motion, _ = CASES[case]
    transition, noise = matrices(motion, np.zeros(len(INTERVALS)))
    np.testing.assert_array_equal(transition[0], np.eye(motion.dim))
    np.testing.assert_array_equal(noise[0], np.zeros((motion.dim, motion.dim)))


@every_case
def test_positions_grow_by_velocities_where_the_model_says_they_stand(case):
    motion, (drift, _) = CASES[case]
    state = np.arange(1.0, motion.dim + 1)
    moved, speed = jax.jit(
        lambda motion, t: jax.jvp(lambda t: motion.move(state, t), (t,), (1.0,))
    )(motion, 0.0)
    np.testing.assert_allclose(moved, state)
    np.testing.assert_allclose(speed, drift @ state, rtol=1e-9)
    position, velocity = np.array([motion.position_index, motion.velocity_index])
    np.testing.assert_allclose(np.asarray(speed)[position], state[velocity])
    assert motion.linear


@every_case
def test_move_is_the_transition_of_the_state(case):
    motion, (drift, _) = CASES[case]
    state = np.arange(1.0, motion.dim + 1)
    moved = jax.jit(type(motion).move)(motion, state, 1.7)
    np.testing.assert_allclose(moved, plain.transition(drift, 1.7) @ state, rtol=1e-9)


@every_case
def test_gradients_agree_with_finite_differences_and_are_finite_at_no_time(case):
    values, unravel = ravel_pytree(CASES[case][0])

    def both(x):
        motion = unravel(x[:-1])
        return jnp.stack([motion.transition(x[-1]), motion.noise(x[-1])]).ravel()

    slope = jax.jit(jax.jacrev(both))
    both = jax.jit(both)
    for t in (0.4, 9.0):  # on either side of where the exponentials change their form
        point = np.append(values, t)
        want = plain.jacobian(both, point)
        np.testing.assert_allclose(slope(point), want, rtol=1e-5, atol=1e-6)
    assert np.isfinite(slope(np.append(values, 0.0))).all()


@every_case
def test_float32_keeps_its_digits_over_short_and_long_intervals(case):
    motion, _ = CASES[case]
    short = jax.tree.map(np.float32, motion)
    with jax.enable_x64(False):
        got = jax.tree.map(np.asarray, matrices(short, np.float32(INTERVALS)))
    assert {x.dtype for x in got} == {np.dtype("float32")}
    for t, noise, want in zip(INTERVALS, got[1], noises(case), strict=True):
        atol = 0 if t < 1 else 1e-12
        np.testing.assert_allclose(noise, want, rtol=3e-5, atol=atol)
        np.linalg.cholesky(noise.astype(float))


def test_ornstein_uhlenbeck_keeps_its_stationary_spread():
    std, tau = TWO, 3 * TWO[::-1]
    transition, noise = matrices(OrnsteinUhlenbeck(std, tau), INTERVALS)
    spread = np.diag(np.stack([std, std / tau], axis=1).ravel() ** 2)
    for f, q in zip(np.asarray(transition), np.asarray(noise), strict=True):
        np.testing.assert_allclose(f @ spread @ f.T + q, spread, rtol=1e-9, atol=1e-12)


def test_singer_with_a_long_time_constant_is_constant_acceleration():
    tau = np.array([1e9, 1e9])
    slow = matrices(Singer(np.sqrt(TWO * tau / 2), tau), INTERVALS)
    chex.assert_trees_all_close(
        slow, matrices(ConstantAcceleration(TWO), INTERVALS), rtol=1e-6
    )


@pytest.mark.parametrize("base", [ConstantAcceleration(TWO), TurnRate(0.3, 0.1)])
def test_piecewise_acceleration_adds_its_gain_squared_and_delegates(base):
    std, t = np.array([3.0, 5.0]), 1.5
    motion = PiecewiseAcceleration(base, std)
    added = jax.jit(lambda m: m.noise(t) - m.motion.noise(t))(motion)
    want = np.zeros((base.dim, base.dim))
    for axis in range(2):
        gain = np.zeros(base.dim)
        gain[base.position_index[axis]] = t**2 / 2
        gain[base.velocity_index[axis]] = t
        want += std[axis] ** 2 * np.outer(gain, gain)
    np.testing.assert_allclose(added, want, rtol=1e-9, atol=1e-12)
    state = np.arange(1.0, base.dim + 1)
    np.testing.assert_array_equal(motion.move(state, t), base.move(state, t))
    for name in ("dim", "position_index", "velocity_index", "linear"):
        assert getattr(motion, name) == getattr(base, name)
    if base.linear:
        np.testing.assert_array_equal(motion.transition(t), base.transition(t))


@pytest.mark.parametrize("base", [ConstantVelocity(TWO), CoordinatedTurn(0.3, 0.1)])
def test_known_acceleration_pushes_and_leaves_the_rest(base):
    """The affine model of a move is F x + G a + noise, however it is linearised."""
    push, t, state = np.array([20.0, -40.0]), 1.5, np.arange(1.0, 5.0)
    motion = KnownAcceleration(base, push)
    gain = np.array([[t**2 / 2, 0], [t, 0], [0, t**2 / 2], [0, t]])
    methods = linearize.taylor, linearize.unscented

    @jax.jit
    def models(motion):
        belief = Gaussian(state, np.eye(4))
        many = [linearize.motion_affine(motion, belief, t, m) for m in methods]
        return motion.move(state, t), arrays(many)

    transition, noise = (
        np.asarray(arrays(x(t))) for x in (base.transition, base.noise)
    )
    moved, many = models(motion)
    np.testing.assert_allclose(moved, transition @ state + gain @ push)
    for model in many:
        atol = 1e-12  # of rounding, where the wanted are 0
        np.testing.assert_allclose(model.matrix, transition, rtol=1e-9, atol=atol)
        np.testing.assert_allclose(model.offset, gain @ push, rtol=1e-9)
        np.testing.assert_allclose(model.cov, noise, rtol=1e-9, atol=atol)
    for name in ("dim", "position_index", "velocity_index"):
        assert getattr(motion, name) == getattr(base, name)


def test_known_acceleration_of_two_parts_of_an_interval_is_that_of_the_whole():
    motion, state = KnownAcceleration(ConstantVelocity(TWO), TWO), np.arange(1.0, 5.0)
    move = jax.jit(type(motion).move)
    parts = move(motion, move(motion, state, 0.3), 0.7)
    np.testing.assert_allclose(parts, move(motion, state, 1.0))


def test_many_parameter_sets_are_a_vmap():
    many = ConstantVelocity(np.array([[1.0, 2.0], [3.0, 4.0]]))
    noise = jax.jit(jax.vmap(lambda motion: motion.noise(2.0)))(many)
    np.testing.assert_allclose(noise[1], ConstantVelocity(many[0][1]).noise(2.0))
