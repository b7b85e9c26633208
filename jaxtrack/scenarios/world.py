"""What a scenario is made of, and how its sensor sees the truth.

>>> import jax, jax.numpy as jnp
>>> from jaxtrack import models
>>> from jaxtrack.scenarios import world
>>> truth = world.Truth(jnp.zeros((3, 1, 4)), jnp.ones((3, 1), bool), jnp.arange(3.0))
>>> seen = world.observe(
...     jax.random.key(0), truth, models.motion.ConstantVelocity(jnp.ones(2)),
...     models.sensor.Position(jnp.ones(2)), models.probability.Constant(1.0),
...     models.clutter.UniformClutter(0.0, -jnp.ones(2), jnp.ones(2)), 4)
>>> print(seen.valid.sum(1), seen.interval)
[1 1 1] [1. 1. 1.]
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import linalg
from jaxtrack.entries import dense
from jaxtrack.models.turn import CoordinatedTurn
from jaxtrack.types import Array, PyTree, Scan, Scans, Tracker


class Truth(NamedTuple):
    """What the targets really do.

    Attributes:
        state: [T, N, D]; finite also where the target is not there.
        exists: [T, N] (bool).
        time: Seconds, [T].
    """

    state: Array
    exists: Array
    time: Array


class World(NamedTuple):
    """Truth and sensor as values, so that one compiled program serves all settings.

    Attributes:
        truth: The targets.
        motion: A motion model, asked only where positions and velocities stand.
        sensor: Of `models.sensor`, or a list of several.
        detect: Of `models.probability`; a target's mode counts as 0. One for each
            sensor.
        clutter: Of `models.clutter`. One for each sensor.
    """

    truth: Truth
    motion: Any
    sensor: Any
    detect: Any
    clutter: Any


class Scenario(NamedTuple):
    """A published experiment: a world and the trackers that are compared in it.

    Attributes:
        name: As on the command line.
        summary: One line.
        world: Truth and sensor.
        trackers: A (tracker, params) pair for each name.
        max_detections: Slots of a scan, K.
        cutoff: Of OSPA and GOSPA, metres.
        order: Of OSPA and GOSPA.
        published: OSPA printed in the paper, {tracker: {setting: metres}}.
    """

    name: str
    summary: str
    world: World
    trackers: Mapping[str, tuple[Tracker, PyTree]]
    max_detections: int
    cutoff: float
    order: float
    published: Mapping[str, Mapping[int, float]]

    def simulate(self, key: Array) -> tuple[Truth, Scan | Scans]:
        """Draws one run: the truth, and scans with a leading T."""
        world = self.world
        return world.truth, observe(key, *world, self.max_detections)


Maker = Callable[..., Scenario]


def observe(
    key: Array,
    truth: Truth,
    motion: Any,
    sensor: Any,
    detect: Any,
    clutter: Any,
    max_detections: int,
) -> Scan | Scans:
    """Draws what the sensor reports, or each of several.

    Args:
        key: Random key.
        truth: T scans of N targets.
        motion: Asked only where positions and velocities stand.
        sensor: Of `models.sensor`, or a list of several.
        detect: Of `models.probability`, or a list.
        clutter: Of `models.clutter`, or a list.
        max_detections: Slots K; where a scan holds more, clutter goes first.

    Returns:
        Scans with a leading T: detections [T, K, Z], valid [T, K], interval [T]. The
        first scan has no predecessor and repeats the interval of the second. Of several
        sensors `Scans`, in which all looked.
    """
    if not isinstance(sensor, list):
        return _observe(key, truth, motion, sensor, detect, clutter, max_detections)
    keys = jax.random.split(key, len(sensor))
    own = zip(keys, sensor, detect, clutter, strict=True)
    each = tuple(
        _observe(k, truth, motion, s, d, c, max_detections) for k, s, d, c in own
    )
    return Scans(each, jnp.ones((truth.time.size, len(sensor)), bool))


def _observe(
    key: Array,
    truth: Truth,
    motion: Any,
    sensor: Any,
    detect: Any,
    clutter: Any,
    max_detections: int,
) -> Scan:
    """Draws what one sensor reports."""

    def one(key: Array, state: Array, exists: Array) -> tuple[Array, Array]:
        target_key, seen_key, clutter_key = jax.random.split(key, 3)
        noise_keys = jax.random.split(target_key, exists.size)
        hits = jax.vmap(lambda k, x: _detect(k, x, motion, sensor))(noise_keys, state)
        prob = jax.vmap(lambda x: detect.prob(0, x, 0.0))(state)
        seen = exists & (jax.random.uniform(seen_key, exists.shape) < prob)
        false, false_valid = clutter.sample(clutter_key, max_detections)
        detections = jnp.concatenate([hits, false])
        valid = jnp.concatenate([seen, false_valid])
        first = jnp.argsort(~valid, stable=True)[:max_detections]
        return detections[first], valid[first]

    keys = jax.random.split(key, truth.time.size)
    detections, valid = jax.vmap(one)(keys, truth.state, truth.exists)
    gaps = jnp.diff(truth.time)
    return Scan(detections, valid, jnp.concatenate([gaps[:1], gaps]))


def shown(scans: Scan | Scans, sensor: Any) -> Scan:
    """Returns scans for a picture: of several sensors the positions, in one row.

    Args:
        scans: With a leading T.
        sensor: As in `World`; each of several must be able to locate.
    """
    if isinstance(scans, Scan):
        return scans
    places = [
        jax.vmap(jax.vmap(lambda z, x=x: x.locate(z).mean))(scan.detections)
        for x, scan in zip(sensor, scans.each, strict=True)
    ]
    return Scan(
        jnp.concatenate(places, 1),
        jnp.concatenate([scan.valid for scan in scans.each], 1),
        scans.each[0].interval,
    )


def _detect(key: Array, state: Array, motion: Any, sensor: Any) -> Array:
    position = jnp.stack([state[i] for i in motion.position_index])
    velocity = jnp.stack([state[i] for i in motion.velocity_index])
    expected = sensor.measure(position, velocity)
    white = jax.random.normal(key, expected.shape, expected.dtype)
    if hasattr(sensor, "report"):
        return sensor.report(position, velocity, white)
    noise = dense(linalg.cholesky(sensor.cov())) @ white
    # The residual against zero wraps the angles of the noisy detection.
    return sensor.residual(expected + noise, 0 * expected)


@functools.cache
def turn_matrix(turn_rate: float, interval: float) -> np.ndarray:
    """Returns what turning without noise does to [x, vx, y, vy], [4, 4].

    Args:
        turn_rate: rad/s, anticlockwise positive.
        interval: Seconds.
    """
    turn = CoordinatedTurn(jnp.asarray(turn_rate), jnp.zeros(()))
    return np.asarray(turn.transition(jnp.asarray(interval)))


def slots_for(num_targets: int, clutter_rate: float) -> int:
    """Returns a scan capacity that Poisson clutter exceeds about once in 10^9 scans."""
    return num_targets + int(clutter_rate + 6 * clutter_rate**0.5 + 6)
