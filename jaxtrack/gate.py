"""Validation gates: which detections a track looks at, and what the rest costs.

A detection is inside the gate of a track if its squared Mahalanobis distance, by the
track's innovation covariance, is at most the chi-square quantile of the gate's
probability P_G. A gate saves work and splits the association into small problems; it
leaves out a detection of the target's own with probability 1 - P_G.

    >>> from jaxtrack import gate
    >>> print(f"{gate.threshold(0.99, size=2):.3f}")
    9.210

Reference: Bar-Shalom and Fortmann, "Tracking and Data Association", 1988, sections 6.3
and 6.4.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg, mixture
from jaxtrack.types import Array, PyTree, Scan, Target


class Gates(NamedTuple):
    """The gates of N tracks in a scan of K detections.

    Attributes:
        inside: Which detections each track looks at, [N, K] (bool).
        log_volume: Of the gate, in units of the measurement space, [N]; if each
            detection meets another gate (`models.sensor.Timed`), the largest.
    """

    inside: Array
    log_volume: Array


def check(gate_prob: float) -> None:
    """Raises a ValueError for a probability that no gate has."""
    if not 0 < gate_prob <= 1:
        raise ValueError(
            f"gate_prob is {gate_prob}; give a probability above 0, e.g. 0.999, or 1 "
            "for no gate"
        )


def validate(
    target: Target, params: Any, views: PyTree, scan: Scan, gate_prob: float
) -> Gates:
    """Finds the detections inside the gate of each track.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        views: N tracks as the sensor sees them, [N, ...].
        scan: K detections.
        gate_prob: P_G; 1 lets every valid detection in.

    Returns:
        The gates.
    """
    distance = jax.vmap(target.distance, (None, 0, None))
    square, log_det = distance(params, views, scan.detections)
    size = params.sensor.num_outputs
    limit = threshold(gate_prob, size)
    volume = log_volume(log_det, limit, size).max(1, initial=-jnp.inf)
    return Gates((square <= limit) & scan.valid[None], volume)


def scores(
    target: Target,
    params: Any,
    views: PyTree,
    log_miss: Array,
    scan: Scan,
    max_scored: int | None = None,
) -> Array:
    """Returns log-densities of detections, times that of detection, [N, K].

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        views: N tracks as the sensor sees them, [N, ...].
        log_miss: Log-probability that a target of each track is missed, [N].
        scan: K detections.
        max_scored: Detections that each track scores itself, the nearest; for the
            others, far away, stands a Gaussian with the moments of what it expects.
            None for all.
    """
    score = jax.vmap(target.score, (None, 0, None))
    if max_scored is None or len(scan.detections) <= max_scored:
        return score(params, views, scan.detections)

    def near(view: PyTree, log_miss: Array) -> Array:
        square, log_det = target.distance(params, view, scan.detections)
        unit = params.sensor.num_outputs * math.log(math.tau)
        rough = linalg.safe_log(-jnp.expm1(log_miss)) - (square + log_det + unit) / 2
        _, first = jax.lax.top_k(jnp.where(scan.valid, rough, -jnp.inf), max_scored)
        exact = target.score(params, view, jnp.take(scan.detections, first, axis=0))
        return rough.at[first].set(exact)

    return jax.vmap(near)(views, log_miss)


def check_scored(max_scored: int | None) -> None:
    """Raises a ValueError for a number of scored detections that makes no sense."""
    if max_scored is not None and max_scored < 1:
        raise ValueError(
            f"max_scored is {max_scored}; give at least 1, or None for all"
        )


def threshold(gate_prob: float, size: int) -> float:
    """Returns the chi-square quantile of P_G.

    Args:
        gate_prob: P_G, from 0 to 1.
        size: Degrees of freedom Z.

    Returns:
        The largest squared distance inside; infinite for P_G = 1.
    """
    if gate_prob >= 1:
        return math.inf
    low, high = 0.0, 1.0
    while _chi_square(high, size) < gate_prob:
        high *= 2
    for _ in range(100):
        middle = (low + high) / 2
        if _chi_square(middle, size) < gate_prob:
            low = middle
        else:
            high = middle
    return high


def _chi_square(square: float, size: int) -> float:
    """Returns the chi-square distribution function, by its recursion in the size."""
    half = square / 2
    prob = math.erf(math.sqrt(half)) if size % 2 else -math.expm1(-half)
    for degrees in range(3 if size % 2 else 4, size + 1, 2):
        order = degrees / 2 - 1
        prob -= math.exp(order * math.log(half) - half - math.lgamma(order + 1))
    return prob


def log_volume(log_det: Array, limit: float, size: int) -> Array:
    """Returns the log-volume of the ellipsoid of squared distance up to a limit.

    Args:
        log_det: Log-determinant of the covariance, any shape.
        limit: Squared distance.
        size: Dimension Z.

    Returns:
        log(c_Z limit^(Z/2) det^(1/2)), c_Z the volume of the unit ball.
    """
    ball = size / 2 * math.log(math.pi) - math.lgamma(size / 2 + 1)
    radius = size / 2 * math.log(limit) if limit < math.inf else math.inf
    return log_det / 2 + ball + radius


def log_missed(log_miss: Array, gate_prob: float) -> Array:
    """Returns log(1 - P_D P_G) for log(1 - P_D): missed, or detected out of the gate.

    Args:
        log_miss: log(1 - P_D), any shape.
        gate_prob: P_G.
    """
    if gate_prob >= 1:
        return log_miss
    detect_prob = -jnp.expm1(log_miss)
    return linalg.safe_log(1 - gate_prob * detect_prob)


def log_clutter_density(gates: Gates) -> Array:
    """Estimates the clutter's log-density by what the gates hold (nonparametric).

    It is the number of detections inside over the volume of the gates, as in the
    nonparametric filter of Bar-Shalom and Fortmann: all detections pass for clutter,
    and gates that overlap count twice.

    Args:
        gates: Of N tracks; an empty slot has log-volume -inf and holds nothing.

    Returns:
        A scalar; that of one detection where the gates hold none.
    """
    num_inside = gates.inside.any(0).sum()
    volume = mixture.total(gates.log_volume)
    volume = jnp.where(volume > -jnp.inf, volume, 0.0)
    return jnp.log(jnp.maximum(num_inside, 1)) - volume
