"""Four maneuvering targets seen by a position sensor: Yuan 2013, section 6.2.

Printed, and used: the region, Table 1, the five modes (straight, and turns of pi/30,
-pi/30, pi/20 and pi/15 rad/s), accelerations of 0.1 and 0.2 m/s^2 held for one scan
(equation 42), the transition matrix of equation 48, sensor noise of 8 m an axis, p_D =
p_S = 0.95, births with covariance diag(400, 400, 400, 400) and equal odds for the
modes, clutter uniform over the region, tracks pruned at 0.001, components at 1e-5 and
merged at 4, OSPA of order 2 with cutoff 100 m.

Not printed, and chosen: the initial velocities (see `yuan2013`); 4 is read as a squared
Mahalanobis distance, since metres fit no covariance; the capacity of 100 components a
track becomes `max_components` a mode.

    >>> from jaxtrack.scenarios import yuan2013_linear
    >>> sorted(yuan2013_linear.make().trackers)
    ['gm-ct-cbmember', 'gm-cv-cbmember', 'gm-mm-cbmember', 'gm-mm-cbmember-claims', \
'gm-mm-cphd', 'gm-mm-phd', 'imm-mm-cbmember', 'imm-mm-cphd', 'imm-mm-phd']

Reference: Yuan, Lian and Han, "Multiple-model cardinality balanced multitarget multi-
Bernoulli filter for tracking maneuvering targets", 2013, Table 3 for the OSPA.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import PiecewiseAcceleration
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.models.turn import CoordinatedTurn
from jaxtrack.scenarios import yuan2013
from jaxtrack.scenarios.world import Scenario, World, slots_for
from jaxtrack.targets import imm, mixture
from jaxtrack.trackers import cbmember
from jaxtrack.types import Array, Target, Tracker

TURN_RATES = (0.0, math.pi / 30, -math.pi / 30, math.pi / 20, math.pi / 15)
STRAIGHT_STD, TURNING_STD = 0.1, 0.2  # m/s^2
STAY_PROB = 0.6
SENSOR_STD = 8.0  # metres
ENOUGH = {"max_parents": 5, "max_updated": 8}  # more would lose less than 1e-4 targets

# An intensity of mixtures: one component for each likely detection, with few parents.
MIXTURES = {"max_components": 10, "max_updated": 8, "max_parents": 3}
BANKS = {"max_components": 30}

# Where the tracks of one target merge, a label counts as a whole. Chosen so that the
# number reported has no bias: within 0.04 at all clutter rates and on other seeds, too.
COUNTED = {"report_threshold": 0.46, "split_threshold": 0.7}

PUBLISHED = {
    "gm-mm-phd": {20: 22.8, 40: 28.2, 60: 34.5, 80: 40.9, 100: 47.1},
    "gm-mm-cphd": {20: 20.0, 40: 24.8, 60: 30.3, 80: 36.1, 100: 41.9},
    "gm-mm-cbmember": {20: 22.6, 40: 27.7, 60: 34.1, 80: 40.6, 100: 46.7},
}


def make(
    clutter_rate: float = 20.0,
    detect_prob: float = 0.95,
    survive_prob: float = 0.95,
    max_components: int = 6,
    max_tracks: int = 16,
    merge_threshold: float = 0.0,
    bank_merge_threshold: float = 4.0,
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
        survive_prob: Of the filters; the truth follows Table 1.
        max_components: Gaussians a mode, for `gm-` trackers.
        max_tracks: Tracks that a filter keeps.
        merge_threshold: Of `cbmember` on mixtures: 4.0 merges the tracks of one target,
            which the paper does not; 0.0 keeps to the paper.
        bank_merge_threshold: The same for `imm-mm-cbmember`, which is not in the paper.
    """
    clutter = UniformClutter(
        jnp.asarray(clutter_rate, float),
        -yuan2013.REGION * jnp.ones(2),
        yuan2013.REGION * jnp.ones(2),
    )
    sensor = Position(SENSOR_STD * jnp.ones(2))
    detect = Constant(jnp.asarray(detect_prob, float))

    def params(*turn_rates: float) -> cbmember.Params:
        target = imm.Params(
            motions=tuple(motion(rate) for rate in turn_rates),
            switching=MarkovSwitching(switching_matrix(len(turn_rates))),
            sensor=sensor,
            survive=Constant(jnp.asarray(survive_prob, float)),
            detect=detect,
        )
        return cbmember.Params(target, births(len(turn_rates)), clutter)

    truth = yuan2013.truth()
    size = {"max_tracks": max_tracks, **ENOUGH}
    tracker = functools.partial(cbmember.cbmember, **size)
    counted = COUNTED if bank_merge_threshold else {}
    banked = tracker(imm.imm(), merge_threshold=bank_merge_threshold, **counted)
    several = functools.partial(
        tracker, mixture.mixture(max_components), merge_threshold=merge_threshold
    )
    return Scenario(
        name="yuan2013-linear",
        summary="four maneuvering targets, position sensor (Yuan 2013, section 6.2)",
        world=World(truth, motion(0.0), sensor, detect, clutter),
        trackers=_trackers(several, banked, params, mixture.mixture(max_components)),
        max_detections=slots_for(truth.exists.shape[1], clutter_rate),
        cutoff=100.0,
        order=2.0,
        published=PUBLISHED,
    )


def _trackers(
    several: Callable[..., Tracker],
    banked: Tracker,
    params: Callable[..., cbmember.Params],
    target: Target,
) -> dict[str, tuple[Tracker, Any]]:
    """Makes the paper's trackers, on mixtures, and those with one Gaussian a mode."""
    all_modes = params(*TURN_RATES)
    mixtures = yuan2013.intense(target, all_modes, partition="detections", **MIXTURES)
    banks = yuan2013.intense(imm.imm(), all_modes, **BANKS)
    return {
        "gm-mm-cbmember": (several(), all_modes),
        "gm-mm-cbmember-claims": (several(balance="claims"), all_modes),
        "imm-mm-cbmember": (banked, all_modes),
        **{f"gm-mm-{name}": rival for name, rival in mixtures.items()},
        **{f"imm-mm-{name}": rival for name, rival in banks.items()},
        "gm-cv-cbmember": (several(), params(0.0)),
        "gm-ct-cbmember": (several(), params(math.pi / 20)),
    }


def motion(turn_rate: float) -> PiecewiseAcceleration:
    """Returns one mode: a turn, or a straight line for rate 0."""
    std = TURNING_STD if turn_rate else STRAIGHT_STD
    turn = CoordinatedTurn(jnp.asarray(turn_rate), jnp.zeros(()))
    return PiecewiseAcceleration(turn, std * jnp.ones(2))


def switching_matrix(num_modes: int) -> Array:
    """Returns equation 48: 0.6 to stay, the rest shared evenly; [M, M]."""
    if num_modes == 1:
        return jnp.ones((1, 1))
    leave = (1 - STAY_PROB) / (num_modes - 1)
    return jnp.full((num_modes, num_modes), leave) + (STAY_PROB - leave) * jnp.eye(
        num_modes
    )


def births(num_modes: int) -> MultiBernoulliBirth:
    """Returns equation 45 for the linear example, at rest, all modes equally likely."""
    places = jnp.asarray(yuan2013.BIRTH_PLACES)
    mean = jnp.zeros((len(places), 4)).at[:, jnp.array([0, 2])].set(places)
    cov = yuan2013.BIRTH_VARIANCE * jnp.broadcast_to(jnp.eye(4), (len(places), 4, 4))
    mode_prob = jnp.full((len(places), num_modes), 1 / num_modes)
    return MultiBernoulliBirth(jnp.asarray(yuan2013.BIRTH_PROB), mean, cov, mode_prob)
