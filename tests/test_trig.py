"""Tests of `jaxtrack.models.trig` against NumPy in a longer format."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxtrack.models import trig

NUMBER = 100_000
TYPES = [np.float32, np.float64]
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, 3.0, -3.0])

sincos, atan2 = jax.jit(trig.sincos), jax.jit(trig.atan2)


def angles(dtype, limit):
    """Anywhere, and close to the zeros of sine and cosine."""
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(-limit, limit, NUMBER)
    zeros = np.round(anywhere / (np.pi / 2)) * (np.pi / 2)
    off = rng.normal(size=NUMBER) * 10 ** rng.uniform(-17, -1, NUMBER)
    return np.append(anywhere, zeros + off).astype(dtype)


def ulps(result, expected):
    """Errors in units of the last place of what is right."""
    result = np.asarray(result)
    unit = np.spacing(np.abs(expected.astype(result.dtype)))
    return np.abs(result - expected) / unit


@pytest.mark.parametrize(
    ("dtype", "limit", "error"),
    [(np.float32, 100, 1.6), (np.float64, 1000, 2.0), (np.float64, 1.6e6, 2.5)],
)
def test_sine_and_cosine_are_right_to_the_last_bits(dtype, limit, error):
    angle = angles(dtype, limit)
    sin, cos = sincos(angle)
    assert sin.dtype == cos.dtype == dtype
    assert ulps(sin, np.sin(angle.astype(np.longdouble))).max() < error
    assert ulps(cos, np.cos(angle.astype(np.longdouble))).max() < error


@pytest.mark.parametrize(("limit", "bits"), [(3e3, 0), (4e6, 1.2)])
def test_far_out_an_angle_is_as_if_wrong_in_its_last_bit(limit, bits):
    angle = angles(np.float32, limit)
    last = 1e-7 + bits * np.spacing(np.abs(angle))
    sin, cos = sincos(angle)
    assert (np.abs(sin - np.sin(angle.astype(float))) < last).all()
    assert (np.abs(cos - np.cos(angle.astype(float))) < last).all()


@pytest.mark.parametrize("dtype", TYPES)
def test_sine_and_cosine_stay_bounded_whatever_the_angle(dtype):
    huge = 10 ** np.linspace(0, np.log10(np.finfo(dtype).max) - 0.1, 1000)
    both = np.array(sincos(np.append(huge, -huge).astype(dtype)))
    assert (np.abs(both) <= 1).all()
    assert np.isnan(np.array(sincos(np.array([np.nan, np.inf, -np.inf], dtype)))).all()


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("decades", [1, 15])
def test_arctangent_is_right_to_the_last_bits(dtype, decades):
    rng = np.random.default_rng(1)
    size = 10 ** rng.uniform(-decades, decades, (2, NUMBER))
    y, x = (rng.normal(size=(2, NUMBER)) * size).astype(dtype)
    angle = atan2(y, x)
    assert angle.dtype == dtype
    expected = np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))
    normal = np.abs(expected) > 10 * np.finfo(dtype).tiny
    assert ulps(angle, expected)[normal].max() < 2.7


@pytest.mark.parametrize("dtype", TYPES)
def test_arctangent_on_the_axes_and_diagonals_is_that_of_numpy(dtype):
    y, x = np.meshgrid(SPECIAL.astype(dtype), SPECIAL.astype(dtype))
    angle, expected = np.asarray(atan2(y, x)), np.arctan2(y, x)
    np.testing.assert_allclose(angle, expected, rtol=2 * np.finfo(dtype).eps)
    np.testing.assert_array_equal(np.signbit(angle), np.signbit(expected))
    missing = np.array([[np.nan, 1], [1, np.nan], [np.nan, 0]], dtype)
    assert np.isnan(np.asarray(atan2(*missing.T))).all()


def test_arctangent_undoes_sine_and_cosine():
    angle = np.linspace(-np.pi, np.pi, 1001)
    np.testing.assert_allclose(atan2(*sincos(angle)), angle, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 0.3, -2.0, np.pi / 4, 40.0])
def test_derivatives_of_sine_and_cosine_are_right_twice_in_both_modes(angle):
    check_grads(sincos, (jnp.array(angle),), order=2, modes=("fwd", "rev"))
    twice = jax.grad(jax.grad(lambda a: sincos(a)[0]))(angle)
    np.testing.assert_allclose(twice, -np.sin(angle), atol=1e-15)


@pytest.mark.parametrize("y", [2.0, 0.0, -0.4])
@pytest.mark.parametrize("x", [1.0, 0.5, -3.0])
def test_derivatives_of_the_arctangent_are_right_twice_in_both_modes(y, x):
    if y == 0 and x < 0:
        x = -x  # a jump of 2 pi, no place for differences
    check_grads(atan2, (jnp.array(y), jnp.array(x)), order=2, modes=("fwd", "rev"))
    gradient = jax.grad(atan2, (0, 1))(y, x)
    np.testing.assert_allclose(gradient, [x / (x * x + y * y), -y / (x * x + y * y)])


def test_gradient_of_the_arctangent_is_zero_where_there_is_no_angle():
    assert jax.grad(atan2, (0, 1))(0.0, 0.0) == (0, 0)


def test_derivatives_are_the_same_under_vmap():
    angle, x = jnp.linspace(-9, 9, 7), jnp.linspace(-2, 3, 7)
    sine = jax.vmap(jax.grad(lambda a: sincos(a)[0]))(angle)
    np.testing.assert_allclose(sine, np.cos(angle), rtol=1e-14, atol=1e-15)
    slope = jax.jit(jax.vmap(jax.grad(atan2), (0, None)))(x, 2.0)
    np.testing.assert_allclose(slope, 2 / (x * x + 4), rtol=1e-14)
