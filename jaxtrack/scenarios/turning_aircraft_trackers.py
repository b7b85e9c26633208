"""The trackers of Liu et al. 2021 for the three turning aircraft.

They know the first states, as in the paper. IMM-MHT decides one scan back, so that its
hypotheses go over two scans, by Lagrangian relaxation; RMM-MHT has a window of two
scans. Both look for aircraft that they lost where detections are unexplained; the rate
is a compromise: more often and the evidence falls, less often and OSPA rises.

    >>> from jaxtrack.scenarios import turning_aircraft_trackers
    >>> sorted(turning_aircraft_trackers.TRANSITIONS)
    ['p1', 'p2', 'p3']

Reference: Liu, Shen, Wang and Meng, "Randomized multimodel multiple hypothesis
tracking", 2021, supplement, appendix E.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth
from jaxtrack.models.sensor import Position
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.scenarios.world import Truth
from jaxtrack.targets import imm
from jaxtrack.trackers import mht, rmm_mht, undetected
from jaxtrack.types import Array, Gaussian, PyTree, Tracker

TRANSITIONS = {
    "p1": ((0.95, 0.05), (0.1, 0.9)),
    "p2": ((0.95, 0.05), (0.2, 0.8)),
    "p3": ((0.95, 0.05), (0.3, 0.7)),
}
FIRST_SPEED_STD = 20.0  # m/s, of the first states that the trackers are given
LOST_RATE = 0.1  # aircraft found again a second, as the trackers expect


def make(
    target: imm.Params,
    births: DetectionBirth,
    clutter: Any,
    truth: Truth,
    interval: float,
    max_detections: int,
) -> dict[str, tuple[Tracker, PyTree]]:
    """Makes a (tracker, params) pair for each name.

    Args:
        target: Of two modes; its switching is replaced.
        births: Where detections are unexplained; the rate is replaced.
        clutter: Of `models.clutter`.
        truth: T scans.
        interval: Seconds between scans.
        max_detections: Slots of a scan.
    """
    births = births._replace(rate=jnp.asarray(LOST_RATE))
    start = known(target, truth, interval)
    every = undetected.Params(target, births, clutter, start=start)
    by_lagrange = mht.mht(
        imm.imm(),
        num_scans=1,
        solver="lagrangian",
        max_hypotheses=1,
        max_tracks=24,
        max_leaves=6,
    )
    trackers = {
        f"imm-mht-{name}": (by_lagrange, every._replace(target=switched(target, name)))
        for name in TRANSITIONS
    }
    randomized = rmm_mht.rmm_mht(
        max_tracks=10,
        max_leaves=8,
        max_contested=8,
        max_new=6,
        max_detections=max_detections,
    )
    return trackers | {"rmm-mht": (randomized, every)}


def switched(target: imm.Params, name: str) -> imm.Params:
    """Returns the target with the transition matrix of this name."""
    matrix = jnp.array(TRANSITIONS[name])
    return target._replace(switching=MarkovSwitching(matrix))


def known(target: imm.Params, truth: Truth, interval: float) -> MultiBernoulliBirth:
    """Returns the aircraft as they are known an interval before the first scan.

    The first states are the true ones, with the covariance of one detection and of
    speeds known to `FIRST_SPEED_STD`.
    """
    belief = first(target, truth.state[0])
    back = jax.vmap(lambda x: target.layout.move(x, -jnp.asarray(interval)))
    modes = len(target.motions)
    return MultiBernoulliBirth(
        jnp.ones(len(belief.mean)),
        back(belief.mean),
        belief.cov,
        jnp.full((len(belief.mean), modes), 1 / modes),
    )


def first(target: imm.Params, state: Array) -> Gaussian:
    """Returns beliefs [N] about first states [N, 4]."""
    sensor: Position = target.sensor
    spread = np.diag([1.0, 0.0, 0.0, 0.0]), np.diag([0.0, 0.0, 1.0, 0.0])
    cov = sum(s**2 * x for s, x in zip(sensor.noise_std, spread, strict=True))
    cov = cov + FIRST_SPEED_STD**2 * jnp.diag(jnp.array([0.0, 1.0, 0.0, 1.0]))
    return Gaussian(state, jnp.tile(cov, (len(state), 1, 1)))
