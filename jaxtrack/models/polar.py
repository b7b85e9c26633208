"""Ranges and angles: what the sensors that report them are written with.

Gradients are finite everywhere; where a direction is not defined they are 0.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models import polar
    >>> print(polar.wrap(jnp.array([0.25, 2 * jnp.pi + 0.25, -3.5])).round(2))
    [0.25 0.25 2.78]
"""

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.models import trig
from jaxtrack.types import Array, Gaussian


def wrap(angle: Array) -> Array:
    """Returns the same angle in [-pi, pi), any shape; small angles to the last bit."""
    turns = jax.lax.stop_gradient(jnp.floor((angle + jnp.pi) / (2 * jnp.pi)))
    angle = angle - 2 * jnp.pi * turns
    # Rounding can leave it a last bit outside, on either side.
    angle = jnp.where(angle < -jnp.pi, angle + 2 * jnp.pi, angle)
    return jnp.where(angle >= jnp.pi, angle - 2 * jnp.pi, angle)


def length(offset: Array) -> Array:
    """Returns the length of a vector [P], with gradient 0 where it is 0."""
    square = (offset * offset).sum()
    somewhere = square > 0
    return jnp.where(somewhere, jnp.sqrt(jnp.where(somewhere, square, 1.0)), 0.0)


def direction(offset: Array) -> Array:
    """Returns the angle of a vector [2], 0 with gradient 0 where it has no length."""
    somewhere = (offset * offset).sum() > 0
    x = jnp.where(somewhere, offset[0], 1.0)
    return trig.atan2(jnp.where(somewhere, offset[1], 0.0), x)


def locate_plane(distance: Array, angle: Array, std: Array) -> Gaussian:
    """Returns the belief about a place in the plane, seen from the origin.

    First order, but that the arc is taken at the root of the mean squared range, so
    that the covariance is not singular at range 0.

    Args:
        distance: m, a scalar.
        angle: rad from the x-axis, anticlockwise, a scalar.
        std: Standard deviations of the two, [2].

    Returns:
        Mean [2] and covariance [2, 2].
    """
    sin, cos = trig.sincos(angle)
    distance_var, angle_var = std[0] ** 2, std[1] ** 2
    arc = (distance**2 + distance_var) * angle_var
    turn = linalg.rows([[cos, -sin], [sin, cos]])
    spread = linalg.rows([[distance_var, 0.0], [0.0, arc]])
    mean = distance * jnp.stack([cos, sin])
    return Gaussian(mean, linalg.congruence(turn, spread))


def locate_space(
    azimuth: Array, elevation: Array, distance: Array, std: Array
) -> Gaussian:
    """Returns the belief about a place in space, seen from the origin.

    First order, but that both arcs are taken at the root of the mean squared radius,
    so that the covariance is not singular at range 0 or overhead.

    Args:
        azimuth: rad from the x-axis, anticlockwise, a scalar.
        elevation: rad above the x-y plane, a scalar.
        distance: m, a scalar.
        std: Standard deviations of the three, [3].

    Returns:
        Mean [3] and covariance [3, 3].
    """
    sin, cos = trig.sincos(azimuth)
    up, level = trig.sincos(elevation)
    azimuth_var, elevation_var, distance_var = std[0] ** 2, std[1] ** 2, std[2] ** 2
    square = distance**2 + distance_var
    arc = square * (level**2 + up**2 * elevation_var) * azimuth_var
    turn = [
        [level * cos, -sin, -up * cos],
        [level * sin, cos, -up * sin],
        [up, 0.0, level],
    ]
    spread = [
        [distance_var, 0.0, 0.0],
        [0.0, arc, 0.0],
        [0.0, 0.0, square * elevation_var],
    ]
    mean = distance * jnp.stack([level * cos, level * sin, up])
    return Gaussian(mean, linalg.congruence(linalg.rows(turn), linalg.rows(spread)))
