"""Motion under a known acceleration: a mode for each manoeuvre of a list.

>>> import jax.numpy as jnp
>>> from jaxtrack.models.acceleration import KnownAcceleration
>>> from jaxtrack.models.motion import ConstantVelocity
>>> climb = KnownAcceleration(ConstantVelocity(jnp.ones(1)), jnp.array([20.0]))
>>> print(climb.move(jnp.array([5.0, 3.0]), 2.0))
[51. 43.]

Reference: Li and Zhang, "Multiple-model estimation with variable structure, part V:
likely-model set algorithm", IEEE Trans. Aerospace and Electronic Systems 36(2), 2000.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.entries import Matrix
from jaxtrack.types import Array, PyTree


class KnownAcceleration(NamedTuple):
    """Adds to a linear motion what a constant acceleration does, [P] axes.

    Two half intervals equal a whole one if they do for the motion. It is not `linear`,
    since the origin moves; `expand` is exact wherever it is asked.

    Attributes:
        motion: A linear motion model; its noise and its transition are kept.
        acceleration: m/s^2, [P].
    """

    motion: PyTree
    acceleration: Array
    linear = False

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
        return self.expand(state, interval)[0]

    def expand(self, state: Array, interval: Array) -> tuple[Array, Matrix]:
        """Returns `move` and its derivative in the state, [D] and [D, D]."""
        t, matrix = linalg.floating(interval), self.motion.transition(interval)
        gain = [jnp.zeros((), t.dtype)] * self.dim
        index = zip(self.position_index, self.velocity_index, strict=True)
        for (p, v), push in zip(index, self.acceleration, strict=True):
            gain[p], gain[v] = push * t**2 / 2, push * t
        return matrix @ state + jnp.stack(gain), matrix

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [D, D]."""
        return self.motion.noise(interval)
