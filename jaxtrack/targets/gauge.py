"""How far a detection is from a target of several Gaussians: what a gate asks.

Two yardsticks: the innovation covariance of the mixture as a whole, spread of the means
and all, or that of the component where it is largest, as in Gomes' equations 26 and 27.

    >>> from jaxtrack.targets import gauge
    >>> gauge.check("widest")
    Traceback (most recent call last):
    ...
    ValueError: yardstick is 'widest'; give one of ('mixture', 'largest')

Reference: Gomes, "An overview on target tracking using multiple models methods", 2011.
"""

import functools
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp

from jaxtrack import linalg, linearize, mixture
from jaxtrack.entries import dense
from jaxtrack.models.sensor import untimed
from jaxtrack.targets import views
from jaxtrack.types import Array

Yardstick = Literal["mixture", "largest"]
YARDSTICKS = ("mixture", "largest")


def check(yardstick: Yardstick) -> None:
    """Raises a ValueError for a yardstick that there is not."""
    if yardstick not in YARDSTICKS:
        raise ValueError(f"yardstick is {yardstick!r}; give one of {YARDSTICKS}")


def distance(
    yardstick: Yardstick,
    method: linearize.Method,
    params: Any,
    weight: Array,
    parts: views.View,
    detections: Array,
) -> tuple[Array, Array]:
    """Measures how far detections are from what N Gaussians expect.

    Args:
        yardstick: "mixture" or "largest".
        method: Of `linearize`.
        params: A target's `Params`.
        weight: Of each Gaussian; they sum to one, [N].
        parts: How each is seen, [N, ...].
        detections: [K, Z].

    Returns:
        Squared Mahalanobis distances [K], and the log-determinants [K] of the
        covariances that they are measured by.
    """
    measure = _by_mixture if yardstick == "mixture" else _by_largest

    def one(detection: Array) -> tuple[Array, Array]:
        sensor, plain = untimed(params.sensor, detection)
        meet = functools.partial(views.meet, method, params, detection=detection)
        sights, _ = jax.vmap(meet)(parts)
        expected, lower = measure(sensor.residual, weight, sights)
        white = linalg.solve_lower(lower, sensor.residual(plain, expected))
        return (white * white).sum(), 2 * jnp.log(jnp.diagonal(lower)).sum()

    return jax.vmap(one)(detections)


def _by_mixture(
    residual: Callable[[Array, Array], Array], weight: Array, sights: views.Sight
) -> tuple[Array, Array]:
    """Pools what is expected, as seen from the heaviest: angles may wrap."""
    heaviest = sights.expected[jnp.argmax(weight)]
    offset = jax.vmap(residual, (0, None))(sights.expected, heaviest)
    lower = dense(sights.lower)
    pooled = mixture.moment_match(weight, offset, lower @ jnp.swapaxes(lower, -1, -2))
    return heaviest + pooled.mean, linalg.cholesky(pooled.cov)


def _by_largest(
    residual: Callable[[Array, Array], Array], weight: Array, sights: views.Sight
) -> tuple[Array, Array]:
    """Takes the component with the largest innovation covariance, by determinant."""
    del residual
    volume = jnp.where(weight > 0, -sights.log_scale, -jnp.inf)
    largest = jax.tree.map(lambda x: x[jnp.argmax(volume)], sights)
    return largest.expected, dense(largest.lower)
