"""How a sensor sees a Gaussian: the part of an update that no detection changes.

Many detections are scored against one belief, and few of them correct it. What they
share, the innovation covariance, the gain and the posterior covariance, is worked out
once. Where the detections carry ages (`models.sensor.Timed`) each sees the target at
another place, and where the noise depends on the detection (`models.converted`) each
has another gain: nothing is shared, and the work is done for each.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.targets import views
    >>> from jaxtrack.types import Affine, Gaussian
    >>> prior = Gaussian(mean=jnp.zeros(1), cov=4.0 * jnp.eye(1))
    >>> sensor = Affine(jnp.eye(1), jnp.zeros(1), 4.0 * jnp.eye(1))
    >>> sight = views.see(prior, sensor)
    >>> print(sight.gain, sight.cov)
    [[0.5]] [[2.]]
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import kalman, linalg, linearize, mixture
from jaxtrack.models.sensor import Timed, untimed
from jaxtrack.types import Affine, Array, Gaussian


class Sight(NamedTuple):
    """A Kalman update without its detection.

    Attributes:
        expected: The detection expected, [Z].
        lower: Cholesky factor of the innovation covariance, [Z, Z].
        whitening: Its inverse, [Z, Z].
        log_scale: Log-density of a detection as expected, a scalar.
        gain: [D, Z].
        cov: Covariance after the update, [D, D].
    """

    expected: Array
    lower: Any
    whitening: Any
    log_scale: Array
    gain: Any
    cov: Array


class View(NamedTuple):
    """A Gaussian and how it is seen.

    Attributes:
        prior: mean [D], cov [D, D].
        sight: None where each detection needs its own.
    """

    prior: Gaussian
    sight: Sight | None


def see(prior: Gaussian, sensor: Affine) -> Sight:
    """Prepares the update of a belief.

    Args:
        prior: mean [D], cov [D, D].
        sensor: matrix [Z, D], offset [Z], cov [Z, Z].
    """
    matrix, offset, noise = sensor
    expected = matrix @ prior.mean + offset
    lower = linalg.cholesky(linalg.congruence(matrix, prior.cov) + noise)
    identity = jnp.eye(expected.size, dtype=expected.dtype)
    # No surprise, to the last bit: what is left is the scale.
    posterior, log_scale = kalman.update(
        prior, sensor, expected, residual=lambda z, _: jnp.zeros_like(z)
    )
    return Sight(
        expected=expected,
        lower=lower,
        whitening=linalg.solve_lower(lower, identity),
        log_scale=log_scale,
        gain=linalg.solve(lower, linalg.product(matrix, prior.cov)).T,
        cov=posterior.cov,
    )


def look(method: linearize.Method, params: Any, prior: Gaussian) -> View:
    """Looks at a belief through a target's sensor.

    Args:
        method: Of `linearize`; idle where the sensor is linear.
        params: A target's `Params`, with its `sensor` and `layout`.
        prior: mean [D], cov [D, D].
    """
    if isinstance(params.sensor, Timed) or hasattr(params.sensor, "at"):
        return View(prior, None)
    affine = linearize.sensor_affine(params.sensor, params.layout, prior, method)
    return View(prior, see(prior, affine))


def score(
    method: linearize.Method, params: Any, view: View, detections: Array
) -> Array:
    """Returns the log-densities of detections [K, Z], [K]."""

    def one(detection: Array) -> Array:
        sight, surprise = meet(method, params, view, detection)
        return _log_density(sight, surprise)

    return jax.vmap(one)(detections)


def distance(
    method: linearize.Method, params: Any, view: View, detections: Array
) -> tuple[Array, Array]:
    """Returns squared Mahalanobis distances of detections [K, Z], and log-determinants.

    Both are [K], and go by the innovation covariance.
    """

    def one(detection: Array) -> tuple[Array, Array]:
        sight, surprise = meet(method, params, view, detection)
        white = linalg.product(sight.whitening, linalg.column(surprise))
        turns = surprise.size * jnp.log(2 * jnp.pi)
        return linalg.square(white), -2 * sight.log_scale - turns

    return jax.vmap(one)(detections)


def correct(
    method: linearize.Method, params: Any, view: View, detection: Array
) -> tuple[Gaussian, Array]:
    """Conditions a belief on a detection [Z]; returns its log-density, too."""
    sight, surprise = meet(method, params, view, detection)
    mean = view.prior.mean + sight.gain @ surprise
    return Gaussian(mean, sight.cov), _log_density(sight, surprise)


def average_score(
    method: linearize.Method,
    params: Any,
    view: View,
    weight: Array,
    detections: Array,
) -> Array:
    """Returns the log-density N(r; 0, S) of an average residual r.

    Args:
        method: Of `linearize`.
        params: A target's `Params`.
        view: How the belief is seen.
        weight: Of each residual in the average, [K].
        detections: [K, Z].

    Returns:
        A scalar.
    """

    def one(detection: Array) -> tuple[Array, Array]:
        sight, surprise = meet(method, params, view, detection)
        return sight.whitening @ surprise, sight.log_scale

    white, log_scale = jax.vmap(one)(detections)
    total = weight.sum()
    share = jnp.where(total > 0, weight / jnp.where(total > 0, total, 1.0), 0.0)
    white = (weight[:, None] * white).sum(0)
    return (share * log_scale).sum() - (white * white).sum() / 2


def blend(
    method: linearize.Method,
    params: Any,
    view: View,
    weight: Array,
    detections: Array,
) -> Gaussian:
    """Moment-matches what a belief becomes if one of K detections is its, or none.

    Args:
        method: Of `linearize`.
        params: A target's `Params`.
        view: How the belief is seen.
        weight: Probability of each detection and, last, of none, [K + 1].
        detections: [K, Z].

    Returns:
        The posterior (Bar-Shalom and Fortmann 1988, section 6.4, whose gain and
        covariances all detections share).
    """
    weight, missed = weight[:-1], weight[-1]
    prior, sight = view
    if sight is None:
        each, _ = jax.vmap(functools.partial(correct, method, params, view))(detections)
        mean, cov = (
            jnp.concatenate([few, one[None]])
            for few, one in zip(each, prior, strict=True)
        )
        return mixture.moment_match(jnp.append(weight, missed), mean, cov)

    def surprise(detection: Array) -> Array:
        return meet(method, params, view, detection)[1]

    surprises = jax.vmap(surprise)(detections)
    average = (weight[:, None] * surprises).sum(0)
    gap = surprises - average[None]
    spread = (weight[:, None, None] * gap[:, :, None] * gap[:, None, :]).sum(0)
    spread = spread + missed * average[:, None] * average[None]
    cov = missed * prior.cov + weight.sum() * sight.cov
    return Gaussian(
        prior.mean + sight.gain @ average,
        cov + linalg.congruence(sight.gain, spread),
    )


def meet(
    method: linearize.Method, params: Any, view: View, detection: Array
) -> tuple[Sight, Array]:
    """Returns how a detection is seen, and how far it is from what was expected."""
    sensor, plain = untimed(params.sensor, detection)
    sight = view.sight
    if sight is None:
        affine = linearize.sensor_affine(sensor, params.layout, view.prior, method)
        sight = see(view.prior, affine)
    return sight, sensor.residual(plain, sight.expected)


def _log_density(sight: Sight, surprise: Array) -> Array:
    white = linalg.product(sight.whitening, linalg.column(surprise))
    return sight.log_scale - linalg.square(white) / 2
