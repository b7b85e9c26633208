"""Root mean squares over R runs, and their sums over time, as papers print them.

A metric of order p is averaged to the p-th power and the root taken at the end. The sum
of the roots over time is one number of a tracker; its standard error is that of the
jackknife over runs, as neighbouring times are not independent.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import averages
    >>> distance = jnp.array([[3.0, 5.0], [4.0, 5.0]])  # two runs, two times
    >>> print(averages.root_mean(distance**2).round(3))
    [3.536 5.   ]
    >>> total = averages.total(distance**2)
    >>> print(total.value.round(3), total.std_error.round(3))
    8.536 0.5

Reference: Efron and Tibshirani, "An Introduction to the Bootstrap", Chapman and Hall,
1993, chapter 11.
"""

from typing import NamedTuple

import chex
import jax.numpy as jnp

from jaxtrack.metrics.assignment import root
from jaxtrack.types import Array


class Total(NamedTuple):
    """A sum over time, and its standard error over runs."""

    value: Array
    std_error: Array


def root_mean(power: Array, order: Array | float = 2.0) -> Array:
    """Returns the p-th root of the mean over runs, [R, ...] -> [...].

    Args:
        power: Distances to the power p, or parts of such, [R, ...].
        order: p.
    """
    return root(power.mean(0), order)


def total(power: Array, order: Array | float = 2.0) -> Total:
    """Sums the p-th roots of the means over runs over all times.

    Args:
        power: Distances to the power p, or parts of such, [R, T].
        order: p.

    Returns:
        The sum, and its standard error; that of a single run is 0.
    """
    runs, times = power.shape
    chex.assert_shape(power, (runs, times))
    value = root_mean(power, order).sum()
    others = (power.sum(0)[None] - power) / max(runs - 1, 1)  # means without a run
    without = root(jnp.maximum(others, 0), order).sum(1)
    spread = ((without - without.mean()) ** 2).sum()
    return Total(value, root(spread * (runs - 1) / runs, 2.0))
