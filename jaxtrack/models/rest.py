"""Standing still: a mode for targets that stop, such as moored ships.

>>> import jax.numpy as jnp
>>> from jaxtrack.models.rest import Rest
>>> rest = Rest(wander_density=jnp.array([0.01]), velocity_std=jnp.array([0.1]))
>>> print(rest.move(jnp.array([5.0, 3.0]), 60.0))
[5. 0.]
"""

from typing import NamedTuple

from jaxtrack import linalg
from jaxtrack.constraints import Positive
from jaxtrack.entries import Matrix
from jaxtrack.models import special
from jaxtrack.types import Array


class Rest(NamedTuple):
    """Stays where it is but for a slow random walk, [position, velocity] an axis.

    The velocity before is forgotten, so that a target entering this mode stops and one
    that leaves it starts from nearly zero. The velocity is drawn anew from N(0,
    velocity_std^2) at every interval (also at one of 0 s) and moves nothing.

    Attributes:
        wander_density: Variance that the position gains in a second, m^2/s, [P].
        velocity_std: m/s, [P].
    """

    wander_density: Positive
    velocity_std: Positive
    linear = True

    @property
    def dim(self) -> int:
        """Returns the number of state components, 2 P."""
        return 2 * len(self.wander_density)

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
        """Returns the transition matrix, [D, D], whose rows of velocities are zero."""
        del interval
        stay = [[1, 0], [0, 0]]
        return special.block_diagonal([stay] * len(self.wander_density))

    def noise(self, interval: Array) -> Matrix:
        """Returns the covariance of the noise over `interval` seconds, [D, D]."""
        wander = self.wander_density * linalg.floating(interval)
        entries = zip(wander, self.velocity_std**2, strict=True)
        return special.block_diagonal([[[p, 0], [0, v]] for p, v in entries])
