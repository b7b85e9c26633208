"""Where a learned number lies: two standard errors to each side, on its own scale.

What must be positive is taken by its logarithm, a probability by its log-odds: there
the evidence is nearer to a parabola, and an interval never holds what cannot be. Of an
array with one free number to each entry these are two errors of the free numbers.

    >>> import numpy as np
    >>> from jaxtrack.learn import intervals
    >>> print(intervals.interval("positive", np.array(2.0), np.array(1.0)).round(2))
    [0.74 5.44]
    >>> print(intervals.interval("probability", np.array(0.9), np.array(0.05)).round(3))
    [0.748 0.965]

Reference: Pawitan, "In all likelihood", Oxford University Press, 2001, section 2.9
(invariance of the likelihood, and a scale on which it is regular).
"""

import numpy as np
from numpy.typing import ArrayLike

from jaxtrack.constraints import Kind

WIDTH = 2.0  # standard errors


def interval(kind: Kind, value: ArrayLike, std_error: ArrayLike) -> np.ndarray:
    """Returns the ends, about 95 % of the time to either side of the truth.

    Args:
        kind: What values the array may have.
        value: What was found, [...].
        std_error: Its standard errors, [...].

    Returns:
        [..., 2]; the value itself where the error is 0, all that may be where it is
        infinite, NaN where it is NaN.
    """
    value = np.asarray(value, float)
    half = WIDTH * np.asarray(std_error, float)
    ends = _real(value, half)
    if kind in ("probability", "below", "simplex", "jumps"):
        inside = (value > 0) & (value < 1)
        ends = np.where(inside[..., None], _odds(value, half), ends)
    elif kind in ("positive", "covariance"):
        ends = np.where(_positive(kind, value)[..., None], _log(value, half), ends)
    return np.where((half == 0)[..., None], value[..., None], ends)


def _positive(kind: Kind, value: np.ndarray) -> np.ndarray:
    """Returns which entries are: of a covariance, its variances."""
    if kind == "covariance":
        return (value > 0) & np.eye(value.shape[-1], dtype=bool)
    return value > 0


def _real(value: np.ndarray, half: np.ndarray) -> np.ndarray:
    return np.stack([value - half, value + half], -1)


def _log(value: np.ndarray, half: np.ndarray) -> np.ndarray:
    safe = np.where(value > 0, value, 1.0)
    with np.errstate(over="ignore"):
        return np.exp(_real(np.log(safe), half / safe))


def _odds(value: np.ndarray, half: np.ndarray) -> np.ndarray:
    safe = np.where((value > 0) & (value < 1), value, 0.5)
    odds = _real(np.log(safe) - np.log1p(-safe), half / (safe * (1 - safe)))
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-odds))
