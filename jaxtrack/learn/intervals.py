"""Where a learned number lies: two standard errors to each side, on its own scale.

What must be positive is taken by its logarithm, a probability by its log-odds between
its bounds: there the evidence is nearer to a parabola, and an interval has nothing in
it that cannot be. Real numbers are taken as they are, and so is what stands off the
diagonal of a covariance.

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


def interval(
    kind: Kind,
    value: ArrayLike,
    std_error: ArrayLike,
    low: ArrayLike = 0.0,
    high: ArrayLike = 1.0,
) -> np.ndarray:
    """Returns the ends between which the truth is, about 95 % of the time.

    Args:
        kind: What values the array may have.
        value: What was found, [...].
        std_error: Its standard errors, [...].
        low: What probabilities are above.
        high: What they are below.

    Returns:
        [..., 2]; the value itself where the error is 0, all that may be where it is
        infinite, NaN where it is NaN.
    """
    value = np.asarray(value, float)
    half = WIDTH * np.asarray(std_error, float)
    if kind in ("probability", "below", "simplex", "jumps"):
        ends = _odds(value, half, np.asarray(low, float), np.asarray(high, float))
    elif kind == "positive":
        ends = _log(value, half)
    elif kind == "covariance":
        own = np.eye(value.shape[-1], dtype=bool)[..., None]
        ends = np.where(own, _log(value, half), _real(value, half))
    else:
        ends = _real(value, half)
    return np.where((half == 0)[..., None], value[..., None], ends)


def _real(value: np.ndarray, half: np.ndarray) -> np.ndarray:
    return np.stack([value - half, value + half], -1)


def _log(value: np.ndarray, half: np.ndarray) -> np.ndarray:
    safe = np.where(value > 0, value, 1.0)
    with np.errstate(over="ignore"):
        ends = np.exp(_real(np.log(safe), half / safe))
    # Smaller than any number that there is: nothing is known of its logarithm.
    return np.where((value > 0)[..., None], ends, [0.0, np.inf])


def _odds(
    value: np.ndarray, half: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    width = high - low
    share = (value - low) / width
    inside = (share > 0) & (share < 1)
    safe = np.where(inside, share, 0.5)
    odds = np.log(safe) - np.log1p(-safe)
    with np.errstate(over="ignore"):
        ends = 1 / (1 + np.exp(-_real(odds, half / width / (safe * (1 - safe)))))
    # It was rounded to a bound.
    ends = np.where(inside[..., None], ends, np.clip(_real(share, half / width), 0, 1))
    return low[..., None] + width[..., None] * ends
