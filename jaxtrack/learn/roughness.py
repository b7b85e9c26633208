"""How to fit an evidence that is rough: of particles, of hypotheses that come and go.

Particles are resampled, hypotheses kept or not, and which ones jumps with the
parameters. The slope does not see the jumps, and it is the slope that can be trusted,
not the value: the least loss may be where by chance nothing was lost. So what is found
is where slopes are zero on average, the mean of an optimiser's last places, and how
well it is known is told by slopes that lie apart, not next to each other.

    >>> from jaxtrack import learn
    >>> learn.Rough()
    Rough(average=40, apart=0.5, draws=1)

The optimiser should come to rest, or go to and fro in small steps: Adam with a small or
a decaying rate. Trackers that draw do so anew in each step, since a single draw has
valleys of its own.

Reference: Polyak and Juditsky, "Acceleration of stochastic approximation by averaging",
SIAM Journal on Control and Optimization 30(4), 1992.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxtrack.learn import leaves, sizes
from jaxtrack.learn.history import History

FAR = 1.0  # of free numbers: by a factor of e


class Rough(NamedTuple):
    """What a fit does about it.

    Attributes:
        average: Places at the end whose mean, of the free numbers, is what was found.
        apart: Standard errors to each side at which slopes are compared for the
            information; each number's if it were the only one.
        draws: Draws over which these slopes are averaged, for trackers that draw.
    """

    average: int = 40
    apart: float = 0.5
    draws: int = 1


def check(rough: Rough | None) -> None:
    """Raises a ValueError for settings that make no sense."""
    if rough is None:
        return
    if not isinstance(rough, Rough):
        raise ValueError(f"rough is {rough!r}; give learn.Rough(...), or None")
    sizes.check_counts(average=rough.average, draws=rough.draws)
    apart = rough.apart
    if not (isinstance(apart, int | float | np.number) and 0 < apart < np.inf):
        raise ValueError(f"apart is {apart!r}; give a number above 0, e.g. 0.5")


def steps(rough: Rough, alone: np.ndarray) -> np.ndarray:
    """Returns how far to each side slopes are compared, [n].

    Args:
        rough: Settings.
        alone: The information on each free number alone, roughly, [n]; not positive
            where nothing can be said yet.
    """
    error = 1 / np.sqrt(np.maximum(alone, np.finfo(float).tiny))
    return np.minimum(rough.apart * error, FAR)


def mean_of(told: History, rough: Rough) -> leaves.Free:
    """Returns the mean of the last places."""
    return jax.tree.map(lambda x: x[-rough.average :].mean(0), told.free)
