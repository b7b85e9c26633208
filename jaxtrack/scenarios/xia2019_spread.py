"""Targets far from each other, born at four known places: Xia et al. 2019, scenario 1.

Printed, and used: no two are born at the same place in the same scan; the places, (50,
50) m, (50, -50), (-50, 50) and (-50, -50), known to 2 m and to 1 m/s. The rest stands
in `xia2019`.

Printed, and not used unless `born_together` is 3: that there are 12 targets. Table I is
not of so many: its localisation error, 120 m in all scans together, is that of a Kalman
filter that knows whose each detection is where one target is born each time; where
three are, it has 208 m.

Not printed, and chosen: who is born where and dies when; the region, 600 m wide, three
standard deviations of the births of the second scenario (with 200 m, as there, clutter
at the places of birth makes three times the false targets of Table I); first states are
drawn from the density of births, and paths are the first draw in which no two come
nearer than `APART` while both are there, and none goes beyond `EDGE`.

    >>> from jaxtrack.scenarios import xia2019_spread
    >>> made = xia2019_spread.make()
    >>> made.world.truth.exists.sum(1)[::10].tolist()
    [1, 2, 3, 4, 4, 4, 3, 2, 1]

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, section VII and table I.
"""

import functools

import jax.numpy as jnp
import numpy as np

from jaxtrack.scenarios import xia2019
from jaxtrack.scenarios.world import Scenario, Truth

PLACES = np.array(
    [[50, 0, 50, 0], [50, 0, -50, 0], [-50, 0, 50, 0], [-50, 0, -50, 0.0]]
)
COV = np.diag([4.0, 1.0, 4.0, 1.0])
APART, EDGE = 5.0, 100.0  # metres


def make(
    clutter_rate: float = 10.0,
    detect_prob: float = 0.9,
    region: float = 300.0,
    born_together: float = 1,
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
        region: Half the width of the square that is watched, m.
        born_together: Targets that are born each time, 1 to 4, at different places.

    Raises:
        ValueError: Not so many targets.
    """
    number = int(born_together)
    if number != born_together or not 1 <= number <= len(PLACES):
        raise ValueError(
            f"born_together is {born_together}; give a whole number from 1 to 4"
        )
    return xia2019.make(
        "xia2019-spread",
        f"{4 * number} targets far from each other, born at four places (Xia 2019)",
        truth(number),
        (PLACES, COV),
        (24, 10, 12),
        clutter_rate,
        detect_prob,
        region,
    )


@functools.cache
def truth(number: int) -> Truth:
    """Returns 4 `number` targets, [81, 4 number, 4]."""
    seed = 0
    while (drawn := _draw(number, np.random.default_rng(seed))) is None:
        seed += 1
    return drawn


def _draw(number: int, rng: np.random.Generator) -> Truth | None:
    """Draws the paths; None if two come near or one leaves."""
    index = np.arange(4 * number)[::-1]
    times, place = index % 4, (index + index // 4) % 4
    lower = np.linalg.cholesky(COV)
    start = PLACES[place] + rng.normal(size=(4 * number, 4)) @ lower.T
    born, died = np.array(xia2019.BORN)[times], np.array(xia2019.DIED)[times]
    scan = np.arange(1, xia2019.SCANS + 1)
    exists = (born <= scan[:, None]) & (scan[:, None] <= died)
    paths = xia2019.walk(start, xia2019.SCANS, rng)
    state = np.where(exists[..., None], 0.0, start[None])
    for n, first in enumerate(born - 1):
        state[first:, n] = paths[: xia2019.SCANS - first, n]
    where = state[..., [0, 2]]
    gap = np.linalg.norm(where[:, :, None] - where[:, None], axis=-1)
    both = exists[:, :, None] & exists[:, None] & ~np.eye(4 * number, dtype=bool)
    near = both & (gap < APART)
    if near.any() or (np.abs(where[exists]) > EDGE).any():
        return None
    time = np.arange(xia2019.SCANS, dtype=float)
    return Truth(jnp.asarray(state), jnp.asarray(exists), jnp.asarray(time))
