"""When a target was born that was detected later: how likely each scan is.

With Poisson births a target may have been there for some scans before one of them
detects it. Each component of the intensity of undetected targets carries the
distribution of the time since its targets were born; the first detection mixes those
of the components by what it says of each. From then on there is one belief about the
target, so that later detections no longer change it, as they would where components
differ in what they expect of them: an approximation there.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import birth_times
    >>> born = birth_times.newborn(2, 3)  # of two components, in three numbers each
    >>> old = birth_times.older(born)
    >>> print(old[0])
    [0. 1. 0.]
    >>> both = jnp.stack([old[0], born[0]])
    >>> log_weight = jnp.log(jnp.array([[3.0], [1.0]]))
    >>> print(birth_times.detected(log_weight, both).round(2))
    [[0.25 0.75 0.  ]]

Reference: Granstrom, Svensson, Xia, Williams and Garcia-Fernandez, "Poisson multi-
Bernoulli mixture trackers: continuity through random finite sets of trajectories", Int.
Conf. Information Fusion, 2018 (their trajectories begin at birth).
"""

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.types import Array


def newborn(size: int, num: int) -> Array | None:
    """Returns that targets were born in the scan, [size, num]; None if num is 0.

    Args:
        size: Of how many components.
        num: A, numbers of scans that are told apart: 0, 1, ..., A - 1 or more.
    """
    if num == 0:
        return None
    return jnp.zeros((size, num)).at[:, 0].set(1.0)


def number(born: Array | None) -> int:
    """Returns A, how many numbers of scans are told apart; 0 for none."""
    return 0 if born is None else born.shape[1]


def older(born: Array | None) -> Array | None:
    """Returns the same a scan later.

    Args:
        born: How likely each was born so many scans ago, [U, A], or None.
    """
    if born is None:
        return None
    later = jnp.pad(born[:, :-1], ((0, 0), (1, 0)))
    return later.at[:, -1].add(born[:, -1])


def detected(log_weight: Array, born: Array | None) -> Array | None:
    """Returns when targets were born that are detected for the first time, [K, A].

    Args:
        log_weight: Of each component with each detection, [U, K].
        born: How likely each was born so many scans ago, [U, A], or None.
    """
    if born is None:
        return None
    share = jnp.exp(jax.vmap(mixture.log_normalise, 1)(log_weight))  # [K, U]
    return (share[:, :, None] * born[None]).sum(1)


def added(born: Array | None, first: Array | None, detection: Array) -> Array | None:
    """Adds those of new trees to those of old ones, [N + K', A].

    Args:
        born: How likely each was born so many scans before, [N, A], or None.
        first: Of each detection of the scan, [K, A], or None.
        detection: Which of them began the new trees, -1 for none, [K'] (int).
    """
    if born is None or first is None:
        return born
    return jnp.concatenate([born, first[jnp.maximum(detection, 0)]])
