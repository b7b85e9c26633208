"""Mode switching against matrix exponentials, with asymmetric matrices."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from reference import models as plain

from jaxtrack.models.switching import MarkovSwitching, SojournSwitching

# Mode 2 is entered from mode 0 only, and from mode 1 only by way of it.
JUMP = np.array([[0.0, 0.7, 0.3], [1.0, 0.0, 0.0], [0.4, 0.6, 0.0]])
SOJOURN = np.array([30.0, 5.0, 200.0])
MODEL = SojournSwitching(SOJOURN, JUMP)


@jax.jit
def transition(model, interval):
    return jnp.exp(model.log_transition(interval))


def test_per_scan_switching_is_the_log_and_ignores_the_interval():
    p = np.array([[0.9, 0.1], [0.0, 1.0]])
    log_p = jax.jit(MarkovSwitching.log_transition)(MarkovSwitching(p), 7.0)
    np.testing.assert_allclose(log_p, [np.log([0.9, 0.1]), [-np.inf, 0]])
    slope = jax.jit(jax.grad(lambda p: MarkovSwitching(p).log_transition(1.0)[0, 1]))(p)
    np.testing.assert_allclose(slope, [[0, 10], [0, 0]])


def test_continuous_switching_is_the_exponential_of_the_rates():
    rate = plain.switching_rate(SOJOURN, JUMP)
    for interval in (1e-4, 0.5, 10.0, 300.0, 4000.0):
        got = np.asarray(transition(MODEL, interval))
        want = scipy.linalg.expm(rate * interval)
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(got.sum(1), 1.0)


def test_two_parts_of_an_interval_equal_the_whole():
    first, second, whole = (np.asarray(transition(MODEL, t)) for t in (3.0, 8.0, 11.0))
    np.testing.assert_allclose(first @ second, whole, rtol=1e-9)


def test_an_interval_without_end_is_stationary_and_never_nan():
    got = np.asarray(transition(MODEL, 1e9))
    rate = plain.switching_rate(SOJOURN, JUMP)
    np.testing.assert_allclose(got @ rate, np.zeros((3, 3)), atol=1e-9)
    np.testing.assert_allclose(got.sum(1), 1.0)


def test_no_time_and_impossible_jumps_have_log_probability_minus_infinity():
    log_p = np.asarray(MODEL.log_transition(0.0))
    np.testing.assert_array_equal(
        log_p, np.log(np.eye(3), where=np.eye(3) > 0, out=np.full((3, 3), -np.inf))
    )
    absorbing = MODEL._replace(jump_prob=JUMP * np.array([[0.0], [1.0], [1.0]]))
    log_p = np.asarray(absorbing.log_transition(10.0))
    np.testing.assert_allclose(log_p[0], [0, -np.inf, -np.inf])
    assert np.isfinite(log_p[1, :2]).all()


def test_the_diagonal_of_the_jumps_is_not_looked_at():
    other = MODEL._replace(jump_prob=JUMP + 5 * np.eye(3))
    np.testing.assert_allclose(transition(other, 10.0), transition(MODEL, 10.0))


def test_one_mode_stays():
    alone = SojournSwitching(np.array([10.0]), np.zeros((1, 1)))
    np.testing.assert_array_equal(alone.log_transition(5.0), [[0.0]])


def test_gradients_agree_with_finite_differences_and_are_finite_at_no_time():
    def entries(x):
        model = SojournSwitching(x[:3], x[3:12].reshape(3, 3))
        return model.log_transition(x[12]).ravel()

    slope = jax.jit(jax.jacrev(entries))
    point = np.concatenate([SOJOURN, JUMP.ravel(), [10.0]])
    want = plain.jacobian(jax.jit(entries), point)
    # A jump of probability 0 can only grow: there is no difference on both sides.
    np.testing.assert_allclose(slope(point), want, rtol=1e-5, atol=1e-7)
    point[12] = 0.0
    assert np.isfinite(slope(point)).all()


def test_float32_keeps_the_digits_of_small_probabilities():
    with jax.enable_x64(False):
        model = jax.tree.map(np.float32, MODEL)
        got = np.asarray(transition(model, np.float32(1e-4)))
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, transition(MODEL, 1e-4), rtol=1e-5)


def test_adjacent_are_those_that_one_jump_reaches():
    """Not those by way of others, though in continuous time they may be there."""
    p = np.array([[0.9, 0.1, 0.0], [0.0, 1.0, 0.0], [0.5, 0.5, 0.0]])
    markov, sojourn = jax.jit(
        lambda p: (MarkovSwitching(p).adjacent(), MODEL.adjacent())
    )(p)
    np.testing.assert_array_equal(markov, p > 0)
    np.testing.assert_array_equal(sojourn, [[1, 1, 1], [1, 1, 0], [1, 1, 1]])
