"""One target, and thirteen known accelerations: what the likely modes save.

The modes are accelerations of 0, 20 and 40 m/s^2 along the axes of the plane and of 20
m/s^2 on both: the nodes with |ax| + |ay| <= 40 of a grid of 20. A target goes from a
node to its neighbours only, four of them, or one or two at the rim: the digraph of Li
and Zhang's likely-model-set studies, whose other numbers are not at hand.

Chosen here: it stays at a node with probability 0.94 a scan, else goes to any neighbour
alike; a scan a second, position noise of 35 m an axis; accelerations known but for 1
m/s^2, drawn anew each scan; no clutter, and everything is detected (the trackers take
p_D for 0.999); the flight of `FLIGHT` from (0, 0) at (200, 50) m/s, of which trackers
are told with standard deviations of 50 m and 20 m/s an axis, and wrong by as much.
Likely modes: t1 = 0.02, t2 = 0.5 and at least 1 mode.

What comes of it, over 100 runs: RMS errors, modes active on average and at most

    imm-jpda   position  35.4 m   velocity  24.0 m/s   active  12.9   at most  13
    lms-jpda             35.1               23.9                4.8             8

and as much for t1 from 0.005 to 0.1 and t2 from 0.1 to 0.6, with 4.7 to 6.1 modes; with
t2 = 0.9 errors are up to 6 percent larger.

    >>> from jaxtrack.scenarios import manoeuvre_digraph
    >>> len(manoeuvre_digraph.NODES), int(manoeuvre_digraph.neighbours().sum()) // 2
    (13, 16)

Reference: Li and Zhang, "Multiple-model estimation with variable structure, part V:
likely-model set algorithm", IEEE Trans. Aerospace and Electronic Systems 36(2), 2000.
"""

import jax.numpy as jnp
import numpy as np

from jaxtrack.models.acceleration import KnownAcceleration
from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import ConstantVelocity, PiecewiseAcceleration
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.scenarios.world import Scenario, Truth, World
from jaxtrack.targets import imm, likely_modes
from jaxtrack.trackers import jpda, single_scan
from jaxtrack.types import Array

GRID = 20.0  # m/s^2
NODES = tuple(
    (GRID * i, GRID * j)
    for i in range(-2, 3)
    for j in range(-2, 3)
    if abs(i) + abs(j) <= 2
)
# Seconds that it keeps an acceleration, and that acceleration in steps of the grid.
FLIGHT = (
    (10, (0, 0)),
    (10, (1, 0)),
    (8, (1, 1)),
    (6, (0, 1)),
    (16, (0, 0)),
    (6, (0, -1)),
    (8, (0, -2)),
    (4, (0, -1)),
    (12, (0, 0)),
)
FIRST = (0.0, 200.0, 0.0, 50.0)  # metres, m/s
START_STD = (50.0, 20.0)  # metres, m/s
ACCELERATION_STD, SENSOR_STD = 1.0, 35.0  # m/s^2, metres
DETECT_PROB = 0.999  # as the trackers have it


def make(
    unlikely_prob: float = 0.02,
    principal_prob: float = 0.5,
    min_modes: float = 1,
    stay_prob: float = 0.94,
) -> Scenario:
    """Makes the scenario.

    Args:
        unlikely_prob: t1 of the likely modes.
        principal_prob: t2 of the likely modes.
        min_modes: So many of them stay active at least.
        stay_prob: To keep an acceleration for another scan, as the trackers have it.
    """
    clutter = UniformClutter(jnp.zeros(()), jnp.zeros(2), jnp.full(2, 1e4))
    sensor, seen = Position(SENSOR_STD * jnp.ones(2)), truth()
    fixed = imm.Params(
        motions=tuple(motion(*node) for node in NODES),
        switching=MarkovSwitching(switching_matrix(stay_prob)),
        sensor=sensor,
        survive=Constant(jnp.ones(())),
        detect=Constant(jnp.asarray(DETECT_PROB)),
    )
    likely = likely_modes.Params(
        *fixed, jnp.asarray(float(unlikely_prob)), jnp.asarray(float(principal_prob))
    )
    targets = {
        "imm-jpda": (imm.imm(), fixed),
        "lms-jpda": (likely_modes.likely_modes(int(min_modes)), likely),
    }
    alone = {"max_tracks": 1, "max_births": 0, "gate_prob": 1.0}
    return Scenario(
        name="manoeuvre-digraph",
        summary="one target, thirteen accelerations (after Li and Zhang 2000)",
        world=World(seen, motion(0.0, 0.0), sensor, Constant(jnp.ones(())), clutter),
        trackers={
            name: (
                jpda.jpda(target, **alone),
                single_scan.Params(params, None, clutter, start()),
            )
            for name, (target, params) in targets.items()
        },
        max_detections=1,
        cutoff=500.0,
        order=2.0,
        published={},
    )


def truth() -> Truth:
    """Returns the flight, [T, 1, 4], a scan a second."""
    state = [np.array(FIRST)]
    for seconds, steps in FLIGHT:
        for _ in range(seconds):
            x, vx, y, vy = state[-1]
            ax, ay = (GRID * step for step in steps)
            moved = [x + vx + ax / 2, vx + ax, y + vy + ay / 2, vy + ay]
            state.append(np.array(moved))
    num = len(state)
    return Truth(
        state=jnp.asarray(np.stack(state)[:, None]),
        exists=jnp.ones((num, 1), bool),
        time=jnp.arange(float(num)),
    )


def motion(x: float, y: float) -> KnownAcceleration:
    """Returns the mode of an acceleration, m/s^2."""
    straight = ConstantVelocity(jnp.zeros(2))
    wandering = PiecewiseAcceleration(straight, ACCELERATION_STD * jnp.ones(2))
    return KnownAcceleration(wandering, jnp.array([x, y]))


def neighbours() -> np.ndarray:
    """Returns which nodes are one step of the grid from each other, [13, 13]."""
    nodes = np.array(NODES)
    return np.abs(nodes[:, None] - nodes[None]).sum(2) == GRID


def switching_matrix(stay_prob: float) -> Array:
    """Returns the transitions: to stay, or to go to any neighbour alike; [13, 13]."""
    near = neighbours()
    leave = (1 - stay_prob) * near / near.sum(1, keepdims=True)
    return jnp.asarray(leave + stay_prob * np.eye(len(near)))


def start() -> MultiBernoulliBirth:
    """Returns what trackers are told: off by a standard deviation, at the centre."""
    std = jnp.array(2 * START_STD)
    return MultiBernoulliBirth(
        existence_prob=jnp.ones(1),
        mean=(jnp.array(FIRST) + jnp.array([1, -1, -1, 1]) * std)[None],
        cov=jnp.diag(std**2)[None],
        mode_prob=jnp.array([[float(node == (0, 0)) for node in NODES]]),
    )
