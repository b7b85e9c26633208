"""Five targets that pass from a radar to a position sensor, and back.

The radar stands in the west and measures range and bearing, the other sensor in the
east and measures positions; each sees a disc, the discs overlap in the middle, and each
has clutter of its own everywhere. Targets begin at unexplained detections of either.

Trackers: `phd`, `cphd` and `cbmember`, each with the radar alone (`-radar`), with the
position sensor alone (`-position`), iterated with either sensor first (`-radar-first`,
`-position-first`) and in the product form (`-product`).

Average OSPA in metres (order 2, cutoff 100 m) of 20 runs, seed 0, standard errors below
1.3; docs/two_sensors.md has more runs, and what they say of forms and balances:

            radar   position   radar first   position first   product
    PHD      51.6     48.6        25.3           26.4           29.5
    CPHD     48.8     50.2        27.3           26.9           25.2
    CBMeMBer 43.2     42.2        22.6           22.1           15.4

Both sensors together halve the error, and the order matters little. The product form of
PHD and CPHD counts targets group by group, since a sensor says nothing about those that
it does not see. That of CBMeMBer goes by claims, and so is better than the iterated one
with the usual balance.

    >>> from jaxtrack.scenarios import two_sensors
    >>> made = two_sensors.make()
    >>> made.world.truth.state.shape, len(made.trackers)
    ((60, 5, 4), 15)
"""

import math

import jax.numpy as jnp
import numpy as np

from jaxtrack.models.birth import DetectionBirth
from jaxtrack.models.clutter import PolarClutter, UniformClutter
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant, InsideDisc
from jaxtrack.models.sensor import Position, RangeBearing
from jaxtrack.scenarios.world import Scenario, Truth, World, slots_for
from jaxtrack.targets import single
from jaxtrack.trackers import several, several_cbmember, several_phd
from jaxtrack.types import PyTree, Tracker

REACH = 1600.0, 1000.0  # metres, half the sides of the region with clutter
RADAR, STATION = (-600.0, 0.0), (600.0, 0.0)  # metres
RADIUS, SOFTNESS = 900.0, 20.0  # metres, of each field of view
RANGE_STD, BEARING_STD, POSITION_STD = 8.0, math.radians(0.5), 10.0  # m, rad, m
NOISE_DENSITY = 0.1  # m^2/s^3
SCANS = 60  # one a second

# first and last second, start (x, vx, y, vy)
PATHS = (
    (0, 60, (-1000.0, 30.0, 300.0, -4.0)),
    (0, 60, (1000.0, -30.0, 200.0, 2.0)),
    (5, 55, (-900.0, 28.0, -350.0, 8.0)),
    (10, 60, (800.0, -25.0, -400.0, 6.0)),
    (15, 50, (-100.0, 5.0, 600.0, -25.0)),
)

SIDES: dict[str, tuple[int, ...]] = {
    "radar": (0,),
    "position": (1,),
    "radar-first": (0, 1),
    "position-first": (1, 0),
    "product": (0, 1),
}


def make(
    clutter_rate: float = 10.0,
    radar_prob: float = 0.95,
    position_prob: float = 0.95,
    survive_prob: float = 0.99,
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        clutter_rate: Expected false detections a scan, of each sensor.
        radar_prob: Probability of detection deep in the radar's field of view.
        position_prob: The same of the position sensor.
        survive_prob: Of the filters.
    """
    sensors = _sensors(clutter_rate, radar_prob, position_prob)
    motion = ConstantVelocity(NOISE_DENSITY * jnp.ones(2))
    target = single.Params(
        motion,
        sensors[0].sensor,
        Constant(jnp.asarray(survive_prob, float)),
        sensors[0].detect,
    )
    births = DetectionBirth(
        rate=jnp.asarray(0.2),
        max_existence_prob=jnp.asarray(0.2),
        velocity_std=jnp.full(2, 20.0),
        extra_std=jnp.zeros(0),
        mode_prob=jnp.ones(1),
    )
    trackers: dict[str, tuple[Tracker, PyTree]] = {}
    for family in ("phd", "cphd", "cbmember"):
        for side, order in SIDES.items():
            form = "product" if side == "product" else "iterated"
            own = several.Params(target, births, tuple(sensors[k] for k in order))
            tracker = several.select(_tracker(family, form), order)
            trackers[f"{family}-{side}"] = tracker, own
    world = World(truth(), motion, *map(list, zip(*sensors, strict=True)))
    return Scenario(
        name="two-sensors",
        summary="five targets that pass from a radar to a position sensor, and back",
        world=world,
        trackers=trackers,
        max_detections=slots_for(len(PATHS), clutter_rate),
        cutoff=100.0,
        order=2.0,
        published={},
    )


def _sensors(
    clutter_rate: float, radar_prob: float, position_prob: float
) -> tuple[several.Sensor, several.Sensor]:
    """Returns the radar and the position sensor."""
    rate, high = jnp.asarray(clutter_rate, float), jnp.asarray(REACH)
    radar, station = jnp.asarray(RADAR), jnp.asarray(STATION)

    def disc(prob: float, centre: jnp.ndarray) -> InsideDisc:
        edge = jnp.asarray(RADIUS), jnp.asarray(SOFTNESS)
        return InsideDisc(jnp.asarray(prob, float), centre, *edge)

    noise = jnp.array([RANGE_STD, BEARING_STD])
    return (
        several.Sensor(
            RangeBearing(noise, radar, jnp.zeros(())),
            disc(radar_prob, radar),
            PolarClutter(rate, -high, high, radar, jnp.zeros(())),
        ),
        several.Sensor(
            Position(POSITION_STD * jnp.ones(2)),
            disc(position_prob, station),
            UniformClutter(rate, -high, high),
        ),
    )


def _tracker(family: str, form: several.Form) -> Tracker:
    """Makes a tracker of two sensors."""
    target, births = single.single(), {"max_births": 20}
    if family == "phd":
        return several_phd.several_phd(target, form, max_components=30, **births)
    if family == "cphd":
        return several_phd.several_cphd(
            target, form, max_components=30, max_targets=15, **births
        )
    return several_cbmember.several_cbmember(
        target, form, max_tracks=30, merge_threshold=4.0, **births
    )


def truth() -> Truth:
    """Returns straight lines, [60, 5, 4]."""
    time = np.arange(float(SCANS))
    start = np.array([path[2] for path in PATHS])
    state = np.broadcast_to(start, (SCANS, *start.shape)).copy()
    for position, velocity in ((0, 1), (2, 3)):
        state[:, :, position] += time[:, None] * start[None, :, velocity]
    exists = [[born <= t < dies for born, dies, _ in PATHS] for t in time]
    return Truth(jnp.asarray(state), jnp.asarray(exists), jnp.asarray(time))
