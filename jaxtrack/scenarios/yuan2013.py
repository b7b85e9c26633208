"""Truth and constants that the two scenarios of Yuan, Lian and Han 2013 share.

Source: section 6.1, Table 1 and equation 45. Not printed: the initial velocities. They
are chosen here so that the targets start at the paper's birth places, turn at the rates
of its model set, stay in its region and keep to the times of Table 1:

    target   born   dies   start (x, vx, y, vy)       legs
    1         1 s   30 s   (-600,  22,  800, -26)     straight to 15 s, then  pi/20
    2         1 s   35 s   (-650,  28, -800,   6)     pi/30 to 20 s, then straight
    3        10 s   42 s   ( 400, -20, -400,  25)     pi/15 to 30 s, then straight
    4        20 s   50 s   (-600,  24,  800, -10)     straight to 30 s, then -pi/30

The truth has no process noise: all runs share the trajectories, as in the paper, and
differ in noise, misses and clutter. A target exists from its first to its last second.

    >>> from jaxtrack.scenarios import yuan2013
    >>> print(yuan2013.truth().exists.sum(1).max())
    4
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxtrack.scenarios.world import Truth, turn_matrix
from jaxtrack.trackers import cbmember, cphd, phd
from jaxtrack.types import Target, Tracker

REGION = 1000.0  # metres, the half width of the square that is watched
DURATION = 50  # scans, one a second
BIRTH_PROB = (0.04, 0.02, 0.02)
BIRTH_PLACES = ((-600.0, 800.0), (-650.0, -800.0), (400.0, -400.0))
BIRTH_VARIANCE = 400.0  # of each position, m^2, and of each velocity, m^2/s^2

# born, dies, start (x, vx, y, vy), first leg ends, turn rates of the two legs
MOTIONS = (
    (1, 30, (-600.0, 22.0, 800.0, -26.0), 15, (0.0, math.pi / 20)),
    (1, 35, (-650.0, 28.0, -800.0, 6.0), 20, (math.pi / 30, 0.0)),
    (10, 42, (400.0, -20.0, -400.0, 25.0), 30, (math.pi / 15, 0.0)),
    (20, 50, (-600.0, 24.0, 800.0, -10.0), 30, (0.0, -math.pi / 30)),
)

# A CPHD filter that waits until one more target is likelier than not reports a newborn
# late; see docs/yuan2013.md.
COUNT_THRESHOLD = 0.25


def intense(
    target: Target, params: cbmember.Params, max_components: int, **sizes: Any
) -> dict[str, tuple[Tracker, phd.Params]]:
    """Makes the paper's rivals, which keep an intensity: PHD and CPHD filters.

    Args:
        target: How one target is filtered.
        params: Of the CBMeMBer filter with the same target.
        max_components: Components of the intensity.
        **sizes: Further settings that the two makers share.

    Returns:
        Trackers and parameters, as "phd" and "cphd".
    """
    values, size = phd.Params(*params), {"max_components": max_components, **sizes}
    counting = cphd.cphd(target, report_threshold=COUNT_THRESHOLD, **size)
    return {"phd": (phd.phd(target, **size), values), "cphd": (counting, values)}


def truth() -> Truth:
    """Returns the four trajectories: state [50, 4, 5], the turn rate last."""
    state = np.zeros((DURATION, len(MOTIONS), 5))
    exists = np.zeros((DURATION, len(MOTIONS)), bool)
    for n, (born, dies, start, end_of_leg, rates) in enumerate(MOTIONS):
        now = np.array(start)
        for second in range(born, dies + 1):
            rate = rates[int(second > end_of_leg)]
            if second > born:
                now = turn_matrix(rate, 1.0) @ now
            state[second - 1, n] = [*now, rate]
            exists[second - 1, n] = True
    return Truth(jnp.asarray(state), jnp.asarray(exists), jnp.arange(1.0, DURATION + 1))
