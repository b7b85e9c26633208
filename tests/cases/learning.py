"""Small things to be learned: trackers that compile at once, and their scans."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import kalman, linearize
from jaxtrack.constraints import Positive
from jaxtrack.models import motion, sensor
from jaxtrack.types import Array, Gaussian, Scan, Tracker

RUNS, SCANS = 3, 40


class Params(NamedTuple):
    """Of the noise seen by two factors, of which only the product can be known."""

    std: Positive
    factor: Positive
    mean: Array


class Told(NamedTuple):
    log_evidence: Any
    mean: Any
    existence_prob: Any


def watch(params, state, scan):
    """Sees independent numbers N(mean, (std factor)^2)."""
    std = params.std * params.factor
    z = (scan.detections[0, 0] - params.mean) / std
    log_density = -(z**2) / 2 - jnp.log(std) - np.log(2 * np.pi) / 2
    place = params.mean[None, None]
    return state, Told(log_density, place, jax.nn.sigmoid(params.mean)[None])


watcher = Tracker(lambda params, key: jnp.zeros(()), watch)


def watched(seed=0, runs=RUNS, mean=1.5, std=0.7):
    rng = np.random.default_rng(seed)
    z = mean + std * rng.normal(size=(runs, SCANS, 1, 1))
    return Scan(z, np.ones((runs, SCANS, 1), bool), np.ones((runs, SCANS)))


def start(std=1.0, factor=1.0, mean=0.5):
    return Params(*(np.array(x) for x in (std, factor, mean)))


class Line(NamedTuple):
    """A target that moves along a line, seen once in every scan."""

    motion: motion.ConstantVelocity
    sensor: sensor.Position


PRIOR = Gaussian(np.zeros(2), np.diag([25.0, 4.0]))


def follow(params, belief, scan):
    way = linearize.motion_affine(
        params.motion, belief, scan.interval, linearize.taylor
    )
    moved = kalman.predict(belief, way)
    seen = linearize.sensor_affine(
        params.sensor, params.motion, moved, linearize.taylor
    )
    belief, log_density = kalman.update(moved, seen, scan.detections[0])
    return belief, Told(log_density, belief.mean[None], jnp.ones(1))


follower = Tracker(lambda params, key: jax.tree.map(jnp.asarray, PRIOR), follow)


def moving(seed, density=0.5, std=2.0, runs=RUNS):
    """Irregular scans of targets that begin as PRIOR says."""
    rng = np.random.default_rng(seed)
    interval = rng.uniform(0.5, 2.0, (runs, SCANS))
    z = np.empty((runs, SCANS))
    for i in range(runs):
        x = rng.multivariate_normal(PRIOR.mean, PRIOR.cov)
        for k, (move, noise) in enumerate(map(models, interval[i])):
            x = rng.multivariate_normal(move @ x, density * noise)
            z[i, k] = x[0] + std * rng.normal()
    return Scan(z[..., None, None], np.ones((runs, SCANS, 1), bool), interval)


def models(dt):
    """Transition and unit noise."""
    unit = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return np.array([[1.0, dt], [0.0, 1.0]]), unit


def log_evidence(scans, density, std):
    """That of all recordings, by the book."""
    total = 0.0
    for z, interval in zip(scans.detections[..., 0, 0], scans.interval, strict=True):
        x, cov = PRIOR
        for seen, dt in zip(z, interval, strict=True):
            move, noise = models(dt)
            x, cov = move @ x, move @ cov @ move.T + density * noise
            var = cov[0, 0] + std**2
            total -= (np.log(2 * np.pi * var) + (seen - x[0]) ** 2 / var) / 2
            gain = cov[:, 0] / var
            x, cov = x + gain * (seen - x[0]), cov - np.outer(gain, cov[0])
    return total
