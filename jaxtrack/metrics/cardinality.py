"""How well the number of targets is estimated, over R runs and at each of T scans.

Counts may be whole (targets reported) or real (expected number of targets).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import cardinality
    >>> truth = jnp.array([[2, 3], [2, 3]])
    >>> estimated = jnp.array([[2, 2], [4, 2]])
    >>> print(cardinality.bias(truth, estimated), cardinality.spread(truth, estimated))
    [ 1. -1.] [1. 0.]
"""

import chex
import jax.numpy as jnp

from jaxtrack.types import Array


def bias(truth: Array, estimated: Array) -> Array:
    """Returns the mean over runs of estimated minus true number, [T].

    Args:
        truth: True number of targets, [R, T].
        estimated: Estimated number of targets, [R, T].
    """
    return _error(truth, estimated).mean(0)


def spread(truth: Array, estimated: Array) -> Array:
    """Returns the standard deviation over runs of estimated minus true number, [T].

    It divides by R, so that one run has spread 0.

    Args:
        truth: True number of targets, [R, T].
        estimated: Estimated number of targets, [R, T].
    """
    return _error(truth, estimated).std(0)


def rmse(truth: Array, estimated: Array) -> Array:
    """Returns the root mean square over runs of the error in number, [T].

    Its square is bias^2 + spread^2.

    Args:
        truth: True number of targets, [R, T].
        estimated: Estimated number of targets, [R, T].
    """
    return jnp.sqrt((_error(truth, estimated) ** 2).mean(0))


def _error(truth: Array, estimated: Array) -> Array:
    """Returns estimated minus true number as floats, [R, T]."""
    num_runs, num_scans = truth.shape
    chex.assert_shape(estimated, (num_runs, num_scans))
    return jnp.asarray(estimated, float) - truth
