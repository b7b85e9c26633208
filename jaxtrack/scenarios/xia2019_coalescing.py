"""Four targets that meet in the middle: Xia et al. 2019, scenario 2.

Printed, and used: half way through the states of all are drawn from a Gaussian with
mean 0 and the covariance I, and constant velocity takes them from there, backwards and
forwards; births have one place, the origin, known to 100 m and 1 m/s. The rest stands
in `xia2019`. Not printed: which draw; it is the first one here.

    >>> from jaxtrack.scenarios import xia2019_coalescing
    >>> made = xia2019_coalescing.make()
    >>> made.world.truth.exists.sum(1)[::10].tolist()
    [1, 2, 3, 4, 4, 4, 3, 2, 1]

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, section VII and figures 2 to 4.
"""

import functools

import jax.numpy as jnp
import numpy as np

from jaxtrack.scenarios import xia2019
from jaxtrack.scenarios.world import Scenario, Truth

PLACE = np.zeros((1, 4))
COV = np.diag([100.0, 1.0, 100.0, 1.0]) ** 2


def make(
    clutter_rate: float = 10.0, detect_prob: float = 0.9, region: float = 100.0
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
        region: Half the width of the square that is watched, m.
    """
    return xia2019.make(
        "xia2019-coalescing",
        "four targets that meet in the middle (Xia 2019)",
        truth(),
        (PLACE, COV),
        (32, 160, 24),
        clutter_rate,
        detect_prob,
        region,
    )


@functools.cache
def truth() -> Truth:
    """Returns the four, [81, 4, 4]."""
    rng, half = np.random.default_rng(0), xia2019.SCANS // 2
    lower, back = np.linalg.cholesky(xia2019.NOISE), np.linalg.inv(xia2019.STEP)
    middle = rng.normal(size=(4, 4))
    after, before = xia2019.walk(middle, half + 1, rng), [middle]
    for _ in range(half):
        shaken = before[-1] + rng.normal(size=middle.shape) @ lower.T
        before.append(shaken @ back.T)
    state = np.concatenate([np.stack(before[:0:-1]), after])
    scan = np.arange(1, xia2019.SCANS + 1)[:, None]
    born, died = (np.array(x)[::-1] for x in (xia2019.BORN, xia2019.DIED))
    exists = (born <= scan) & (scan <= died)
    time = np.arange(xia2019.SCANS, dtype=float)
    return Truth(jnp.asarray(state), jnp.asarray(exists), jnp.asarray(time))
