"""Many targets that cross in the middle of a field of clutter: not from a paper.

N targets start evenly around a circle of 1500 m. Each goes straight at 25 m/s past the
middle, to the left or right of it by up to `spread` metres, and is out on the other
side after 120 s. A scan every 2 s; position noise of 10 m an axis; p_D = 0.9. What a
tracker makes of the middle, where everybody is near everybody, tells the algorithms
apart; `num_targets` from 2 to 200 tells what they cost.

Tracks begin at unexplained detections. Those that take tracks for certain confirm them
by 4 detections in 6 scans, the integrated ones by their existence probability.

    >>> from jaxtrack.scenarios import crossing_many
    >>> made = crossing_many.make(num_targets=5)
    >>> made.world.truth.state.shape, sorted(made.trackers)[:3]
    ((61, 5, 4), ['cbmember', 'gnn', 'ipda'])
"""

import math

import jax.numpy as jnp
import numpy as np

from jaxtrack.models.birth import DetectionBirth
from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.scenarios.world import Scenario, Truth, World, slots_for
from jaxtrack.targets import single
from jaxtrack.trackers import (
    cbmember,
    gnn,
    jpda,
    jpda_star,
    management,
    nearest,
    pda,
    set_jpda,
    single_scan,
)

RADIUS, SPEED = 1500.0, 25.0  # metres, m/s
DURATION, INTERVAL = 120.0, 2.0  # seconds
SENSOR_STD = 10.0  # metres
NOISE_DENSITY = 0.1  # m^2/s^3
GOLDEN = (math.sqrt(5) - 1) / 2
RULE = management.MofN(4, 6, 5, 6)


def make(
    num_targets: float = 10,
    clutter_rate: float = 20.0,
    detect_prob: float = 0.9,
    spread: float = 150.0,
    survive_prob: float = 0.999,
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        num_targets: How many cross.
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
        spread: How far from the middle targets pass at most, m.
        survive_prob: Of the filters; the truth never ends.

    Raises:
        ValueError: Fewer than one target, or not a whole number of them.
    """
    num = int(num_targets)
    if num != num_targets or num < 1:
        raise ValueError(
            f"num_targets is {num_targets}; give a whole number, 1 or more"
        )
    reach = RADIUS + 10 * SENSOR_STD
    clutter = UniformClutter(
        jnp.asarray(clutter_rate, float), -reach * jnp.ones(2), reach * jnp.ones(2)
    )
    motion = ConstantVelocity(NOISE_DENSITY * jnp.ones(2))
    detect = Constant(jnp.asarray(detect_prob, float))
    sensor = Position(SENSOR_STD * jnp.ones(2))
    target = single.Params(
        motion, sensor, Constant(jnp.asarray(survive_prob, float)), detect
    )
    births = DetectionBirth(
        rate=jnp.asarray(num / DURATION),
        max_existence_prob=jnp.asarray(0.2),
        velocity_std=jnp.full(2, SPEED),
        extra_std=jnp.zeros(0),
        mode_prob=jnp.ones(1),
    )
    params = single_scan.Params(target, births, clutter)
    own = cbmember.Params(target, births, clutter)
    return Scenario(
        name="crossing-many",
        summary=f"{num} targets that cross in the middle, in clutter",
        world=World(truth(num, spread), motion, sensor, detect, clutter),
        trackers={
            name: (
                tracker,
                own if name == "cbmember" else params,
            )
            for name, tracker in _trackers(num, clutter_rate).items()
        },
        max_detections=slots_for(num, clutter_rate),
        cutoff=100.0,
        order=2.0,
        published={},
    )


def _trackers(num: int, clutter_rate: float) -> dict:
    """Makes the trackers, with room for as many tentative tracks as clutter begins."""
    births = int(num / 4 + clutter_rate + 4)
    room = {"max_tracks": int(1.5 * num + clutter_rate + 4), "max_births": births}
    sure = {**room, "rule": RULE, "duplicate_threshold": 1.0}
    target = single.single()
    return {
        "nn": nearest.nearest(target, **sure),
        "gnn": gnn.gnn(target, **sure),
        "pda": pda.pda(target, **sure),
        "ipda": pda.ipda(target, **room, duplicate_threshold=1.0),
        "jpda": jpda.jpda(target, **sure),
        "jpda-bp": jpda.jpda(target, method="belief", **sure),
        "jpda-star": jpda_star.jpda_star(target, **sure),
        "set-jpda": set_jpda.set_jpda(target, **sure),
        "jipda": jpda.jipda(target, **room),
        "cbmember": cbmember.cbmember(target, **room, merge_threshold=4.0),
    }


def truth(num: int, spread: float) -> Truth:
    """Returns straight lines through the middle, [T, N, 4].

    Args:
        num: N.
        spread: How far from the middle they pass at most, m.
    """
    time = np.arange(0.0, DURATION + INTERVAL / 2, INTERVAL)
    angle = 2 * math.pi * np.arange(num) / num
    # The golden ratio spreads both the distances and, with them, who meets whom.
    aside = spread * (2 * ((np.arange(num) * GOLDEN) % 1) - 1)
    ahead = np.stack([np.cos(angle), np.sin(angle)], 1)
    across = np.stack([-ahead[:, 1], ahead[:, 0]], 1)
    place = -RADIUS * ahead + aside[:, None] * across
    position = place[None] + SPEED * time[:, None, None] * ahead[None]
    velocity = np.broadcast_to(SPEED * ahead, position.shape)
    state = np.stack([position, velocity], -1).reshape(len(time), num, 4)
    exists = np.ones((len(time), num), bool)
    return Truth(jnp.asarray(state), jnp.asarray(exists), jnp.asarray(time))
