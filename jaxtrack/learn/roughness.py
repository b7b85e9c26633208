"""How to fit an evidence that is rough: of particles, of hypotheses that come and go.

Particles are resampled, hypotheses kept or not, and which ones jumps with the
parameters. The slope does not see the jumps, and it is the slope that can be trusted,
not the value: the least loss may be where by chance nothing was lost. So what is found
is where slopes are zero on average, the mean of an optimiser's last places, and how
well it is known is told by slopes that lie apart, not next to each other.

    >>> from jaxtrack import learn
    >>> learn.Rough()
    Rough(average=40, apart=0.5, draws=None)

The errors are those of the recordings. What the scatter of drawn slopes adds is not in
them: average over more places until it is small.

Reference: Polyak and Juditsky, "Acceleration of stochastic approximation by averaging",
SIAM Journal on Control and Optimization 30(4), 1992.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxtrack.learn import leaves, sizes
from jaxtrack.learn.history import History

Gradient = Callable[[np.ndarray], np.ndarray]

FIRST = 0.1  # step to each side: a tenth of what must be positive
LEAST, MOST = 1e-3, 1.0
ROUNDS = 6  # in which steps are found
SETTLED = 1.25  # a step that would change by less than this factor stays


class Rough(NamedTuple):
    """What a fit does about it.

    Attributes:
        average: Places at the end whose mean, of the free numbers, is what was found;
            at most half of the steps, so that the way there is not among them.
        apart: Standard errors to each side at which slopes are compared for the
            information, each number's if it were the only one.
        draws: Draws over which these slopes are averaged, for trackers that draw; in
            each step of the fit they then draw anew, since one draw has valleys of its
            own. None for trackers that do not.
    """

    average: int = 40
    apart: float = 0.5
    draws: int | None = None


def check(rough: Rough | None, num_steps: int) -> None:
    """Raises a ValueError for settings that make no sense."""
    if rough is None:
        return
    if not isinstance(rough, Rough):
        raise ValueError(f"rough is {rough!r}; give learn.Rough(...), or None")
    sizes.check_counts(average=rough.average)
    if rough.draws is not None:
        sizes.check_counts(draws=rough.draws)
    if 2 * rough.average > num_steps:
        raise ValueError(
            f"average is {rough.average} and num_steps is {num_steps}; average at most "
            "half of the steps, so that the way there is not among them"
        )
    apart = rough.apart
    if not (isinstance(apart, int | float | np.number) and 0 < apart < np.inf):
        raise ValueError(f"apart is {apart!r}; give a number above 0, e.g. 0.5")


def mean_of(told: History, rough: Rough) -> leaves.Free:
    """Returns the mean of the last places."""
    return jax.tree.map(lambda x: x[-rough.average :].mean(0), told.free)


def secants(gradient: Gradient, centre: np.ndarray, apart: float) -> np.ndarray:
    """Returns what slopes differ by, each number's step being so many of its errors.

    Args:
        gradient: Of the negative log-evidence of all scans, [n] -> [n].
        centre: Where, [n].
        apart: See `Rough`.

    Returns:
        The information, [n, n], a row for each number that was changed; NaN where
        slopes are not finite however near.
    """
    return np.stack([_secant(gradient, centre, i, apart) for i in range(len(centre))])


def _secant(gradient: Gradient, centre: np.ndarray, i: int, apart: float) -> np.ndarray:
    """Returns the row of the i-th number, [n].

    Where slopes are not finite the step is halved; where they do not grow, as beyond a
    narrow valley, it is made smaller, and at last as large as may be.
    """
    step, found = FIRST, None
    for _ in range(ROUNDS):
        row = difference(gradient, centre, i, step)
        if not np.isfinite(row).all():
            step = step / 2
        elif row[i] > 0:
            found, before = row, step
            step = min(apart / float(np.sqrt(row[i])), MOST)
            if 1 / SETTLED < step / before < SETTLED:
                break
        else:
            step = step / 10 if step > LEAST else MOST
    return row if found is None else found


def difference(
    gradient: Gradient, centre: np.ndarray, i: int, step: float
) -> np.ndarray:
    """Returns what slopes differ by over a step of the i-th number, per unit, [n]."""
    move = np.where(np.arange(len(centre)) == i, step, 0).astype(centre.dtype)
    ahead, back = gradient(centre + move), gradient(centre - move)
    return (ahead - back).astype(float) / (2 * step)
