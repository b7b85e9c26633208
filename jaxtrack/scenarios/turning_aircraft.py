"""Three aircraft side by side, in two turns: Liu et al. 2021, figure 1.

Printed, and used: westward at constant velocity, a turn of 1 degree/s, southward, a
turn of -3 degrees/s, westward again; 1000 m between neighbours; scans every 5 s;
position noise of 400 m an axis; 50 false detections a scan; two constant velocity modes
of 0.01 and 4 m^2/s^3 (units of the supplement), with dt^3/3 where the paper's equation
51 prints dt^3; the mode transitions P1; OSPA of order 1 with cutoff 3000 m.

Not printed, and chosen: start (25, 10) km at 120 m/s and legs of 125, 90, 125, 30 and
125 s, after the example of Bar-Shalom, Li and Kirubarajan 2001, section 11.7, which the
paper names as its source; neighbours 1000 m north and south of the first; the region,
50 by 40 km; p_D = 0.95, p_S = 0.99. Births are driven by unexplained detections, so
that an aircraft lost in a turn, for which neither mode is made, is found again. The
paper's own trackers, and the first states that it gives them, are in
`turning_aircraft_trackers`.

    >>> from jaxtrack.scenarios import turning_aircraft
    >>> turning_aircraft.make().world.truth.state.shape
    (100, 3, 4)

Reference: Liu, Shen, Wang, Meng, Wang and Varshney, "Randomized multiple model multiple
hypothesis tracking", 2021, section 4, and its supplement, appendix E.
"""

import functools
import math

import jax.numpy as jnp
import numpy as np

from jaxtrack.models.birth import DetectionBirth
from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.scenarios import turning_aircraft_trackers
from jaxtrack.scenarios.world import (
    Scenario,
    Truth,
    World,
    slots_for,
    turn_matrix,
)
from jaxtrack.targets import imm, mixture
from jaxtrack.trackers import cbmember

STARTS = ((25e3, 10e3), (25e3, 11e3), (25e3, 9e3))  # metres
SPEED = 120.0  # m/s, westward
# seconds at which a leg ends, and its turn rate in rad/s
LEGS = (
    (125.0, 0.0),
    (215.0, math.pi / 180),
    (340.0, 0.0),
    (370.0, -math.pi / 60),
    (495.0, 0.0),
)
NOISE_DENSITIES = (0.01, 4.0)  # m^2/s^3
TRANSITION = ((0.95, 0.05), (0.1, 0.9))  # P1
REGION_LOW, REGION_HIGH = (-20e3, -25e3), (30e3, 15e3)
SENSOR_STD = 400.0
BIRTH_RATE = 0.03  # new aircraft a second


def make(
    clutter_rate: float = 50.0,
    detect_prob: float = 0.95,
    survive_prob: float = 0.99,
    interval: float = 5.0,
    max_components: int = 6,
    max_tracks: int = 16,
    merge_threshold: float = 0.0,
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
        survive_prob: Of the filters; the truth never ends.
        interval: Seconds between scans; the paper has 1, 5 and 10.
        max_components: Gaussians a mode, for `gm-` trackers.
        max_tracks: Tracks that a filter keeps.
        merge_threshold: Of `cbmember`: 4.0 merges the tracks of one target, which the
            paper does not; 0.0 keeps to the paper.
    """
    clutter = UniformClutter(
        jnp.asarray(clutter_rate, float), jnp.array(REGION_LOW), jnp.array(REGION_HIGH)
    )
    sensor = Position(SENSOR_STD * jnp.ones(2))
    detect = Constant(jnp.asarray(detect_prob, float))

    def params(*densities: float) -> cbmember.Params:
        many = len(densities) > 1
        target = imm.Params(
            motions=tuple(ConstantVelocity(q * jnp.ones(2)) for q in densities),
            switching=MarkovSwitching(jnp.array(TRANSITION if many else ((1.0,),))),
            sensor=sensor,
            survive=Constant(jnp.asarray(survive_prob, float)),
            detect=detect,
        )
        return cbmember.Params(target, births(len(densities)), clutter)

    tracker = functools.partial(
        cbmember.cbmember, max_tracks=max_tracks, merge_threshold=merge_threshold
    )
    slots, flights = slots_for(len(STARTS), clutter_rate), truth(interval)
    gaussians = tracker(mixture.mixture(max_components))
    both, smooth = params(*NOISE_DENSITIES), params(NOISE_DENSITIES[0])
    given = both.target, births(2), clutter, flights
    papers = turning_aircraft_trackers.make(*given, interval, slots)
    return Scenario(
        name="turning-aircraft",
        summary="three aircraft side by side in two turns (Liu 2021, figure 1)",
        world=World(flights, both.target.layout, sensor, detect, clutter),
        trackers={
            "gm-mm-cbmember": (gaussians, both),
            "imm-mm-cbmember": (tracker(imm.imm()), both),
            "gm-cv-cbmember": (gaussians, smooth),
            **papers,
        },
        max_detections=slots,
        cutoff=3000.0,
        order=1.0,
        published={},
    )


def truth(interval: float) -> Truth:
    """Returns the three flights, [T, 3, 4], a scan every `interval` seconds."""
    time = np.arange(0.0, LEGS[-1][0] + interval / 2, interval)
    now = np.array([[x, -SPEED, y, 0.0] for x, y in STARTS])
    state = [now]
    for begin, end in zip(time[:-1], time[1:], strict=True):
        since = begin
        for leg_end, rate in LEGS:
            if (step := min(end, leg_end) - since) > 0:
                now = now @ turn_matrix(rate, float(step)).T
                since += step
        state.append(now)
    exists = jnp.ones((len(state), len(STARTS)), bool)
    return Truth(jnp.asarray(np.stack(state)), exists, jnp.asarray(time))


def births(num_modes: int) -> DetectionBirth:
    """Returns births where detections are unexplained, all modes equally likely."""
    return DetectionBirth(
        rate=jnp.asarray(BIRTH_RATE),
        max_existence_prob=jnp.asarray(0.3),
        velocity_std=jnp.full(2, SPEED),
        extra_std=jnp.zeros(0),
        mode_prob=jnp.full(num_modes, 1 / num_modes),
    )
