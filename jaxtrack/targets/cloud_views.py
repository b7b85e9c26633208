"""How a sensor sees a belief made of particles.

What is expected of each particle is worked out once for all detections of a scan, but
where the detections carry ages (`models.sensor.Timed`) or have noise of their own
(`models.converted`).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.sensor import Position, Timed
    >>> from jaxtrack.targets import cloud_views
    >>> one_for_all = cloud_views.shares(Position(jnp.ones(1)))
    >>> print(one_for_all, cloud_views.shares(Timed(Position(jnp.ones(1)))))
    True False
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg, mixture, particle
from jaxtrack.entries import dense
from jaxtrack.linalg import safe_log
from jaxtrack.models.sensor import Timed, untimed
from jaxtrack.targets import clouds
from jaxtrack.targets.clouds import Belief
from jaxtrack.types import Array


class View(NamedTuple):
    """A belief as the sensor sees it.

    Attributes:
        belief: L particles.
        log_detect: Log-probability to detect each, [L].
        expected: Detection expected of each, [L, Z]; None where each detection has its
            own.
    """

    belief: Belief
    log_detect: Array
    expected: Array | None


def shares(sensor: Any) -> bool:
    """Returns whether what is expected of a particle is the same for all detections."""
    return not (isinstance(sensor, Timed) or hasattr(sensor, "at"))


def look(params: Any, belief: Belief) -> View:
    """Looks at all particles through a target's sensor."""
    log_detect = safe_log(clouds.prob(params.detect, belief))
    if not shares(params.sensor):
        return View(belief, log_detect, None)
    return View(belief, log_detect, _expected(params.sensor, params, belief))


def measure(sensor: Any, layout: Any, state: Array) -> Array:
    """Returns the detection expected of a state [D], [Z]."""
    position = jnp.stack([state[i] for i in layout.position_index])
    velocity = jnp.stack([state[i] for i in layout.velocity_index])
    return sensor.measure(position, velocity)


def log_density_of(params: Any, state: Array, detection: Array) -> Array:
    """Returns the log-density of a detection [Z] where a target is at a state [D]."""
    sensor, plain = untimed(params.sensor, detection)
    expected = measure(sensor, params.layout, state)
    lower = linalg.cholesky(sensor.cov())
    return linalg.log_normal(sensor.residual(plain, expected), lower)


def _expected(sensor: Any, params: Any, belief: Belief) -> Array:
    """Returns the detection expected of each particle, [L, Z]."""
    return jax.vmap(lambda x: measure(sensor, params.layout, x))(belief.state)


def _log_density(params: Any, view: View, detection: Array) -> Array:
    """Returns the log-density of a detection [Z] where each particle is, [L]."""
    sensor, plain = untimed(params.sensor, detection)
    expected = view.expected
    if expected is None:
        expected = _expected(sensor, params, view.belief)
    lower = linalg.cholesky(sensor.cov())
    return jax.vmap(lambda x: linalg.log_normal(sensor.residual(plain, x), lower))(
        expected
    )


def score(params: Any, view: View, detections: Array) -> Array:
    """Returns the log-densities of detections [K, Z], times that of detection, [K]."""
    log_weight = view.belief.log_weight + view.log_detect

    def one(detection: Array) -> Array:
        return mixture.total(log_weight + _log_density(params, view, detection))

    return jax.vmap(one)(detections)


def distance(params: Any, view: View, detections: Array) -> tuple[Array, Array]:
    """Measures how far detections [K, Z] are from what is expected.

    By the covariance of all that is expected, noise and all, as seen from the heaviest
    particle, since angles may wrap.

    Returns:
        Squared Mahalanobis distances [K], and log-determinants of the covariances [K].
    """
    log_weight = view.belief.log_weight + view.log_detect
    heaviest = jnp.argmax(log_weight)

    def one(detection: Array) -> tuple[Array, Array]:
        sensor, plain = untimed(params.sensor, detection)
        expected = view.expected
        if expected is None:
            expected = _expected(sensor, params, view.belief)
        centre = expected[heaviest]
        gap = jax.vmap(sensor.residual, (0, None))(expected, centre)
        cloud = particle.moments(particle.Particles(log_weight, gap, view.belief.mode))
        lower = linalg.cholesky(cloud.cov + dense(sensor.cov()))
        white = linalg.solve_lower(lower, sensor.residual(plain, centre + cloud.mean))
        return (white * white).sum(), 2 * jnp.log(jnp.diagonal(lower)).sum()

    return jax.vmap(one)(detections)


def log_factor(params: Any, view: View, detection: Array) -> Array:
    """Returns what a detection [Z] multiplies the weights by, in logarithms, [L]."""
    return view.log_detect + _log_density(params, view, detection)
