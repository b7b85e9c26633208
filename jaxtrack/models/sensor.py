"""Sensors: what is reported about a target at a position and velocity.

`measure(position[P], velocity[P])` is the expected detection [Z], `residual(detection,
expected)` their difference with angles wrapped to [-pi, pi), `cov()` the noise [Z, Z],
`num_outputs` is Z. `linear` says that `measure` is a linear map; then it also takes the
matrices that pick position and velocity from a state, [P, D]. Where a detection gives a
position, `locate(detection)` is the belief about it. Angles are in radians from the
sensor's x-axis, which is the world's turned anticlockwise by `heading`; bearings and
azimuths grow anticlockwise, elevations upwards. Gradients are finite everywhere, also
at the sensor's own position, where those of an angle are 0.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.sensor import RangeBearing
    >>> radar = RangeBearing(noise_std=jnp.array([10.0, 0.01]), position=jnp.zeros(2),
    ...                      heading=jnp.pi / 2)
    >>> print(radar.measure(jnp.array([0.0, 500.0]), jnp.zeros(2)))
    [500.   0.]
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.constraints import Fixed, Positive
from jaxtrack.entries import Matrix, dense
from jaxtrack.models import polar, special
from jaxtrack.types import Array, Gaussian, PyTree


class Position(NamedTuple):
    """Reports the position itself, [P].

    Attributes:
        noise_std: m, [P].
    """

    noise_std: Positive
    linear = True

    @property
    def num_outputs(self) -> int:
        """Returns Z, here the number P of axes."""
        return len(self.noise_std)

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the expected detection, [P]."""
        del velocity
        return position

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns detection - expected, [P]."""
        return detection - expected

    def cov(self) -> Matrix:
        """Returns the covariance of the noise, [P, P]."""
        return special.diagonal(self.noise_std)

    def locate(self, detection: Array) -> Gaussian:
        """Returns the belief about the position, mean [P] and cov [P, P]."""
        return Gaussian(detection, dense(self.cov()))


class RangeBearing(NamedTuple):
    """Reports range (m) and bearing (rad) in the plane.

    Attributes:
        noise_std: Of range (m) and bearing (rad), [2].
        position: Where the sensor stands, m, [2].
        heading: rad, anticlockwise, a scalar.
    """

    noise_std: Positive
    position: Fixed
    heading: Fixed
    linear = False
    num_outputs = 2

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the expected range and bearing, [2]."""
        del velocity
        offset = position - self.position
        return jnp.stack(
            [polar.length(offset), polar.wrap(polar.direction(offset) - self.heading)]
        )

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns detection - expected, the bearing wrapped, [2]."""
        gap = detection - expected
        return jnp.stack([gap[0], polar.wrap(gap[1])])

    def cov(self) -> Matrix:
        """Returns the covariance of the noise, [2, 2]."""
        return special.diagonal(self.noise_std)

    def locate(self, detection: Array) -> Gaussian:
        """Returns the belief about the position, mean [2] and cov [2, 2]."""
        angle = detection[1] + self.heading
        place = polar.locate_plane(detection[0], angle, self.noise_std)
        return Gaussian(self.position + place.mean, place.cov)


class RangeBearingRate(NamedTuple):
    """Reports range (m), bearing (rad) and range rate (m/s, positive if receding).

    Attributes:
        noise_std: Of range (m), bearing (rad) and range rate (m/s), [3].
        position: Where the sensor stands, m, [2]; it does not move.
        heading: rad, anticlockwise, a scalar.
    """

    noise_std: Positive
    position: Fixed
    heading: Fixed
    linear = False
    num_outputs = 3

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the expected range, bearing and range rate, [3]."""
        offset = position - self.position
        distance = polar.length(offset)
        away = offset / jnp.where(distance > 0, distance, 1.0)
        bearing = polar.wrap(polar.direction(offset) - self.heading)
        return jnp.stack([distance, bearing, (away * velocity).sum()])

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns detection - expected, the bearing wrapped, [3]."""
        gap = detection - expected
        return jnp.stack([gap[0], polar.wrap(gap[1]), gap[2]])

    def cov(self) -> Matrix:
        """Returns the covariance of the noise, [3, 3]."""
        return special.diagonal(self.noise_std)

    def locate(self, detection: Array) -> Gaussian:
        """Returns the belief about the position, as `RangeBearing.locate` does."""
        plain = RangeBearing(self.noise_std[:2], self.position, self.heading)
        return plain.locate(detection[:2])


class BearingOnly(NamedTuple):
    """Reports a bearing (rad) in the plane, [1]; it cannot locate.

    Attributes:
        noise_std: rad, [1].
        position: Where the sensor stands, m, [2].
        heading: rad, anticlockwise, a scalar.
    """

    noise_std: Positive
    position: Fixed
    heading: Fixed
    linear = False
    num_outputs = 1

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the expected bearing, [1]."""
        del velocity
        return polar.wrap(polar.direction(position - self.position) - self.heading)[
            None
        ]

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns detection - expected, wrapped, [1]."""
        return polar.wrap(detection - expected)

    def cov(self) -> Matrix:
        """Returns the covariance of the noise, [1, 1]."""
        return special.diagonal(self.noise_std)


class AzimuthElevationRange(NamedTuple):
    """Reports azimuth (rad), elevation (rad above the x-y plane) and range (m).

    Attributes:
        noise_std: Of azimuth (rad), elevation (rad) and range (m), [3].
        position: Where the sensor stands, m, [3].
        heading: Of the azimuth, rad, anticlockwise seen from above, a scalar.
    """

    noise_std: Positive
    position: Fixed
    heading: Fixed
    linear = False
    num_outputs = 3

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the expected azimuth, elevation and range, [3]."""
        del velocity
        offset = position - self.position
        azimuth = polar.wrap(polar.direction(offset[:2]) - self.heading)
        elevation = polar.direction(jnp.stack([polar.length(offset[:2]), offset[2]]))
        return jnp.stack([azimuth, elevation, polar.length(offset)])

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns detection - expected, both angles wrapped, [3]."""
        gap = detection - expected
        return jnp.stack([polar.wrap(gap[0]), polar.wrap(gap[1]), gap[2]])

    def cov(self) -> Matrix:
        """Returns the covariance of the noise, [3, 3]."""
        return special.diagonal(self.noise_std)

    def locate(self, detection: Array) -> Gaussian:
        """Returns the belief about the position, mean [3] and cov [3, 3]."""
        azimuth, elevation, distance = detection
        azimuth = azimuth + self.heading
        place = polar.locate_space(azimuth, elevation, distance, self.noise_std)
        return Gaussian(self.position + place.mean, place.cov)


class Delayed(NamedTuple):
    """Looks at where a target was `age` seconds ago, if its velocity did not change.

    Attributes:
        sensor: The sensor that took the detection.
        age: s, a scalar.
    """

    sensor: PyTree
    age: Fixed

    @property
    def linear(self) -> bool:
        """Returns whether `measure` is linear in position and velocity."""
        return self.sensor.linear

    @property
    def num_outputs(self) -> int:
        """Returns Z of the sensor."""
        return self.sensor.num_outputs

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the detection expected of where the target was, [Z]."""
        return self.sensor.measure(position - velocity * self.age, velocity)

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns the sensor's residual, [Z]."""
        return self.sensor.residual(detection, expected)

    def cov(self) -> Matrix:
        """Returns the sensor's covariance, [Z, Z]."""
        return self.sensor.cov()


class Timed(NamedTuple):
    """A sensor whose detections carry their age as an entry after the last, [Z + 1].

    A detection of age a was taken a seconds before the end of its scan. Score and
    correct with what `untimed` gives; the methods here are those of age 0 and take no
    age, but for `locate`.

    Attributes:
        sensor: The sensor that took the detections.
    """

    sensor: PyTree

    @property
    def linear(self) -> bool:
        """Returns whether `measure` is linear in position and velocity."""
        return self.sensor.linear

    @property
    def num_outputs(self) -> int:
        """Returns Z of the sensor; a detection has one entry more."""
        return self.sensor.num_outputs

    def measure(self, position: Array, velocity: Array) -> Array:
        """Returns the detection expected at the end of the scan, without age, [Z]."""
        return self.sensor.measure(position, velocity)

    def residual(self, detection: Array, expected: Array) -> Array:
        """Returns the sensor's residual of detections without age, [Z]."""
        return self.sensor.residual(detection, expected)

    def cov(self) -> Matrix:
        """Returns the sensor's covariance, [Z, Z]."""
        return self.sensor.cov()

    def locate(self, detection: Array) -> Gaussian:
        """Returns where a detection [Z + 1] with its age was taken.

        The velocity is unknown here, so neither mean nor covariance allows for how far
        the target has gone since.
        """
        return self.sensor.locate(detection[:-1])


def untimed(sensor: PyTree, detection: Array) -> tuple[PyTree, Array]:
    """Returns the sensor and the detection [Z] with which to score and correct.

    A `Timed` sensor becomes `Delayed` by the detection's age, which is cut off, one
    that differs from detection to detection what it is `at` this one; any other comes
    back with its detection as it was.
    """
    if isinstance(sensor, Timed):
        ageless, plain = untimed(sensor.sensor, detection[:-1])
        return Delayed(ageless, detection[-1]), plain
    return (sensor.at(detection) if hasattr(sensor, "at") else sensor), detection
