"""Clutter: false detections, a Poisson number in each scan.

A model has `rate`, the expected number per scan; `log_density(detection)`, the log of
rate times the density over the measurement space (-inf where no clutter falls); and
`sample(key, max_count)`. A detection may have entries beyond the model's, such as an
age, which are not looked at.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.clutter import UniformClutter
    >>> clutter = UniformClutter(rate=6.0, low=jnp.zeros(2), high=jnp.array([2.0, 3.0]))
    >>> print(jnp.exp(clutter.log_density(jnp.array([1.0, 1.0]))).round(2))
    1.0
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.constraints import Fixed, Positive
from jaxtrack.models.sensor import RangeBearing
from jaxtrack.types import Array


class UniformClutter(NamedTuple):
    """Falls evenly in a box of the measurement space.

    Attributes:
        rate: Expected number per scan, a scalar.
        low: Lower corner of the box, [Z].
        high: Upper corner, [Z].
    """

    rate: Positive
    low: Fixed
    high: Fixed

    def log_density(self, detection: Array) -> Array:
        """Returns log(rate / volume) inside the box and -inf outside, a scalar."""
        detection = detection[: len(self.low)]
        inside = ((self.low <= detection) & (detection <= self.high)).all()
        log_density = linalg.safe_log(self.rate) - jnp.log(self.high - self.low).sum()
        return jnp.where(inside, log_density, -jnp.inf)

    def sample(self, key: Array, max_count: int) -> tuple[Array, Array]:
        """Draws one scan of clutter; what is more than `max_count` is left out.

        Args:
            key: A random key.
            max_count: Capacity K.

        Returns:
            Detections [K, Z], and which of them are there [K].
        """
        key_count, key_place = jax.random.split(key)
        return (
            _scatter(key_place, self.low, self.high, max_count),
            jnp.arange(max_count) < jax.random.poisson(key_count, self.rate),
        )


class PolarClutter(NamedTuple):
    """Falls evenly in a box of the plane and is reported as range and bearing.

    In range and bearing its density is rate * range / area, over one turn of bearings.

    Attributes:
        rate: Expected number per scan, a scalar.
        low: Lower corner of the box in the plane, m, [2].
        high: Upper corner, m, [2].
        position: Where the sensor stands, m, [2].
        heading: The sensor's heading, rad, a scalar.
    """

    rate: Positive
    low: Fixed
    high: Fixed
    position: Fixed
    heading: Fixed

    def log_density(self, detection: Array) -> Array:
        """Returns the log-density of clutter at (range, bearing, ...), a scalar."""
        distance, angle = detection[0], detection[1] + self.heading
        away = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        place = self.position + distance * away
        inside = ((self.low <= place) & (place <= self.high)).all() & (distance > 0)
        log_area = jnp.log(self.high - self.low).sum()
        log_density = linalg.safe_log(self.rate) + linalg.safe_log(distance) - log_area
        return jnp.where(inside, log_density, -jnp.inf)

    def sample(self, key: Array, max_count: int) -> tuple[Array, Array]:
        """Draws one scan of clutter; what is more than `max_count` is left out.

        Args:
            key: A random key.
            max_count: Capacity K.

        Returns:
            Detections (range, bearing) [K, 2], and which of them are there [K].
        """
        key_count, key_place = jax.random.split(key)
        places = _scatter(key_place, self.low, self.high, max_count)
        radar = RangeBearing(jnp.zeros_like(self.position), self.position, self.heading)
        return (
            jax.vmap(radar.measure, (0, None))(places, jnp.zeros_like(self.position)),
            jnp.arange(max_count) < jax.random.poisson(key_count, self.rate),
        )


def _scatter(key: Array, low: Array, high: Array, max_count: int) -> Array:
    """Returns max_count points evenly spread over a box, [K, Z]."""
    low, high = linalg.floating(low), linalg.floating(high)
    share = jax.random.uniform(key, (max_count, len(low)), low.dtype)
    return low[None] + share * (high - low)[None]
