"""Whether a filter's errors are as large as its covariances say they are.

NEES and NIS of a consistent filter are chi-square distributed with as many degrees of
freedom as the error has entries. Average them over R independent runs, at each scan,
and compare with `chi2_bounds`: above is overconfident, below is pessimistic.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import consistency
    >>> print(consistency.nees(jnp.array([2.0, 3.0]), jnp.diag(jnp.array([4.0, 1.0]))))
    10.0
    >>> low, high = consistency.chi2_bounds(dim=2, num_runs=50)
    >>> print(round(low, 2), round(high, 2))
    1.48 2.59

Reference: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking
and Navigation", Wiley, 2001, section 5.4.
"""

import chex
from scipy import stats

from jaxtrack import linalg
from jaxtrack.types import Array


def nees(error: Array, cov: Array) -> Array:
    """Returns the normalised estimation error squared, error' cov^-1 error.

    Args:
        error: True minus estimated state, angles wrapped, [D].
        cov: The filter's covariance, positive definite, [D, D].
    """
    size = error.size
    chex.assert_shape(error, (size,))
    chex.assert_shape(cov, (size, size))
    white = linalg.solve_lower(linalg.cholesky(cov), error)
    return (white * white).sum()


def nis(residual: Array, cov: Array) -> Array:
    """Returns the normalised innovation squared, residual' cov^-1 residual.

    It needs no truth, hence serves recorded data. The same algebra as `nees`.

    Args:
        residual: Detection minus predicted detection, angles wrapped, [Z].
        cov: Covariance of the innovation, noise included, [Z, Z].
    """
    return nees(residual, cov)


def chi2_bounds(dim: int, num_runs: int, prob: float = 0.95) -> tuple[float, float]:
    """Computes the two-sided bounds of an average NEES or NIS over independent runs.

    The sum over runs is chi-square with dim * num_runs degrees of freedom; the tails
    left out have equal probability. For the time average of the NIS of one run over
    T scans, which are independent too, give T for `num_runs`.

    Args:
        dim: Entries of the error, D or Z.
        num_runs: Runs averaged over, R.
        prob: Probability that a consistent filter is inside.

    Returns:
        Lower and upper bound.

    Raises:
        ValueError: `dim` or `num_runs` below one, or `prob` not between 0 and 1.
    """
    if dim < 1:
        raise ValueError(f"dim is {dim}; it must be at least 1.")
    if num_runs < 1:
        raise ValueError(f"num_runs is {num_runs}; it must be at least 1.")
    if not 0 < prob < 1:
        raise ValueError(f"prob is {prob}; it must be between 0 and 1, as in 0.95.")
    low, high = stats.chi2.interval(prob, dim * num_runs)
    return float(low) / num_runs, float(high) / num_runs
