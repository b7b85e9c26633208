"""Positions whose errors are correlated, such as a radar's converted to the plane.

>>> import jax.numpy as jnp
>>> from jaxtrack.models.converted import ConvertedRangeBearing
>>> radar = ConvertedRangeBearing(jnp.array([10.0, 0.01]), position=jnp.zeros(2))
>>> print(radar.locate(jnp.array([0.0, 4000.0])).cov.round(-2) + 0.0)
[[1600.    0.]
 [   0.  100.]]

Reference: Lerro and Bar-Shalom, "Tracking with debiased consistent converted
measurements versus EKF", IEEE Trans. Aerospace and Electronic Systems 29(3), 1993,
whose bound says where the conversion needs no correction of its bias.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.constraints import Covariance, Fixed, Positive
from jaxtrack.models import polar, trig
from jaxtrack.types import Array, Gaussian


class CorrelatedPosition(NamedTuple):
    """Reports the position itself, [P], with any covariance.

    Attributes:
        noise_cov: m^2, [P, P].
    """

    noise_cov: Covariance
    linear = True

    @property
    def num_outputs(self) -> int:
        """Returns Z, here the number P of axes."""
        return len(self.noise_cov)

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the expected detection, [P]."""
        del velocity
        return position

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns detection - expected, [P]."""
        return detection - expected

    def cov(self) -> Array:
        """Returns the covariance of the noise, [P, P]."""
        return self.noise_cov

    def locate(self, detection: Array) -> Gaussian:
        """Returns the belief about the position, mean [P] and cov [P, P]."""
        return Gaussian(detection, self.noise_cov)


class ConvertedRangeBearing(NamedTuple):
    """Reports where range and bearing place a target in the plane, (x, y) in m, [2].

    The noise depends on the detection: it is that of `polar.locate_plane`, to first
    order, and so is right if range * bearing_std^2 / range_std < 0.4 and bearing_std
    < 0.4 rad. Score and correct with what `sensor.untimed` gives; there is no `cov`.

    Attributes:
        noise_std: Of range (m) and bearing (rad), [2].
        position: Where the sensor stands, m, [2].
    """

    noise_std: Positive
    position: Fixed
    linear = True
    num_outputs = 2

    def at(self, detection: Array) -> CorrelatedPosition:
        """Returns the sensor as it is for this detection [2]."""
        return CorrelatedPosition(self.locate(detection).cov)

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the expected detection, [2]."""
        del velocity
        return position

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns detection - expected, [2]."""
        return detection - expected

    def locate(self, detection: Array) -> Gaussian:
        """Returns the belief about the position, mean [2] and cov [2, 2]."""
        offset = detection - self.position
        distance, angle = polar.length(offset), polar.direction(offset)
        return Gaussian(
            detection, polar.locate_plane(distance, angle, self.noise_std).cov
        )

    def report(self, position: Array, velocity: Array, white: Array) -> Array:
        """Returns a detection [2] with errors drawn in range and bearing.

        Args:
            position: [2].
            velocity: [2].
            white: Standard normal errors, [2].
        """
        del velocity
        offset = position - self.position
        distance = polar.length(offset) + self.noise_std[0] * white[0]
        sin, cos = trig.sincos(polar.direction(offset) + self.noise_std[1] * white[1])
        return self.position + distance * jnp.stack([cos, sin])
