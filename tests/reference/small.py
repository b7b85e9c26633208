"""A scenario that compiles quickly: two targets, a tracker that echoes detections."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.scenarios.world import Scenario, Truth, World
from jaxtrack.types import Tracker

NUM_SCANS = 6
CUTOFF, ORDER = 30.0, 2.0
traces = []  # grows with every trace of a tracker


class Params(NamedTuple):
    shift: jax.Array  # of the echo against the detection, m
    noise: jax.Array  # of the tracker's own randomness, m
    dropped: jax.Array


class Estimate(NamedTuple):
    mean: jax.Array
    cov: jax.Array
    label: jax.Array
    exists: jax.Array
    existence_prob: jax.Array
    mode_prob: jax.Array
    num_mean: jax.Array
    num_var: jax.Array
    log_evidence: jax.Array
    dropped: jax.Array


@functools.cache
def echo(max_tracks):
    def init(params, key):
        traces.append(max_tracks)
        return params.noise * jax.random.uniform(key, (2,))

    def step(params, state, scan):
        num = scan.valid.size
        state = state * 1.5
        place = scan.detections + params.shift[None] + state[None]
        exists = scan.valid & (jnp.cumsum(scan.valid) <= max_tracks)
        estimate = Estimate(
            mean=jnp.zeros((num, 4)).at[:, jnp.array([0, 2])].set(place),
            cov=jnp.broadcast_to(
                jnp.diag(jnp.array([4.0, 1.0, 9.0, 1.0])), (num, 4, 4)
            ),
            label=jnp.arange(num),
            exists=exists,
            existence_prob=0.9 * exists,
            mode_prob=jnp.ones((num, 1)),
            num_mean=0.9 * exists.sum(),
            num_var=jnp.zeros(()),
            log_evidence=-scan.valid.sum().astype(float),
            dropped=params.dropped,
        )
        return state, estimate

    return Tracker(init, step)


def truth():
    """One target flies east throughout, one flies north in scans 2 to 4."""
    time = jnp.arange(NUM_SCANS) * 2.0
    east = jnp.stack([10 * time, 10 + 0 * time, 0 * time, 0 * time], 1)
    north = jnp.stack([50 + 0 * time, 0 * time, 5 * time, 5 + 0 * time], 1)
    there = (jnp.arange(NUM_SCANS) >= 2) & (jnp.arange(NUM_SCANS) <= 4)
    exists = jnp.stack([jnp.ones(NUM_SCANS, bool), there], 1)
    return Truth(jnp.stack([east, north], 1), exists, time)


def make(
    clutter_rate: float = 1.0,
    detect_prob: float = 0.9,
    max_tracks: int = 4,
    lost: float = 0.0,
) -> Scenario:
    low, high = jnp.array([-50.0, -20.0]), jnp.array([150.0, 90.0])
    world = World(
        truth(),
        ConstantVelocity(jnp.ones(2)),
        Position(jnp.array([1.0, 2.0])),
        Constant(jnp.asarray(detect_prob, float)),
        UniformClutter(jnp.asarray(clutter_rate, float), low, high),
    )
    shift = jnp.array([[0.0, 0.0], [30.0, 40.0]])
    dropped = jnp.asarray(lost, float)
    params = [Params(x, jnp.asarray(0.5), dropped) for x in shift]
    return Scenario(
        name="small",
        summary="two targets and an echo",
        world=world,
        trackers={
            "near": (echo(max_tracks), params[0]),
            "far": (echo(max_tracks), params[1]),
        },
        max_detections=4 + int(clutter_rate),
        cutoff=CUTOFF,
        order=ORDER,
        published={"near": {1: 12.5}},
    )
