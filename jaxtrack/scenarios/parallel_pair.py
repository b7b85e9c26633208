"""Two targets side by side, closer than the noise, for a while: not from a paper.

Both come from the left at 20 m/s, 400 m apart. They close in until they are `gap`
metres apart, keep side by side for 60 s, and part again. Scans every 2 s, position
noise of 10 m an axis, p_D = 0.9, a little clutter. The trackers are told the first
states, and that nobody leaves.

While they are side by side nobody can say which detection is whose. A tracker that
averages over that, as JPDA does, puts both tracks between the targets: they coalesce.
JPDA*, set JPDA and GNN do not average. `bayes` is what all of them approximate, the
filter over the heaviest association histories: its mean averages, too, where it truly
cannot know, and `bayes-map` tells of the heaviest history alone. `mht` and `mcmcda`
find it over the last scans, by the tracks' trees and by a Markov chain; `pmht` finds
the two paths that all detections of five scans suit best, softly shared.

    >>> from jaxtrack.scenarios import parallel_pair
    >>> state = parallel_pair.make(gap=15.0).world.truth.state
    >>> print((state[:, 0, 2] - state[:, 1, 2]).min())
    15.0
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
    gnn,
    hypotheses,
    jpda,
    jpda_star,
    management,
    mcmcda,
    mht,
    nearest,
    pmht,
    pmht_batch,
    set_jpda,
    single_scan,
    undetected,
)
from jaxtrack.types import Tracker

SPEED, APART, INTERVAL = 20.0, 400.0, 2.0  # m/s, m, s
CLOSING, BESIDE, PARTING = 40.0, 60.0, 40.0  # seconds
SENSOR_STD = 10.0  # metres
NOISE_DENSITY = 1.0  # m^2/s^3
START_STD = (10.0, 3.0)  # m, m/s
STAY = management.MofN(1, 1, 32, 32)  # nobody leaves


def make(
    gap: float = 10.0, clutter_rate: float = 2.0, detect_prob: float = 0.9
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        gap: Distance of the two while they are side by side, m.
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
    """
    clutter = UniformClutter(
        jnp.asarray(clutter_rate, float),
        jnp.array([-200.0, -400.0]),
        jnp.array([SPEED * (CLOSING + BESIDE + PARTING) + 200.0, 400.0]),
    )
    motion = ConstantVelocity(NOISE_DENSITY * jnp.ones(2))
    sensor = Position(SENSOR_STD * jnp.ones(2))
    detect = Constant(jnp.asarray(detect_prob, float))
    told = truth(gap)
    target = single.Params(motion, sensor, Constant(jnp.ones(())), detect)
    start = MultiBernoulliBirth(
        existence_prob=jnp.ones(2),
        mean=told.state[0],
        cov=jnp.tile(jnp.diag(jnp.array(START_STD * 2) ** 2), (2, 1, 1)),
        mode_prob=jnp.ones((2, 1)),
    )
    scan_by_scan = single_scan.Params(target, None, clutter, start)
    nobody = PoissonBirth(jnp.zeros(2), *start[1:])
    over_scans = undetected.Params(target, nobody, clutter, start=start)
    return Scenario(
        name="parallel-pair",
        summary="two targets side by side, closer than the noise, for a while",
        world=World(told, motion, sensor, detect, clutter),
        trackers={
            **{name: (tracker, scan_by_scan) for name, tracker in _trackers().items()},
            **{name: (tracker, over_scans) for name, tracker in _searches().items()},
            "pmht": (pmht.pmht(), pmht_batch.Params(target, clutter, start)),
        },
        max_detections=slots_for(2, clutter_rate),
        cutoff=100.0,
        order=2.0,
        published={},
    )


def _trackers() -> dict[str, Tracker]:
    target = single.single()
    two = {"max_tracks": 2, "max_births": 0, "rule": STAY}
    few = {"max_hypotheses": 50, "max_events": 8}
    return {
        "nn": nearest.nearest(target, **two),
        "gnn": gnn.gnn(target, **two),
        "jpda": jpda.jpda(target, **two),
        "jpda-star": jpda_star.jpda_star(target, max_events=20, **two),
        "set-jpda": set_jpda.set_jpda(target, max_events=20, **two),
        "bayes": hypotheses.hypotheses(target, **few),
        "bayes-map": hypotheses.hypotheses(target, **few, report="best"),
    }


def _searches() -> dict[str, Tracker]:
    target = single.single()
    return {
        "mht": mht.mht(target, max_tracks=2),
        "mcmcda": mcmcda.mcmcda(target, max_tracks=3, max_detections=16),
    }


def truth(gap: float) -> Truth:
    """Returns the two lines, [T, 2, 4], a scan every 2 s."""
    time = np.arange(0.0, CLOSING + BESIDE + PARTING + INTERVAL / 2, INTERVAL)
    # How far apart, and how fast that changes: a half cosine in, and out again.
    phase = np.clip(
        np.maximum(1 - time / CLOSING, (time - CLOSING - BESIDE) / PARTING), 0, 1
    )
    apart = gap + (APART - gap) * (1 - np.cos(np.pi * phase)) / 2
    rate = np.gradient(apart, time)
    state = np.zeros((len(time), 2, 4))
    state[:, :, 0], state[:, :, 1] = SPEED * time[:, None], SPEED
    state[:, :, 2] = apart[:, None] * np.array([0.5, -0.5])
    state[:, :, 3] = rate[:, None] * np.array([0.5, -0.5])
    exists = np.ones((len(time), 2), bool)
    return Truth(jnp.asarray(state), jnp.asarray(exists), jnp.asarray(time))
