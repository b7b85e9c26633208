"""Linear motion models in one to three dimensions, for any interval.

A model is a tuple of values and says `dim`, `position_index`, `velocity_index` and
whether it is `linear`. `move(state[D], interval)` is its mean motion over `interval`
seconds, `noise(interval)` the covariance [D, D] of what is added, and a linear one has
`transition(interval)` [D, D]. The number P of axes is the length of its values, which
are arrays. The state holds the axes one after another, each [position, velocity,
(acceleration)], in SI units. All noises are exact integrals, so that two half steps
equal one whole step; only `PiecewiseAcceleration` depends on where the steps are cut.
An interval of 0 moves nothing and adds nothing.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.motion import ConstantVelocity
    >>> motion = ConstantVelocity(noise_density=jnp.array([1.0, 1.0]))
    >>> print(motion.move(jnp.array([0.0, 1.0, 5.0, -2.0]), 2.0))
    [ 2.  1.  1. -2.]

References: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking
and navigation", 2001, sections 6.2 and 8.2; Singer, "Estimating optimal tracking
filter performance for manned maneuvering targets", IEEE Trans. Aerospace and Electronic
Systems 6(4), 1970; Yuan 2013, eq. 42.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.constraints import Positive
from jaxtrack.entries import Matrix
from jaxtrack.models import special
from jaxtrack.types import Array, PyTree


class ConstantVelocity(NamedTuple):
    """Moves in a straight line under white acceleration, [position, velocity] an axis.

    Attributes:
        noise_density: Power spectral density of the acceleration, m^2/s^3, [P].
    """

    noise_density: Positive
    linear = True

    @property
    def dim(self) -> int:
        """Returns the number of state components, 2 P."""
        return 2 * len(self.noise_density)

    @property
    def position_index(self) -> tuple[int, ...]:
        """Returns where the positions stand in the state."""
        return tuple(range(0, self.dim, 2))

    @property
    def velocity_index(self) -> tuple[int, ...]:
        """Returns where the velocities stand in the state."""
        return tuple(range(1, self.dim, 2))

    def move(self, state: Array, interval: Array) -> Array:
        """Returns the expected state [D] after `interval` seconds."""
        return self.transition(interval) @ state

    def transition(self, interval: Array) -> Matrix:
        """Returns the transition matrix, [D, D]."""
        block = [[1, linalg.floating(interval)], [0, 1]]
        return special.block_diagonal([block] * len(self.noise_density))

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [D, D]."""
        t = linalg.floating(interval)
        unit = [[t**3 / 3, t**2 / 2], [t**2 / 2, t]]
        return special.scaled_blocks(unit, self.noise_density)


class ConstantAcceleration(NamedTuple):
    """Keeps its acceleration but for white jerk, three components an axis.

    Attributes:
        noise_density: Power spectral density of the jerk, m^2/s^5, [P].
    """

    noise_density: Positive
    linear = True

    @property
    def dim(self) -> int:
        """Returns the number of state components, 3 P."""
        return 3 * len(self.noise_density)

    @property
    def position_index(self) -> tuple[int, ...]:
        """Returns where the positions stand in the state."""
        return tuple(range(0, self.dim, 3))

    @property
    def velocity_index(self) -> tuple[int, ...]:
        """Returns where the velocities stand in the state."""
        return tuple(range(1, self.dim, 3))

    def move(self, state: Array, interval: Array) -> Array:
        """Returns the expected state [D] after `interval` seconds."""
        return self.transition(interval) @ state

    def transition(self, interval: Array) -> Matrix:
        """Returns the transition matrix, [D, D]."""
        t = linalg.floating(interval)
        block = [[1, t, t**2 / 2], [0, 1, t], [0, 0, 1]]
        return special.block_diagonal([block] * len(self.noise_density))

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [D, D]."""
        t = linalg.floating(interval)
        unit = [
            [t**5 / 20, t**4 / 8, t**3 / 6],
            [t**4 / 8, t**3 / 3, t**2 / 2],
            [t**3 / 6, t**2 / 2, t],
        ]
        return special.scaled_blocks(unit, self.noise_density)


class Singer(NamedTuple):
    """Manoeuvres with an acceleration that fades away, three components an axis.

    Attributes:
        noise_std: Stationary standard deviation of the acceleration, m/s^2, [P].
        time_constant: Seconds over which an acceleration fades to 1/e, [P].
    """

    noise_std: Positive
    time_constant: Positive
    linear = True

    @property
    def dim(self) -> int:
        """Returns the number of state components, 3 P."""
        return 3 * len(self.noise_std)

    @property
    def position_index(self) -> tuple[int, ...]:
        """Returns where the positions stand in the state."""
        return tuple(range(0, self.dim, 3))

    @property
    def velocity_index(self) -> tuple[int, ...]:
        """Returns where the velocities stand in the state."""
        return tuple(range(1, self.dim, 3))

    def move(self, state: Array, interval: Array) -> Array:
        """Returns the expected state [D] after `interval` seconds."""
        return self.transition(interval) @ state

    def transition(self, interval: Array) -> Matrix:
        """Returns the transition matrix, [D, D]."""
        t = linalg.floating(interval)
        keep, once, twice = special.exponentials(-t / self.time_constant, 2)
        blocks = [
            [[1, t, t**2 * c], [0, 1, t * b], [0, 0, a]]
            for a, b, c in zip(keep, once, twice, strict=True)
        ]
        return special.block_diagonal(blocks)

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [D, D].

        Singer's closed form, with the powers of interval / time_constant that cancel
        taken out, so that it keeps its digits for short intervals.
        """
        t = linalg.floating(interval)
        x = t / self.time_constant
        both = special.exponentials(jnp.stack([-x, -2 * x]), 5)
        e, twin = zip(*both, strict=True)
        power = self.noise_std**2 * x  # density 2 std^2 / time_constant, times t / 2
        pp = power * t**4 * (32 * twin[5] - 4 * e[4])
        pv = power * t**3 * e[2] ** 2
        pa = power * t**2 * (8 * twin[3] - 2 * e[2])
        vv = power * t**2 * (8 * twin[3] - 4 * e[3])
        va = power * t * e[1] ** 2
        aa = power * 2 * twin[1]
        entries = zip(pp, pv, pa, vv, va, aa, strict=True)
        return special.block_diagonal(
            [[[a, b, c], [b, d, f], [c, f, g]] for a, b, c, d, f, g in entries]
        )


class OrnsteinUhlenbeck(NamedTuple):
    """Wanders about the origin; position and velocity are both stationary.

    A critically damped oscillator under white acceleration. The velocity has standard
    deviation position_std / time_constant, and over times much shorter than
    `time_constant` it moves as `ConstantVelocity` with noise density
    4 position_std^2 / time_constant^3.

    Attributes:
        position_std: Stationary standard deviation of the position, m, [P].
        time_constant: Seconds, [P]; the correlation of the position after t seconds is
            (1 + t / time_constant) exp(-t / time_constant).
    """

    position_std: Positive
    time_constant: Positive
    linear = True

    @property
    def dim(self) -> int:
        """Returns the number of state components, 2 P."""
        return 2 * len(self.position_std)

    @property
    def position_index(self) -> tuple[int, ...]:
        """Returns where the positions stand in the state."""
        return tuple(range(0, self.dim, 2))

    @property
    def velocity_index(self) -> tuple[int, ...]:
        """Returns where the velocities stand in the state."""
        return tuple(range(1, self.dim, 2))

    def move(self, state: Array, interval: Array) -> Array:
        """Returns the expected state [D] after `interval` seconds."""
        return self.transition(interval) @ state

    def transition(self, interval: Array) -> Matrix:
        """Returns the transition matrix, [D, D]."""
        t = linalg.floating(interval)
        x = t / self.time_constant
        fade = jnp.exp(-x)
        entries = zip(x, fade, self.time_constant, strict=True)
        return special.block_diagonal(
            [[[f * (1 + a), f * t], [-f * a / c, f * (1 - a)]] for a, f, c in entries]
        )

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [D, D]."""
        t = linalg.floating(interval)
        y = 2 * t / self.time_constant
        small = y < 2
        near = jnp.where(small, y, 0.0)
        series = jnp.exp(-near) * near**3 * special.exponentials(near, 3)[3]
        gone = jnp.where(small, series, 1 - jnp.exp(-y) * (1 + y + y**2 / 2))
        pp = self.position_std**2 * gone
        pv = self.position_std**2 / self.time_constant * y**2 * jnp.exp(-y) / 2
        speed_var = (self.position_std / self.time_constant) ** 2
        vv = speed_var * (gone + 2 * y * jnp.exp(-y))
        entries = zip(pp, pv, vv, strict=True)
        return special.block_diagonal([[[a, b], [b, c]] for a, b, c in entries])


class PiecewiseAcceleration(NamedTuple):
    """Adds to a motion an acceleration drawn anew for each interval and then constant.

    The noise gains std^2 G G^T on each axis, with G = [interval^2 / 2, interval] over
    position and velocity (Yuan 2013, eq. 42). Two half steps differ from a whole one.

    Attributes:
        motion: Any motion model; everything but the noise is its own.
        std: Standard deviation of the acceleration, m/s^2, [P].
    """

    motion: PyTree
    std: Positive

    @property
    def linear(self) -> bool:
        """Returns whether the motion has a transition matrix."""
        return self.motion.linear

    @property
    def dim(self) -> int:
        """Returns the number of state components."""
        return self.motion.dim

    @property
    def position_index(self) -> tuple[int, ...]:
        """Returns where the positions stand in the state."""
        return self.motion.position_index

    @property
    def velocity_index(self) -> tuple[int, ...]:
        """Returns where the velocities stand in the state."""
        return self.motion.velocity_index

    def move(self, state: Array, interval: Array) -> Array:
        """Returns the expected state [D] after `interval` seconds."""
        return self.motion.move(state, interval)

    def transition(self, interval: Array) -> Matrix:
        """Returns the transition matrix, [D, D]; only where the motion has one."""
        return self.motion.transition(interval)

    def noise(self, interval: Array) -> Matrix:
        """Returns the motion's noise and that of the acceleration, [D, D]."""
        t = linalg.floating(interval)
        entries: list[list[Any]] = [[0] * self.dim for _ in range(self.dim)]
        index = zip(self.position_index, self.velocity_index, strict=True)
        for (p, v), std in zip(index, self.std, strict=True):
            entries[p][p] = std**2 * t**4 / 4
            entries[p][v] = entries[v][p] = std**2 * t**3 / 2
            entries[v][v] = std**2 * t**2
        return self.motion.noise(interval) + Matrix(entries)
