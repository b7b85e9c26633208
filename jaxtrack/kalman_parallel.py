"""The Kalman filter and smoother of `jaxtrack.kalman`, parallel in time.

    filtered = filter(prior, motions, sensors, detections, detected)
    smoothed = smooth(filtered, motions)

Same arguments and results as there, but T scans take O(log T) steps one after another
instead of T. In all it is more work, and the program grows with log T and takes seconds
to compile; it is for long tracks on wide hardware. On two cores both are equally fast.

Between two scans lies a `Segment`; segments join associatively, and a prefix sum of
them (`jax.lax.associative_scan`) gives all filtered beliefs.

Reference: Särkkä and García-Fernández, "Temporal parallelization of Bayesian
smoothers", IEEE Trans. Automatic Control 66(1), 2021, the linear Gaussian case.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import kalman_parallel
    >>> from jaxtrack.types import Affine, Gaussian
    >>> walk = Affine(jnp.ones((3, 1, 1)), jnp.zeros((3, 1)), jnp.ones((3, 1, 1)))
    >>> prior = Gaussian(jnp.zeros(1), jnp.ones((1, 1)))
    >>> detections = jnp.array([[3.0], [0.0], [13.0]])
    >>> detected = jnp.array([True, False, True])
    >>> result = kalman_parallel.filter(prior, walk, walk, detections, detected)
    >>> print(result.filtered.mean[:, 0].round(1))
    [ 2.  2. 10.]
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import kalman, linalg
from jaxtrack.kalman import Filtered
from jaxtrack.types import Affine, Array, Gaussian


class Segment(NamedTuple):
    """A stretch of scans, as seen from the state x before it.

    Attributes:
        ahead: The state at its end given x and the segment's detections is
            N(matrix @ x + offset, cov).
        vector: eta [D]; the segment's detections have a density in x proportional to
            exp(eta @ x - x @ J @ x / 2).
        information: J, [D, D].
    """

    ahead: Affine
    vector: Array
    information: Array


def segment(motion: Affine, sensor: Affine, detection: Array) -> Segment:
    """Makes the segment of one motion and the scan it leads to.

    Args:
        motion: matrix [D, D], offset [D], cov [D, D].
        sensor: matrix [Z, D], offset [Z], cov [Z, Z].
        detection: [Z].

    Returns:
        The segment.
    """
    # From a known state, the motion predicts its offset (plus matrix @ state) with its
    # noise as the covariance.
    belief, _ = kalman.update(Gaussian(motion.offset, motion.cov), sensor, detection)
    cross = linalg.product(sensor.matrix, motion.cov)
    lower = linalg.cholesky(linalg.congruence(sensor.matrix, motion.cov) + sensor.cov)
    seen = linalg.product(sensor.matrix, motion.matrix)
    white = linalg.solve_lower(lower, seen)
    surprise = detection - sensor.matrix @ motion.offset - sensor.offset

    explained = linalg.product(cross.T, linalg.solve_upper(lower, white))
    return Segment(
        ahead=Affine(motion.matrix - explained, belief.mean, belief.cov),
        vector=white.T @ linalg.solve_lower(lower, surprise),
        information=linalg.symmetrize(linalg.product(white.T, white)),
    )


def join(first: Segment, second: Segment) -> Segment:
    """Joins a segment and the one after it."""
    (matrix, offset, cov), vector, information = first
    ahead = second.ahead
    size = offset.size

    # cov and information may be singular, so no Cholesky factor of either will do.
    shrink = jnp.eye(size, dtype=cov.dtype) + linalg.product(cov, second.information)
    column = (offset + cov @ second.vector)[:, None]
    solution = jnp.linalg.solve(shrink, jnp.concatenate([matrix, cov, column], axis=1))
    matrix_left, cov_left = solution[:, :size], solution[:, size : 2 * size]

    back = second.vector - second.information @ offset
    known = linalg.product(matrix_left.T, linalg.product(second.information, matrix))
    return Segment(
        ahead=Affine(
            matrix=linalg.product(ahead.matrix, matrix_left),
            offset=ahead.matrix @ solution[:, -1] + ahead.offset,
            cov=linalg.congruence(ahead.matrix, cov_left) + ahead.cov,
        ),
        vector=matrix_left.T @ back + vector,
        information=linalg.symmetrize(known) + information,
    )


def filter(
    prior: Gaussian,
    motions: Affine,
    sensors: Affine,
    detections: Array,
    detected: Array,
) -> Filtered:
    """Runs predict and update over the T scans of one track, all scans at once.

    Motion t leads from scan t - 1 to scan t, and motion 0 from the prior to scan 0.
    The prefix sum gives the belief after each scan but the last; from it one ordinary
    step of `jaxtrack.kalman` leads to everything that is returned, so covariances are
    symmetric and in Joseph form.

    The sums hold positions times inverse variances. In float64 the result is that of
    `kalman.filter` to rounding; in float32 keep positions near the origin, or use the
    sequential form.

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
    motions, sensors = kalman.stacked(motions), kalman.stacked(sensors)
    seen = jax.vmap(kalman.blind)(sensors, detections, detected)
    segments = jax.vmap(segment)(*jax.tree.map(lambda x: x[:-1], (motions, *seen)))
    zero = jnp.zeros_like(prior.cov)
    start = Segment(Affine(zero, *prior), jnp.zeros_like(prior.mean), zero)
    segments = jax.tree.map(lambda x, y: jnp.concatenate([x[None], y]), start, segments)

    _, mean, cov = jax.lax.associative_scan(jax.vmap(join), segments).ahead
    predicted = jax.vmap(kalman.predict)(Gaussian(mean, cov), motions)
    filtered, log_density = jax.vmap(kalman.update)(predicted, *seen)
    return Filtered(predicted, filtered, jnp.where(detected, log_density, 0.0))


def smooth(filtered: Filtered, motions: Affine) -> Gaussian:
    """Runs the Rauch-Tung-Striebel smoother over T scans, all scans at once.

    Args:
        filtered: What `filter` returned.
        motions: What `filter` was given; matrix [T, D, D], offset [T, D],
            cov [T, D, D]. Motion t leads from scan t - 1 to scan t.

    Returns:
        The beliefs at each scan given all scans, mean [T, D], cov [T, D, D].
    """
    motions = kalman.stacked(motions)
    before, last = kalman.split_last(filtered.filtered)
    motion, predicted = jax.tree.map(lambda x: x[1:], (motions, filtered.predicted))
    gain, left = jax.vmap(kalman.turn_back)(before, motion, predicted)

    # What smoothing adds to the filtered mean is affine in what it adds one scan later.
    # It is small where positions are large, which keeps float32 accurate.
    correction = (filtered.filtered.mean - filtered.predicted.mean)[1:]
    links = Affine(gain, jax.vmap(jnp.matmul)(gain, correction), left)
    end = Affine(jnp.zeros_like(last.cov), jnp.zeros_like(last.mean), last.cov)
    links = jax.tree.map(lambda x, y: jnp.concatenate([x, y[None]]), links, end)

    total = jax.lax.associative_scan(jax.vmap(chain), links, reverse=True)
    return Gaussian(filtered.filtered.mean + total.offset, total.cov)


def chain(first: Affine, second: Affine) -> Affine:
    """Returns the affine map that applies `first` and then `second`."""
    offset, cov = kalman.predict(Gaussian(first.offset, first.cov), second)
    return Affine(linalg.product(second.matrix, first.matrix), offset, cov)
