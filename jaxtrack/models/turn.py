"""Turning motion in the plane, state [x, vx, y, vy, (turn rate)].

The velocity rotates at w rad/s, anticlockwise if positive. All is written with the
functions sin(a)/a, (1 - cos(a))/a^2 and (a - sin(a))/a^3 of the angle a = w interval,
which are smooth at 0: values and derivatives are finite where a target does not turn.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.turn import CoordinatedTurn
    >>> quarter = CoordinatedTurn(turn_rate=jnp.pi / 2, noise_density=1.0)
    >>> print(quarter.move(jnp.array([0.0, jnp.pi, 0.0, 0.0]), 1.0).round(4) + 0.0)
    [2.     0.     2.     3.1416]

References: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking
and navigation", 2001, section 11.7; the noise of the turn is the integral of
exp(A s) B B^T exp(A s)^T, done by hand.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.constraints import Positive
from jaxtrack.entries import Matrix, split
from jaxtrack.models import special
from jaxtrack.types import Array, PyTree


class CoordinatedTurn(NamedTuple):
    """Turns at a known rate under white acceleration, state [x, vx, y, vy].

    Attributes:
        turn_rate: rad/s, anticlockwise positive, a scalar; 0 is a straight line.
        noise_density: Power spectral density of the acceleration, the same in all
            directions, m^2/s^3, a scalar.
    """

    turn_rate: Array
    noise_density: Positive
    linear = True
    dim = 4
    position_index = (0, 2)
    velocity_index = (1, 3)

    def move(self, state: Array, interval: Array) -> Array:
        """Returns the expected state [4] after `interval` seconds."""
        return self.transition(interval) @ state

    def transition(self, interval: Array) -> Matrix:
        """Returns the transition matrix, [4, 4]."""
        cos, sin, along, across = self.parts(interval)
        return Matrix(
            [
                [1, along, 0, -across],
                [0, cos, 0, -sin],
                [0, across, 1, along],
                [0, sin, 0, cos],
            ]
        )

    def parts(self, interval: Array) -> tuple[Array, Array, Array, Array]:
        """Returns cosine and sine of the turned angle, and the way of a unit velocity.

        The way is what a velocity of 1 m/s covers in its own direction and across, to
        the left, in seconds.
        """
        t = linalg.floating(interval)
        angle = self.turn_rate * t
        cos, sinc, versine, _ = special.circular(angle)
        return cos, angle * sinc, t * sinc, t * angle * versine

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [4, 4].

        Not that of `ConstantVelocity`: the push received early has turned since, which
        ties the position on one axis to the velocity on the other.
        """
        t = linalg.floating(interval)
        angle = self.turn_rate * t
        _, _, versine, rest = special.circular(angle)
        pp = self.noise_density * t**3 * 2 * rest
        pv = self.noise_density * t**2 * versine
        twist = self.noise_density * t**2 * angle * rest
        vv = self.noise_density * t
        return Matrix(
            [
                [pp, pv, 0, twist],
                [pv, vv, -twist, 0],
                [0, -twist, pp, pv],
                [twist, 0, pv, vv],
            ]
        )


class TurnRate(NamedTuple):
    """Turns at an unknown rate that wanders, state [x, vx, y, vy, turn rate].

    The noise is that of straight motion, so it does not depend on the state; its exact
    form would, by terms of the order of the turned angle.

    Attributes:
        noise_density: Power spectral density of the acceleration, the same in all
            directions, m^2/s^3, a scalar.
        turn_noise_density: Variance that the turn rate gains per second, rad^2/s^3, a
            scalar.
    """

    noise_density: Positive
    turn_noise_density: Positive
    linear = False
    dim = 5
    position_index = (0, 2)
    velocity_index = (1, 3)

    def move(self, state: Array, interval: Array) -> Array:
        """Returns the expected state [5] after `interval` seconds."""
        turn = CoordinatedTurn(state[4], self.noise_density)
        return jnp.append(turn.move(state[:4], interval), state[4])

    def expand(self, state: Array, interval: Array) -> tuple[Array, Matrix]:
        """Returns `move` and its derivative in the state, [5] and [5, 5]."""

        def parts(rate: Array) -> tuple[Array, ...]:
            return CoordinatedTurn(rate, self.noise_density).parts(interval)

        both = jax.jvp(parts, (state[4],), (jnp.ones_like(state[4]),))
        (cos, sin, along, across), slopes = jax.tree.map(linalg.once, both)
        dcos, dsin, dalong, dacross = slopes
        x, vx, y, vy, rate = state
        moved = [
            x + along * vx - across * vy,
            cos * vx - sin * vy,
            y + across * vx + along * vy,
            sin * vx + cos * vy,
            rate,
        ]
        return jnp.stack(moved), Matrix(
            [
                [1, along, 0, -across, dalong * vx - dacross * vy],
                [0, cos, 0, -sin, dcos * vx - dsin * vy],
                [0, across, 1, along, dacross * vx + dalong * vy],
                [0, sin, 0, cos, dsin * vx + dcos * vy],
                [0, 0, 0, 0, 1],
            ]
        )

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [5, 5]."""
        t = linalg.floating(interval)
        q = self.noise_density
        pp, pv, vv = q * t**3 / 3, q * t**2 / 2, q * t
        return Matrix(
            [
                [pp, pv, 0, 0, 0],
                [pv, vv, 0, 0, 0],
                [0, 0, pp, pv, 0],
                [0, 0, pv, vv, 0],
                [0, 0, 0, 0, self.turn_noise_density * t],
            ]
        )


class ForgottenTurn(NamedTuple):
    """Extends a linear motion of 4 components by a turn rate that it does not use.

    The fifth component is drawn anew from N(0, spread^2) at every interval (also at one
    of 0 s), whatever it was: its row of the transition is zero. So a mode without a
    turn rate can share a bank with a `TurnRate`.

    Attributes:
        motion: A linear motion model with state [x, vx, y, vy].
        spread: Standard deviation of the turn rate, rad/s, a scalar.
    """

    motion: PyTree
    spread: Positive
    linear = True

    @property
    def dim(self) -> int:
        """Returns the number of state components, 5."""
        return self.motion.dim + 1

    @property
    def position_index(self) -> tuple[int, ...]:
        """Returns where the positions stand in the state."""
        return self.motion.position_index

    @property
    def velocity_index(self) -> tuple[int, ...]:
        """Returns where the velocities stand in the state."""
        return self.motion.velocity_index

    def move(self, state: Array, interval: Array) -> Array:
        """Returns the expected state [5] after `interval` seconds."""
        return jnp.append(self.motion.move(state[:-1], interval), 0.0)

    def transition(self, interval: Array) -> Matrix:
        """Returns the transition matrix, [5, 5], its last row and column zero."""
        return _extend(self.motion.transition(interval), 0)

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [5, 5]."""
        return _extend(self.motion.noise(interval), self.spread**2)


def _extend(matrix: Array | Matrix, corner: Array | int) -> Matrix:
    """Returns a matrix [D, D] with a last row and column, zero but for the corner."""
    size = len(matrix)
    written = matrix if isinstance(matrix, Matrix) else split(matrix)
    entries = [[*row, 0] for row in written.rows]
    return Matrix([*entries, [0] * size + [corner]])
