"""Expectation-maximisation: learning without step sizes, where it can be written down.

For one track with known linear models, a round smooths and then takes the noises that
are the likeliest given what was smoothed; the evidence never falls:

    told = em.smooth(prior, motions, sensors, detections, detected)
    noise_density = em.density(told.motion, unit)    # motions.cov is density * unit
    noise_cov = em.covariance(told.sensor, detected)

`linear` does so until nothing changes. For mode transitions, `transitions` counts how
often one mode followed another, from the mode probabilities that an IMM or any other
tracker told (Kim's smoother). That is exact where only the modes are hidden; in an IMM
the detections up to now stand for all that is known of the state, so there it is an
approximation, and the evidence may fall.

    >>> import numpy as np
    >>> from jaxtrack.learn import em
    >>> told = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # modes that are seen
    >>> print(em.transitions(told, np.full((2, 2), 0.5)))
    [[1. 1.]
     [0. 0.]]

References: Shumway and Stoffer, "An approach to time series smoothing and forecasting
using the EM algorithm", J. Time Series Analysis 3(4), 1982; Kim, "Dynamic linear models
with Markov-switching", J. Econometrics 60, 1994.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import kalman, linalg
from jaxtrack.entries import dense
from jaxtrack.types import Affine, Array, Gaussian


class Expected(NamedTuple):
    """What smoothing tells of the noises of one track.

    Attributes:
        log_evidence: Log-density of all detections.
        motion: Second moment of what each motion added, [T, D, D].
        sensor: Second moment of each detection's error, [T, Z, Z]; 0 without one.
    """

    log_evidence: Array
    motion: Array
    sensor: Array


class Learned(NamedTuple):
    """What `linear` found.

    Attributes:
        density: Of the motion's noise, in its unit; a scalar.
        sensor_cov: Of the detections' errors, [Z, Z].
        log_evidence: Before each round, [I].
    """

    density: Array
    sensor_cov: Array
    log_evidence: Array


def smooth(
    prior: Gaussian,
    motions: Affine,
    sensors: Affine,
    detections: Array,
    detected: Array,
) -> Expected:
    """Smooths a track, and returns what is expected of its noises.

    Args:
        prior: One motion before the first scan, as in `kalman.filter`.
        motions: matrix [T, D, D], offset [T, D], cov [T, D, D].
        sensors: matrix [T, Z, D], offset [T, Z], cov [T, Z, Z].
        detections: [T, Z].
        detected: [T] (bool).
    """
    motions, sensors = kalman.stacked(motions), kalman.stacked(sensors)
    filtered = kalman.filter(prior, motions, sensors, detections, detected)
    smoothed = kalman.smooth(filtered, motions)
    before = jax.tree.map(
        lambda x, y: jnp.concatenate([x[None], y[:-1]]), prior, filtered.filtered
    )
    added = jax.vmap(_added)(before, motions, filtered.predicted, smoothed)
    seen = jnp.where(detected[:, None], detections, 0.0)
    errors = jax.vmap(_error)(smoothed, sensors, seen)
    errors = jnp.where(detected[:, None, None], errors, 0.0)
    return Expected(filtered.log_density.sum(), added, errors)


def density(second_moment: Array, unit: Array) -> Array:
    """Returns the likeliest factor of a noise whose covariances are known but for it.

    Args:
        second_moment: Of what each motion added, [T, D, D].
        unit: Covariances for a factor of 1, positive definite, [T, D, D].
    """
    ratio = jax.vmap(lambda x, y: jnp.trace(_solve(x, y)))(unit, second_moment)
    return ratio.mean() / unit.shape[-1]


def covariance(second_moment: Array, counts: Array) -> Array:
    """Returns the likeliest covariance of errors.

    Args:
        second_moment: [T, Z, Z].
        counts: Which of them count, [T] (bool).
    """
    total = jnp.where(counts[:, None, None], second_moment, 0.0).sum(0)
    return linalg.symmetrize(total / jnp.maximum(counts.sum(), 1))


def linear(
    prior: Gaussian,
    motions: Affine,
    sensors: Affine,
    detections: Array,
    detected: Array,
    num_rounds: int = 100,
) -> Learned:
    """Learns the density of a motion's noise and the covariance of a sensor's.

    It climbs slowly where much is hidden: some 100 rounds for three digits. A start
    for `learn.fit`, and a check of it.

    Args:
        prior: As of `smooth`.
        motions: With covariances for a density of 1, where it starts.
        sensors: With the covariance at which it starts.
        detections: [T, Z].
        detected: [T] (bool).
        num_rounds: I.
    """
    motions, sensors = kalman.stacked(motions), kalman.stacked(sensors)

    def one(now: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        factor, cov = now
        moved = motions._replace(cov=factor * motions.cov)
        noisy = sensors._replace(cov=jnp.broadcast_to(cov[None], sensors.cov.shape))
        told = smooth(prior, moved, noisy, detections, detected)
        new = density(told.motion, motions.cov), covariance(told.sensor, detected)
        return new, told.log_evidence

    start = jnp.ones((), motions.cov.dtype), sensors.cov[0]
    now, told = jax.lax.scan(one, start, None, num_rounds)
    return Learned(*now, told)


def transitions(mode_prob: Array, transition: Array) -> Array:
    """Counts how often one mode is expected to have followed another.

    Rows divided by their sums are the next transition matrix; add the counts of
    several tracks first. A row of zeros is a mode that never was.

    Args:
        mode_prob: Of each scan given the detections up to then, [T, M].
        transition: By which they were found, [M, M]; rows are the mode left.

    Returns:
        Expected counts, [M, M].
    """

    def step(after: Array, now: Array) -> tuple[Array, Array]:
        entered = now @ transition
        some = entered > 0
        rate = jnp.where(some, after / jnp.where(some, entered, 1.0), 0.0)
        joint = now[:, None] * transition * rate[None]
        return joint.sum(1), joint

    told = linalg.floating(mode_prob)
    transition = linalg.floating(transition)
    return jax.lax.scan(step, told[-1], told[:-1], reverse=True)[1].sum(0)


def _added(
    before: Gaussian, motion: Affine, predicted: Gaussian, after: Gaussian
) -> Array:
    """Returns the second moment of x' - F x - u, given all data, [D, D].

    Given x' it is linear in it: x has mean m + G (x' - predicted) and what is left.
    """
    gain, left = kalman.turn_back(before, motion, predicted)
    matrix = dense(motion.matrix)
    keep = jnp.eye(len(gain), dtype=gain.dtype) - matrix @ gain
    mean = keep @ (after.mean - predicted.mean)
    cov = linalg.congruence(keep, after.cov) + linalg.congruence(matrix, left)
    return cov + jnp.outer(mean, mean)


def _error(belief: Gaussian, sensor: Affine, detection: Array) -> Array:
    """Returns the second moment of z - H x - d, given all data, [Z, Z]."""
    matrix = dense(sensor.matrix)
    mean = detection - matrix @ belief.mean - sensor.offset
    return linalg.congruence(matrix, belief.cov) + jnp.outer(mean, mean)


def _solve(matrix: Array, right: Array) -> Array:
    return linalg.solve(linalg.cholesky(matrix), right)
