"""Four maneuvering targets seen by a range-bearing sensor: Yuan 2013, section 6.1.

Printed, and used: the region, Table 1, two modes (straight, and a turn of unknown rate)
with accelerations of 0.1 and 0.2 m/s^2 held for one scan (equation 42) and a turn rate
that wanders by 0.001 rad/s a scan, 0.8 to stay in a mode, sensor at the origin with
noise of 10 m and 0.01 rad, p_D = p_S = 0.95, births of equation 45, clutter uniform
over the region, tracks pruned at 0.001, OSPA of order 2 with cutoff 100 m.

Not printed, and chosen: the initial velocities (see `yuan2013`). Changed: equation 41
sets the turn rate to exactly 0 while a target flies straight, from where a turn of
0.001 rad/s a scan could never begin; here the straight mode forgets it instead, to N(0,
0.1^2), the spread that equation 45 gives a newborn. Clutter is uniform in the plane, so
its density in range and bearing grows with range.

The paper runs this example on particles, the `smc-` trackers; the Gaussian mixtures are
its EK and UK extensions (section 5). The motions have so little noise that resampled
particles stay copies of each other: 1,000 a track lose a third of the targets, unless
they are moved apart by a kernel as they are resampled, as is done here. PHD and CPHD
filters make one component of all that a detection corrects instead of clustering.

    >>> from jaxtrack.scenarios import yuan2013_range_bearing
    >>> yuan2013_range_bearing.make().max_detections
    56

Reference: Yuan, Lian and Han, "Multiple-model cardinality balanced multitarget multi-
Bernoulli filter for tracking maneuvering targets", 2013, Table 2 for the OSPA.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from jaxtrack import linearize
from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.models.clutter import PolarClutter
from jaxtrack.models.motion import PiecewiseAcceleration
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import RangeBearing
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.models.turn import CoordinatedTurn, ForgottenTurn, TurnRate
from jaxtrack.scenarios import yuan2013
from jaxtrack.scenarios.world import Scenario, World, slots_for
from jaxtrack.targets import imm, mixture, particles
from jaxtrack.trackers import cbmember
from jaxtrack.types import Tracker

STRAIGHT_STD, TURNING_STD = 0.1, 0.2  # m/s^2
TURN_NOISE = 1e-3**2  # rad^2/s^3
TURN_SPREAD = 0.1  # rad/s, of a newborn
STAY_PROB = 0.8
SENSOR_STD = (10.0, 0.01)  # metres, rad

MAX_PARTICLES, MIN_PARTICLES = 1000, 300  # a track; fewer for one that is not sure
SCORED = {"max_scored": 16}
ENOUGH = {"max_parents": 5, "max_updated": 8, **SCORED}
FEW = {"max_components": 10, "max_updated": 8, "max_parents": 3}

PUBLISHED = {
    "smc-mm-phd": {20: 38.3, 40: 48.2, 60: 60.5, 80: 74.3, 100: 88.1},
    "smc-mm-cphd": {20: 32.8, 40: 35.9, 60: 39.4, 80: 43.4, 100: 47.8},
    "smc-mm-cbmember": {20: 25.6, 40: 31.3, 60: 37.4, 80: 43.2, 100: 48.9},
}


def make(
    clutter_rate: float = 20.0,
    detect_prob: float = 0.95,
    survive_prob: float = 0.95,
    max_components: int = 6,
    max_tracks: int = 16,
    merge_threshold: float = 0.0,
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
        survive_prob: Of the filters; the truth follows Table 1.
        max_components: Gaussians a mode, for `gm-` and `uk-` trackers.
        max_tracks: Tracks that a filter keeps.
        merge_threshold: Of `cbmember`: 4.0 merges the tracks of one target, which the
            paper does not; 0.0 keeps to the paper.
    """
    corner, origin = yuan2013.REGION * jnp.ones(2), jnp.zeros(2)
    sensor = RangeBearing(jnp.array(SENSOR_STD), origin, jnp.zeros(()))
    detect = Constant(jnp.asarray(detect_prob, float))
    clutter = PolarClutter(
        jnp.asarray(clutter_rate, float), -corner, corner, origin, jnp.zeros(())
    )

    def params(*modes: PiecewiseAcceleration) -> cbmember.Params:
        target = imm.Params(
            motions=modes,
            switching=switching(len(modes)),
            sensor=sensor,
            survive=Constant(jnp.asarray(survive_prob, float)),
            detect=detect,
        )
        return cbmember.Params(target, births(len(modes)), clutter)

    truth = yuan2013.truth()
    size = {"max_tracks": max_tracks, "merge_threshold": merge_threshold}
    tracker = functools.partial(cbmember.cbmember, **size)
    return Scenario(
        name="yuan2013-range-bearing",
        summary="four maneuvering targets, range and bearing (Yuan 2013, section 6.1)",
        world=World(truth, straight(), sensor, detect, clutter),
        trackers=_trackers(tracker, params, max_components),
        max_detections=slots_for(truth.exists.shape[1], clutter_rate),
        cutoff=100.0,
        order=2.0,
        published=PUBLISHED,
    )


def _trackers(
    tracker: Callable[..., Tracker],
    params: Callable[..., cbmember.Params],
    max_components: int,
) -> dict[str, tuple[Tracker, Any]]:
    """Makes the paper's trackers, on particles, and those on Gaussians."""
    several = mixture.mixture(max_components)
    sigma_points = mixture.mixture(max_components, method=linearize.unscented)
    cloud = particles.particles(MAX_PARTICLES, MIN_PARTICLES, regularise=True)
    gaussians, samples = tracker(several), tracker(cloud, **ENOUGH)
    both, line, turn = (
        params(straight(), turning()),
        params(straight()),
        params(turning()),
    )
    mixtures, clouds = (
        yuan2013.intense(target, both, partition="detections", **FEW, **most)
        for target, most in ((several, {}), (cloud, SCORED))
    )
    return {
        "gm-mm-cbmember": (gaussians, both),
        "uk-mm-cbmember": (tracker(sigma_points), both),
        "imm-mm-cbmember": (tracker(imm.imm()), both),
        "gm-cv-cbmember": (gaussians, line),
        "gm-ct-cbmember": (gaussians, turn),
        **{f"gm-mm-{name}": rival for name, rival in mixtures.items()},
        "smc-mm-cbmember": (samples, both),
        "smc-cv-cbmember": (samples, line),
        "smc-ct-cbmember": (samples, turn),
        **{f"smc-mm-{name}": rival for name, rival in clouds.items()},
    }


def switching(num_modes: int) -> MarkovSwitching:
    """Returns equation 43 for two modes, none for one."""
    if num_modes == 1:
        return MarkovSwitching(jnp.ones((1, 1)))
    leave = 1 - STAY_PROB
    return MarkovSwitching(jnp.array([[STAY_PROB, leave], [leave, STAY_PROB]]))


def straight() -> PiecewiseAcceleration:
    """Returns mode 1: constant velocity; the turn rate is forgotten."""
    line = CoordinatedTurn(jnp.zeros(()), jnp.zeros(()))
    forgetful = ForgottenTurn(line, jnp.asarray(TURN_SPREAD))
    return PiecewiseAcceleration(forgetful, STRAIGHT_STD * jnp.ones(2))


def turning() -> PiecewiseAcceleration:
    """Returns mode 2: a coordinated turn of unknown rate."""
    turn = TurnRate(jnp.zeros(()), jnp.asarray(TURN_NOISE))
    return PiecewiseAcceleration(turn, TURNING_STD * jnp.ones(2))


def births(num_modes: int) -> MultiBernoulliBirth:
    """Returns equation 45: at rest, all modes equally likely."""
    places = jnp.asarray(yuan2013.BIRTH_PLACES)
    mean = jnp.zeros((len(places), 5)).at[:, jnp.array([0, 2])].set(places)
    variance = jnp.array([yuan2013.BIRTH_VARIANCE] * 4 + [TURN_SPREAD**2])
    return MultiBernoulliBirth(
        existence_prob=jnp.asarray(yuan2013.BIRTH_PROB),
        mean=mean,
        cov=jnp.broadcast_to(jnp.diag(variance), (len(places), 5, 5)),
        mode_prob=jnp.full((len(places), num_modes), 1 / num_modes),
    )
