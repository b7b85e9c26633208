"""Probabilities of survival and detection, which may depend on mode, state or time.

Each model has `prob(mode, state, interval)`, with an int mode (a scalar array), the
full state [D] and the seconds since the last scan; it returns a scalar in [0, 1].

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.probability import Lifetime
    >>> print(f"{Lifetime(mean_seconds=10.0).prob(0, jnp.zeros(4), 10.0):.4f}")
    0.3679
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.constraints import Positive, Probability
from jaxtrack.types import Array


class Constant(NamedTuple):
    """Gives the same probability always.

    Attributes:
        value: A scalar in [0, 1].
    """

    value: Probability

    def prob(self, mode: Array, state: Array, interval: Array) -> Array:
        """Returns the probability, whatever the mode, state and interval."""
        del mode, state, interval
        return linalg.floating(self.value)


class PerMode(NamedTuple):
    """Gives each motion mode a probability of its own.

    Attributes:
        value: In [0, 1], [M].
    """

    value: Probability

    def prob(self, mode: Array, state: Array, interval: Array) -> Array:
        """Returns the probability of this mode, whatever the state and interval."""
        del state, interval
        return linalg.floating(self.value)[mode]


class Lifetime(NamedTuple):
    """Lets a target survive an interval if lifetimes are exponential.

    Attributes:
        mean_seconds: Mean lifetime, s, a scalar.
    """

    mean_seconds: Positive

    def prob(self, mode: Array, state: Array, interval: Array) -> Array:
        """Returns exp(-interval / mean_seconds), whatever the mode and state."""
        del mode, state
        return jnp.exp(-linalg.floating(interval) / self.mean_seconds)


class InsideDisc(NamedTuple):
    """Gives a probability inside a disc that falls smoothly to 0 across its rim.

    A field of view for states [x, vx, y, vy, ...]: the positions are taken from
    components 0 and 2.

    Attributes:
        value: Probability deep inside, in [0, 1], a scalar; on the rim it is half.
        centre: m, [2].
        radius: m, a scalar.
        softness: Metres beyond the rim at which it has fallen to value / (1 + e).
    """

    value: Probability
    centre: Array
    radius: Positive
    softness: Positive

    def prob(self, mode: Array, state: Array, interval: Array) -> Array:
        """Returns the probability at a state's position, whatever mode and interval."""
        del mode, interval
        offset = jnp.stack([state[0] - self.centre[0], state[2] - self.centre[1]])
        square = (offset * offset).sum()
        away = square > 0
        distance = jnp.where(away, jnp.sqrt(jnp.where(away, square, 1.0)), 0.0)
        return self.value * jax.nn.sigmoid((self.radius - distance) / self.softness)
