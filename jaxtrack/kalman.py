"""The Kalman filter. There is one; EKF, UKF and CKF are ways to make its affine models.

    belief = predict(belief, motion)
    belief, log_density = update(belief, sensor, detection)

`jaxtrack.linearize` makes the `Affine` models. When the models of a whole track are
known beforehand,

    filtered = filter(prior, motions, sensors, detections, detected)
    smoothed = smooth(filtered, motions)

run all its scans; `jaxtrack.kalman_parallel` has the same two, parallel in time.

References: Kalman, "A new approach to linear filtering and prediction problems",
Journal of Basic Engineering 82(1), 1960; Rauch, Tung and Striebel, "Maximum likelihood
estimates of linear dynamic systems", AIAA Journal 3(8), 1965.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import kalman
    >>> from jaxtrack.types import Affine, Gaussian
    >>> prior = Gaussian(mean=jnp.zeros(1), cov=jnp.eye(1))
    >>> still = Affine(jnp.eye(1), jnp.zeros(1), 3.0 * jnp.eye(1))
    >>> predicted = kalman.predict(prior, still)
    >>> sensor = Affine(jnp.eye(1), jnp.zeros(1), 4.0 * jnp.eye(1))
    >>> belief, log_density = kalman.update(predicted, sensor, jnp.array([1.0]))
    >>> print(belief.mean, belief.cov)
    [0.5] [[2.]]
"""

from collections.abc import Callable
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.entries import Matrix, dense, flat
from jaxtrack.types import Affine, Array, Gaussian


class Filtered(NamedTuple):
    """What a filter knew at each of T scans.

    Attributes:
        predicted: Before the scan; mean [T, D], cov [T, D, D].
        filtered: After the scan; mean [T, D], cov [T, D, D].
        log_density: Of the scan's detection given all earlier ones, [T]; 0 for a scan
            without detection, so that the sum is the log-density of the data.
    """

    predicted: Gaussian
    filtered: Gaussian
    log_density: Array


def predict(belief: Gaussian, motion: Affine) -> Gaussian:
    """Moves a belief one step through an affine motion model.

    Args:
        belief: mean [D], cov [D, D].
        motion: matrix [D, D], offset [D], cov [D, D].

    Returns:
        The predicted belief, mean [D], cov [D, D].
    """
    matrix, noise = linalg.entries(motion.matrix), linalg.symmetric(motion.cov)
    mean, cov = linalg.column(belief.mean), linalg.symmetric(belief.cov)
    moved = matrix @ mean + linalg.column(motion.offset)
    spread = linalg.congruence(matrix, cov) + noise
    return Gaussian(flat(moved), dense(linalg.settle(spread)))


def update(
    belief: Gaussian,
    sensor: Affine,
    detection: Array,
    residual: Callable[[Array, Array], Array] = jnp.subtract,
) -> tuple[Gaussian, Array]:
    """Conditions a belief on one detection.

    With S = L L' the covariance of the detection it is mean + W' L^-1 (z - H m) and
    P - W' W, W = L^-1 H P. What the difference can lose by rounding is added beforehand
    (`linalg.loosen`). In float32 that keeps the covariance positive definite while the
    prior's variances are up to some ten thousand times the sensor's. Beyond, it may be
    lost where several precise outputs see strongly correlated components, or after a
    first detection 1e7 times more precise than where the prior's velocity leads; then
    use float64.

    Args:
        belief: mean [D], cov [D, D].
        sensor: matrix [Z, D], offset [Z], cov [Z, Z].
        detection: [Z].
        residual: (detection, expected) -> [Z]; a sensor with angles wraps them here.

    Returns:
        The posterior belief, and the log-density of the detection (a scalar).
    """
    chex.assert_shape(detection, sensor.offset.shape)
    matrix, noise = linalg.entries(sensor.matrix), linalg.symmetric(sensor.cov)
    mean, cov = linalg.column(belief.mean), linalg.symmetric(belief.cov)

    surprise = residual(detection, flat(matrix @ mean) + sensor.offset)
    lower = linalg.cholesky(linalg.congruence(matrix, cov) + noise)
    seen = linalg.solve_lower(lower, matrix @ cov)  # [Z, D]
    white = linalg.solve_lower(lower, linalg.column(surprise))
    mean = mean + seen.T @ white
    cov = linalg.triangle(linalg.loosen(cov) - seen.T @ seen)
    return Gaussian(flat(mean), dense(cov)), linalg.log_white(white, lower)


def log_density(
    belief: Gaussian,
    sensor: Affine,
    detection: Array,
    residual: Callable[[Array, Array], Array] = jnp.subtract,
) -> Array:
    """Returns the log-density of a detection, as `update` does, without updating."""
    chex.assert_shape(detection, sensor.offset.shape)
    matrix, noise = linalg.entries(sensor.matrix), linalg.symmetric(sensor.cov)
    mean, cov = linalg.column(belief.mean), linalg.symmetric(belief.cov)
    surprise = residual(detection, flat(matrix @ mean) + sensor.offset)
    lower = linalg.cholesky(linalg.congruence(matrix, cov) + noise)
    return linalg.log_normal(surprise, lower)


def blind(sensor: Affine, detection: Array, detected: Array) -> tuple[Affine, Array]:
    """Makes a sensor harmless in a scan without detection.

    An update with what comes back has finite values and gradients, even if the
    arguments held NaN. If the matrix was an array the sensor sees nothing, and the
    update leaves the belief as it is, but for rounding; a `Matrix` keeps the entries
    that are known, so leave out what the update returns, as `filter` does.

    Args:
        sensor: matrix [Z, D], offset [Z], cov [Z, Z].
        detection: [Z]; any numbers if there was none.
        detected: Whether there was one (a bool scalar).

    Returns:
        Sensor and detection; unchanged if there was one, otherwise a matrix of zeros
        (and of what is known) with unit noise, and zeros.
    """
    unit = jnp.eye(detection.size, dtype=sensor.cov.dtype)
    blinded = Affine(
        matrix=jax.tree.map(lambda x: jnp.where(detected, x, 0.0), sensor.matrix),
        offset=jnp.where(detected, sensor.offset, 0.0),
        cov=jnp.where(detected, dense(sensor.cov), unit),
    )
    return blinded, jnp.where(detected, detection, 0.0)


def filter(
    prior: Gaussian,
    motions: Affine,
    sensors: Affine,
    detections: Array,
    detected: Array,
) -> Filtered:
    """Runs predict and update over the T scans of one track.

    Motion t leads from scan t - 1 to scan t, and motion 0 from the prior to scan 0: the
    prior is the belief one motion before the first scan. (Elsewhere, as in dynamax, the
    prior often is the belief at the first scan, and motion 0 is not used.)

    Args:
        prior: mean [D], cov [D, D].
        motions: matrix [T, D, D], offset [T, D], cov [T, D, D].
        sensors: matrix [T, Z, D], offset [T, Z], cov [T, Z, Z].
        detections: [T, Z].
        detected: Which scans have a detection, [T] (bool). The others only predict;
            what stands in their sensor and detection does not matter.

    Returns:
        The beliefs before and after each scan, and the log-densities.
    """
    num_scans, num_outputs = detections.shape
    dim = prior.mean.size
    chex.assert_shape(motions.offset, (num_scans, dim))
    chex.assert_shape(sensors.offset, (num_scans, num_outputs))
    chex.assert_shape(detected, (num_scans,))

    def step(belief: Gaussian, scan: tuple) -> tuple[Gaussian, Filtered]:
        motion, sensor, detection, seen = scan
        predicted = predict(belief, motion)
        updated = update(predicted, *blind(sensor, detection, seen))
        missed = predicted, jnp.zeros_like(updated[1])
        belief, log_density = jax.tree.map(
            lambda hit, miss: jnp.where(seen, hit, miss), updated, missed
        )
        return belief, Filtered(predicted, belief, log_density)

    scans = (motions, sensors, detections, detected)
    return jax.lax.scan(step, prior, scans)[1]


def turn_back(
    filtered: Gaussian, motion: Affine, predicted: Gaussian
) -> tuple[Array, Array]:
    """Turns a motion around: what the state after it says about the one before.

    Given x after the motion, the state before it has mean
    filtered.mean + gain @ (x - predicted.mean) and the covariance returned, which is in
    Joseph form: symmetric, and a sum of positive semi-definite terms.

    Args:
        filtered: Belief before the motion, mean [D], cov [D, D].
        motion: matrix [D, D], offset [D], cov [D, D].
        predicted: `predict(filtered, motion)`, with a positive definite covariance.

    Returns:
        The gain [D, D], and the covariance that is left [D, D].
    """
    matrix, noise = dense(motion.matrix), dense(motion.cov)
    lower = linalg.cholesky(predicted.cov)
    gain = linalg.solve(lower, linalg.product(matrix, filtered.cov)).T
    keep = jnp.eye(len(gain), dtype=gain.dtype) - linalg.product(gain, matrix)
    left = linalg.congruence(keep, filtered.cov) + linalg.congruence(gain, noise)
    return gain, left


def smooth_step(
    filtered: Gaussian, motion: Affine, predicted: Gaussian, smoothed: Gaussian
) -> Gaussian:
    """Carries what is known after a motion back to before it.

    Args:
        filtered: Belief before the motion, mean [D], cov [D, D].
        motion: matrix [D, D], offset [D], cov [D, D].
        predicted: `predict(filtered, motion)`, with a positive definite covariance.
        smoothed: Belief after the motion, given all data; mean [D], cov [D, D].

    Returns:
        The belief before the motion, given all data; mean [D], cov [D, D].
    """
    gain, left = turn_back(filtered, motion, predicted)
    mean = filtered.mean + gain @ (smoothed.mean - predicted.mean)
    return Gaussian(mean, linalg.congruence(gain, smoothed.cov) + left)


def smooth(filtered: Filtered, motions: Affine) -> Gaussian:
    """Runs the Rauch-Tung-Striebel smoother over the T scans of one track.

    Args:
        filtered: What `filter` returned.
        motions: What `filter` was given; matrix [T, D, D], offset [T, D],
            cov [T, D, D]. Motion t leads from scan t - 1 to scan t.

    Returns:
        The beliefs at each scan given all scans, mean [T, D], cov [T, D, D].
    """
    motions = stacked(motions)
    chex.assert_equal_shape([motions.matrix, filtered.filtered.cov])
    before, last = split_last(filtered.filtered)
    after = jax.tree.map(lambda x: x[1:], (motions, filtered.predicted))

    def step(smoothed: Gaussian, scan: tuple) -> tuple[Gaussian, Gaussian]:
        belief, (motion, predicted) = scan
        smoothed = smooth_step(belief, motion, predicted, smoothed)
        return smoothed, smoothed

    smoothed = jax.lax.scan(step, last, (before, after), reverse=True)[1]
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y[None]]), smoothed, last)


def stacked(models: Affine) -> Affine:
    """Returns affine models of T scans as arrays, also where no entry has a T."""
    num, size = models.offset.shape

    def full(matrix: Array | Matrix, width: int) -> Array:
        return jnp.broadcast_to(dense(matrix), (num, size, width))

    width = models.matrix.shape[-1]
    return Affine(full(models.matrix, width), models.offset, full(models.cov, size))


def split_last(beliefs: Gaussian) -> tuple[Gaussian, Gaussian]:
    """Splits T beliefs into the first T - 1, and the last one without its axis."""
    first = jax.tree.map(lambda x: x[:-1], beliefs)
    return first, jax.tree.map(lambda x: x[-1], beliefs)
