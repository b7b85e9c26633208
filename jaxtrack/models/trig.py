"""Sine, cosine and arctangent as polynomials, which vectorise on a CPU.

The functions of the same name in `jax.numpy` call a scalar routine for each element
there, and are an order of magnitude slower. Angles are in radians, float32 or float64.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models import trig
    >>> sin, cos = trig.sincos(jnp.array(jnp.pi / 6))
    >>> print(sin.round(3), cos.round(3), trig.atan2(sin, -cos).round(3))
    0.5 0.866 2.618

The ranges are those of Cephes (Moshier, 1989) and of Cody and Waite, "Software manual
for the elementary functions", 1980. The coefficients are minimax of the relative error
on them, by Remez exchange in 60 digits, rounded lowest order first and each time
fitted again.
"""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxtrack.types import Array

# Of (sin(r) - r) / r^3, (cos(r) - 1 + r^2 / 2) / r^4 and (atan(t) - t) / t^3 in powers
# of r^2 and t^2, for |r| <= pi / 4 and |t| <= tan(pi / 8).
SIN = {
    32: (-0.166666552, 0.00833218917, -0.000195182845),
    64: (
        -0.1666666666666663,
        0.00833333333332184,
        -0.00019841269829358528,
        2.7557313538514395e-06,
        -2.5050734389311647e-08,
        1.589543329362245e-10,
    ),
}
COS = {
    32: (0.0416666456, -0.00138873095, 2.44323273e-05),
    64: (
        0.041666666666666595,
        -0.0013888888888873338,
        2.480158728899748e-05,
        -2.755731421529929e-07,
        2.0875705115059047e-09,
        -1.1358732782155773e-11,
    ),
}
ATAN = {
    32: (-0.333333164, 0.199985281, -0.14244391, 0.105991684, -0.0609005243),
    64: (
        -0.333333333333332,
        0.1999999999995367,
        -0.14285714280198986,
        0.11111110783472529,
        -0.09090897757367133,
        0.07692060215633319,
        -0.06663104238168656,
        0.05847891898295828,
        -0.050393168798350985,
        0.0380646292406814,
        -0.017906618333976373,
    ),
}
# pi / 2 in three parts: a whole number of up to 11 (float32) or 20 bits (float64) times
# one of the first two is exact.
QUARTER = {
    32: (1.570556640625, 0.0002396702766418457, 1.5893254773528196e-08),
    64: (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21),
}
EIGHTH = math.tan(math.pi / 8)


@jax.custom_jvp
def sincos(angle: Array) -> tuple[Array, Array]:
    """Returns the sine and the cosine of an angle.

    The error is at most 1.6 ulp in float32 for angles up to 100 rad, and in absolute
    terms 1e-7 up to 3000 rad; 2.4 ulp in float64 up to 1.6e6 rad (measured). Further
    out it is as if the angle were wrong in its last bit, and beyond 2^22 rad (2^51 in
    float64) nothing is left of it, but the result stays in [-1, 1].

    Args:
        angle: rad, of any shape. An infinite one gives NaN, as NaN does.

    Returns:
        Sine and cosine, each of the angle's shape and type.
    """
    angle = jnp.asarray(angle, jnp.result_type(angle, float))
    bits = _bits(angle)
    turns = jnp.round(angle * (2 / math.pi))
    rest = angle
    for part in QUARTER[bits]:
        rest = rest - turns * part
    # Idle but for an angle that is too large to know.
    rest = jnp.clip(rest, -0.8, 0.8)

    square = rest * rest
    sin = rest + rest * square * _polynomial(SIN[bits], square)
    cos = 1 - 0.5 * square + square * square * _polynomial(COS[bits], square)
    quadrant = turns - 4 * jnp.floor(turns * 0.25)
    odd = (quadrant == 1) | (quadrant == 3)
    left = (quadrant == 1) | (quadrant == 2)
    sin, cos = jnp.where(odd, cos, sin), jnp.where(odd, sin, cos)
    return jnp.where(quadrant >= 2, -sin, sin), jnp.where(left, -cos, cos)


@sincos.defjvp
def _sincos_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    sin, cos = sincos(*primals)
    return (sin, cos), (cos * tangents[0], -sin * tangents[0])


@jax.custom_jvp
def atan2(y: Array, x: Array) -> Array:
    """Returns the angle of the point (x, y), anticlockwise from the x-axis.

    The error is at most 2.6 ulp (measured), for lengths that can be squared.

    Args:
        y: Of any shape.
        x: Of the same shape.

    Returns:
        rad in [-pi, pi]. On the axes and for zeros as `numpy.arctan2`, so 0 or pi with
        a sign for (0, 0), and there the gradient is 0. If both are infinite, NaN.
    """
    dtype = jnp.result_type(y, x, float)
    y, x = jnp.asarray(y, dtype), jnp.asarray(x, dtype)
    bits = _bits(y * x)
    high, wide = jnp.abs(y), jnp.abs(x)
    near, far = jnp.minimum(high, wide), jnp.maximum(high, wide)
    far = jnp.where(far > 0, far, 1.0)

    # The angle is a number of eighths of a turn, plus or minus that of the ratio.
    diagonal = near > EIGHTH * far
    above = jnp.where(diagonal, near - far, near)
    ratio = above / jnp.where(diagonal, near + far, far)
    square = ratio * ratio
    rest = ratio + ratio * square * _polynomial(ATAN[bits], square)
    whole = jnp.where(diagonal, jnp.full_like(ratio, math.pi / 4), 0.0)

    steep, back = high > wide, jnp.signbit(x)
    whole = jnp.where(steep, math.pi / 2 - whole, whole)
    whole = jnp.where(back, math.pi - whole, whole)
    angle = whole + jnp.where(steep ^ back, -rest, rest)
    return jnp.where(jnp.signbit(y), -angle, angle)


@atan2.defjvp
def _atan2_jvp(
    primals: tuple[Array, Array], tangents: tuple[Array, Array]
) -> tuple[Array, Array]:
    y, x = primals
    square = x * x + y * y
    square = jnp.where(square > 0, square, 1.0)
    slope = (x * tangents[0] - y * tangents[1]) / square
    return atan2(y, x), slope


def _bits(x: Array) -> int:
    """Returns the precision for which there are coefficients."""
    return 64 if x.dtype == jnp.float64 else 32


def _polynomial(coefficients: Sequence[float], x: Array) -> Array:
    """Returns c_0 + c_1 x + c_2 x^2 + ..., by Horner's rule."""
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total
