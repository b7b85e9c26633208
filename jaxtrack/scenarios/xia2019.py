"""What the two scenarios of Xia et al. 2019 share, section VII.

Printed, and used: constant velocity with noise density 0.01 m^2/s^3, a scan a second,
81 of them, position noise of 1 m an axis, p_S = 0.99, p_D = 0.9, ten false detections a
scan, births at times 1, 11, 21 and 31 and deaths at 51, 61, 71 and 81, a birth rate of
0.05 a scan at each place, nobody there at first, N = 3, smoothing over four scans,
gates of 0.999, GOSPA of order 2 with cutoff 10 m, a switch cost of 2 m.

Not printed, and chosen: the region, and that a target is still there at the time of its
death, as in the authors' public program. A truth is one draw, the same in all runs.

Unlike the paper's filters, those here sum up over many hypotheses, keep no more than so
many leaves of a tree, and report of the likeliest hypothesis every trajectory that is
likelier than not, where the paper takes as many as are likeliest together. The GLMB
filter keeps 100 hypotheses, the paper's up to 2,000; `lmb` sums exactly over the joint
events of small clusters, `lmb-gibbs` over those that are drawn, as the paper's does.

    >>> from jaxtrack.scenarios import xia2019
    >>> xia2019.CUTOFF, xia2019.SWITCH_COST
    (10.0, 2.0)

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, section VII.
"""

import jax.numpy as jnp
import numpy as np

from jaxtrack.models.birth import MultiBernoulliBirth, PoissonBirth
from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.scenarios.world import Scenario, Truth, World, slots_for
from jaxtrack.targets import single
from jaxtrack.trackers import (
    glmb,
    lmb,
    mbm,
    mht,
    pmb,
    pmbm,
    tmbm,
    tpmbm,
    undetected,
)
from jaxtrack.types import Tracker

SCANS = 81
BORN, DIED = (1, 11, 21, 31), (51, 61, 71, 81)  # first and last scan, from 1
NOISE_DENSITY, SURVIVE = 0.01, 0.99  # m^2/s^3
BIRTH_RATE = 0.05  # in a scan, at each place
CUTOFF, SWITCH_COST = 10.0, 2.0  # m
STEP = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
NOISE = NOISE_DENSITY * np.kron(np.eye(2), [[1 / 3, 1 / 2], [1 / 2, 1.0]])
# Their births.
BERNOULLI = "mbm", "mbm01", "tmbm", "tmbm01", "glmb", "lmb", "lmb-gibbs"


def make(
    name: str,
    summary: str,
    truth: Truth,
    births: tuple[np.ndarray, np.ndarray],
    sizes: tuple[int, int, int],
    clutter_rate: float,
    detect_prob: float,
    region: float,
) -> Scenario:
    """Makes a scenario; the filters are told the true clutter and detection.

    Args:
        name: Of the scenario.
        summary: One line.
        truth: The targets.
        births: Means [B, 4] and covariance [4, 4] of those born in a scan.
        sizes: Trees, and leaves of each, that the filters keep, and trees that TPMBM
            begins in a scan.
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
        region: Half the width of the square that is watched, m.
    """
    corner = jnp.full(2, float(region))
    clutter = UniformClutter(jnp.asarray(clutter_rate, float), -corner, corner)
    motion = ConstantVelocity(NOISE_DENSITY * jnp.ones(2))
    sensor, detect = Position(jnp.ones(2)), Constant(jnp.asarray(detect_prob, float))
    target = single.Params(motion, sensor, Constant(jnp.asarray(SURVIVE)), detect)
    mean, cov = births
    places = (
        jnp.full(len(mean), BIRTH_RATE),
        jnp.asarray(mean),
        jnp.tile(jnp.asarray(cov)[None], (len(mean), 1, 1)),
        jnp.ones((len(mean), 1)),
    )
    poisson = undetected.Params(target, PoissonBirth(*places), clutter)
    bernoullis = undetected.Params(target, MultiBernoulliBirth(*places), clutter)
    return Scenario(
        name=name,
        summary=summary,
        world=World(truth, motion, sensor, detect, clutter),
        trackers={
            each: (tracker, bernoullis if each in BERNOULLI else poisson)
            for each, tracker in trackers(*sizes).items()
        },
        max_detections=slots_for(truth.exists.shape[1], clutter_rate),
        cutoff=CUTOFF,
        order=2.0,
        published={},
    )


def trackers(max_tracks: int, max_leaves: int, max_begun: int) -> dict[str, Tracker]:
    """Makes the filters, those of the paper first."""
    target = single.single()
    several = {"num_scans": 3, "lag": 1, "max_tracks": max_tracks}
    paper = {**several, "max_leaves": max_leaves}
    certain = {**several, "max_leaves": max_leaves + 10, "certain": True}
    room = {"max_hypotheses": 100, "max_tracks": max_tracks, "max_leaves": 24}
    few = {**room, "exist_threshold": 1e-3}
    return {
        "tpmbm": tpmbm.tpmbm(target, max_undetected=8, max_begun=max_begun, **paper),
        "tmbm": tmbm.tmbm(target, **paper),
        "tmbm01": tmbm.tmbm(target, **certain),
        "glmb": glmb.glmb(target, **room),
        "lmb": lmb.lmb(target, max_tracks=max_tracks),
        "lmb-gibbs": lmb.lmb(target, method="gibbs", max_tracks=max_tracks),
        "pmbm": pmbm.pmbm(target, max_undetected=8, **few),
        "mbm": mbm.mbm(target, **few),
        "mbm01": mbm.mbm01(target, **room),
        "pmb": pmb.pmb(target, max_tracks=max_tracks, max_undetected=8),
        "mht": mht.mht(target, max_tracks=max_tracks, max_undetected=8),
    }


def walk(state: np.ndarray, scans: int, rng: np.random.Generator) -> np.ndarray:
    """Returns random paths from states [N, 4] on, these first, [scans, N, 4]."""
    lower, path = np.linalg.cholesky(NOISE), [state]
    for _ in range(scans - 1):
        path.append(path[-1] @ STEP.T + rng.normal(size=state.shape) @ lower.T)
    return np.stack(path)
