"""Turning motions against matrix exponentials and quadrature."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from reference import models as plain

from jaxtrack.entries import arrays
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.turn import CoordinatedTurn, ForgottenTurn, TurnRate

RATES = np.array([-1.3, -0.2, -1e-5, 0.0, 1e-3, 0.2498, 0.2502, 2.0])
WEIGHTS = np.random.default_rng(0).normal(size=(2, 4, 4))
STATE = np.array([3.0, 5.0, -2.0, 7.0])


def turn_value(x):
    """A mixture of transition and noise, for x = [turn rate, interval]."""
    motion = CoordinatedTurn(x[0], 0.7)
    return (jnp.stack([motion.transition(x[1]), motion.noise(x[1])]) * WEIGHTS).sum()


turn_slope = jax.jit(jax.grad(turn_value))
turn_curve = jax.jit(jax.hessian(turn_value))
turn_value = jax.jit(turn_value)


@jax.jit
def unknown_rate_move(x):
    """The moved state, for x = [*state, interval]."""
    return TurnRate(0.7, 0.2).move(x[:5], x[5])


unknown_rate_slope = jax.jit(jax.jacrev(unknown_rate_move))


@jax.jit
def matrices(rates, noise_density, interval):
    def one(rate):
        motion = CoordinatedTurn(rate, noise_density)
        return arrays((motion.transition(interval), motion.noise(interval)))

    return jax.vmap(one)(rates)


def test_transition_and_noise_of_a_turn_solve_the_differential_equation():
    transition, noise = matrices(RATES, 0.7, 4.0)
    for rate, got_transition, got_noise in zip(RATES, transition, noise, strict=True):
        drift, density = plain.coordinated_turn(rate, 0.7)
        want = plain.transition(drift, 4.0)
        np.testing.assert_allclose(got_transition, want, rtol=1e-9, atol=1e-12)
        want = plain.noise(drift, density, 4.0)
        np.testing.assert_allclose(got_noise, want, rtol=1e-9, atol=1e-12)


def test_two_parts_of_a_turn_equal_the_whole():
    whole, noise = map(np.asarray, matrices(RATES, 0.7, 4.0))
    first, noise_first = map(np.asarray, matrices(RATES, 0.7, 1.2))
    second, noise_second = map(np.asarray, matrices(RATES, 0.7, 2.8))
    np.testing.assert_allclose(second @ first, whole, rtol=1e-9, atol=1e-12)
    through = second @ noise_first @ second.swapaxes(1, 2) + noise_second
    np.testing.assert_allclose(through, noise, rtol=1e-9, atol=1e-12)


def test_no_time_turns_nothing_and_adds_nothing():
    transition, noise = matrices(RATES, 0.7, 0.0)
    np.testing.assert_array_equal(transition, np.tile(np.eye(4), (len(RATES), 1, 1)))
    np.testing.assert_array_equal(noise, np.zeros((len(RATES), 4, 4)))


def test_a_turn_at_rate_zero_is_constant_velocity():
    straight = ConstantVelocity(np.array([0.7, 0.7]))
    transition, noise = matrices(RATES, 0.7, 4.0)
    np.testing.assert_allclose(transition[3], straight.transition(4.0))
    np.testing.assert_allclose(noise[3], straight.noise(4.0))


def test_positive_rates_turn_anticlockwise():
    east = np.array([0.0, 1.0, 0.0, 0.0])
    moved = CoordinatedTurn(np.pi / 2, 0.0).move(east, 1.0)
    np.testing.assert_allclose(moved, [2 / np.pi, 0, 2 / np.pi, 1], atol=1e-12)


@pytest.mark.parametrize("rate", [0.0, 0.1, -0.9])
def test_turn_gradients_agree_with_finite_differences_twice(rate):
    point = np.array([rate, 4.0])
    want = plain.jacobian(lambda x: turn_value(x)[None], point)[0]
    np.testing.assert_allclose(turn_slope(point), want, rtol=1e-6, atol=1e-6)
    want = plain.jacobian(turn_slope, point)
    np.testing.assert_allclose(turn_curve(point), want, rtol=1e-6, atol=1e-6)


def test_derivatives_at_rate_zero_are_those_of_the_quadrature():
    def by_hand(rate):
        drift, density = plain.coordinated_turn(rate, 0.7)
        both = [plain.transition(drift, 4.0), plain.noise(drift, density, 4.0)]
        return (np.array(both) * WEIGHTS).sum()

    step, point = 1e-3, np.array([0.0, 4.0])
    low, middle, high = map(by_hand, (-step, 0.0, step))
    slope, curve = (high - low) / step / 2, (low - 2 * middle + high) / step**2
    np.testing.assert_allclose(turn_slope(point)[0], slope, rtol=1e-4)
    np.testing.assert_allclose(turn_curve(point)[0, 0], curve, rtol=1e-4)
    check_grads(turn_value, (point,), order=1, modes=["rev"])


def test_unknown_rate_moves_as_the_known_one_and_keeps_its_rate():
    motion = TurnRate(0.7, 0.2)
    move = jax.jit(jax.vmap(lambda rate: motion.move(jnp.append(STATE, rate), 4.0)))
    for rate, moved in zip(RATES, move(RATES), strict=True):
        drift, _ = plain.coordinated_turn(rate, 0.0)
        want = np.append(plain.transition(drift, 4.0) @ STATE, rate)
        np.testing.assert_allclose(moved, want, rtol=1e-9, atol=1e-12)
    assert not motion.linear


def test_unknown_rate_has_the_noise_of_straight_motion_and_a_wandering_rate():
    noise = np.asarray(jax.jit(TurnRate.noise)(TurnRate(0.7, 0.2), 3.0))
    straight, density = plain.constant_velocity([0.7, 0.7])
    np.testing.assert_allclose(noise[:4, :4], plain.noise(straight, density, 3.0))
    np.testing.assert_allclose(noise[4], [0, 0, 0, 0, 0.6])
    np.testing.assert_array_equal(noise, noise.T)
    np.testing.assert_array_equal(TurnRate(0.7, 0.2).noise(0.0), np.zeros((5, 5)))


@pytest.mark.parametrize("rate", [0.0, 0.4])
def test_unknown_rate_gradients_agree_with_finite_differences(rate):
    point = np.array([*STATE, rate, 4.0])
    want = plain.jacobian(unknown_rate_move, point)
    np.testing.assert_allclose(unknown_rate_slope(point), want, rtol=1e-6, atol=1e-6)


def test_unknown_rate_and_no_time_leave_the_state():
    point = np.array([*STATE, 0.0, 0.0])
    np.testing.assert_array_equal(unknown_rate_move(point), point[:5])
    np.testing.assert_array_equal(unknown_rate_slope(point)[:, :5], np.eye(5))


def test_a_forgotten_turn_is_drawn_anew_and_leaves_the_motion_alone():
    base = ConstantVelocity(np.array([0.5, 2.0]))
    motion = ForgottenTurn(base, 0.3)
    transition, noise, moved = jax.jit(
        lambda m: (m.transition(3.0), m.noise(3.0), m.move(np.append(STATE, 9.0), 3.0))
    )(motion)
    want_transition, want_noise = np.zeros((2, 5, 5))
    want_transition[:4, :4] = base.transition(3.0)
    want_noise[:4, :4], want_noise[4, 4] = base.noise(3.0), 0.3**2
    np.testing.assert_allclose(transition, want_transition)
    np.testing.assert_allclose(noise, want_noise)
    np.testing.assert_allclose(moved, want_transition @ np.append(STATE, 9.0))
    assert (motion.dim, motion.linear) == (5, True)


def test_float32_keeps_its_digits_for_slow_and_fast_turns():
    with jax.enable_x64(False):
        got = matrices(np.float32(RATES), np.float32(0.7), np.float32(4.0))
        got = jax.tree.map(np.asarray, got)
    assert {x.dtype for x in got} == {np.dtype("float32")}
    chex.assert_trees_all_close(
        jax.tree.map(np.float64, got), matrices(RATES, 0.7, 4.0), rtol=1e-5, atol=2e-5
    )
    np.linalg.cholesky(got[1].astype(float))
