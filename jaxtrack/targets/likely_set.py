"""Which modes are active: the likely model set, adapted once a scan.

An active mode is principal if its probability is above t2, unlikely if below t1. Modes
adjacent from a principal one join at once. Unlikely ones that are not adjacent from a
principal one are left out of the next scan, the least likely first.

A temperature above 0 makes the choices soft: sigmoids of the log-probability about the
log-thresholds, with activities between 0 and 1. As it falls the hard choices come back,
which have no slope in the thresholds.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.targets import likely_set
    >>> chain = jnp.eye(4) + jnp.eye(4, k=1) + jnp.eye(4, k=-1) > 0
    >>> prob = jnp.array([0.01, 0.09, 0.9, 0.0])
    >>> now, later = likely_set.adapt(
    ...     jnp.log(prob), jnp.log(prob > 0), chain,
    ...     unlikely_prob=jnp.array(0.1), principal_prob=jnp.array(0.5), min_modes=1)
    >>> print(jnp.exp(now), jnp.exp(later))
    [1. 1. 1. 1.] [0. 1. 1. 1.]

References: Gomes, "An overview on target tracking using multiple models methods", 2011,
Table 3; Li and Zhang, "Multiple-model estimation with variable structure, part V:
likely-model set algorithm", IEEE Trans. Aerospace and Electronic Systems 36(2), 2000.
"""

import jax
import jax.numpy as jnp

from jaxtrack.linalg import safe_log
from jaxtrack.types import Array


def adapt(
    log_prob: Array,
    log_active: Array,
    adjacent: Array,
    unlikely_prob: Array,
    principal_prob: Array,
    min_modes: int,
    temperature: float = 0.0,
) -> tuple[Array, Array]:
    """Chooses the modes that count, now that all of a scan is known, and in the next.

    Args:
        log_prob: Of each mode after the scan, -inf where it is not active, [M].
        log_active: 0 for the modes that were active in the scan and -inf for the
            others, or the log of an activity in between, [M].
        adjacent: Whether mode j may follow mode i, [i, j] (bool).
        unlikely_prob: t1, a scalar.
        principal_prob: t2, a scalar.
        min_modes: So many stay active at least, however unlikely.
        temperature: Width of the soft choices in log-probability; 0 makes them hard.

    Returns:
        The activity of each mode in this scan, those that join counted, and in the
        next one; in the form of `log_active`, [M].
    """
    active = jnp.exp(log_active)
    principal = active * _above(log_prob, safe_log(principal_prob), temperature)
    unlikely = _above(safe_log(unlikely_prob), log_prob, temperature)
    apart = jnp.prod(1 - principal[:, None] * adjacent, 0)  # from all principal modes
    joined = 1 - apart
    union = joined + active * apart

    order = jnp.arange(active.size)
    tie = (log_prob[:, None] == log_prob[None]) & (order[:, None] < order[None])
    before = tie | (log_prob[:, None] < log_prob[None])
    discarded = active * unlikely * apart
    room = union.sum() - min_modes - (discarded[:, None] * before).sum(0)
    goes = unlikely * jnp.clip(room, 0.0, 1.0)
    return safe_log(union), safe_log(joined + active * apart * (1 - goes))


def _above(high: Array, low: Array, temperature: float) -> Array:
    """Returns how far one log-probability is above another, from 0 to 1.

    What is -inf is certainly below what is not, and has no slope.
    """
    above = (high > low).astype(jnp.result_type(high, low))
    if not temperature:
        return above
    possible = (high > -jnp.inf) & (low > -jnp.inf)
    gap = jnp.where(possible, high, 0.0) - jnp.where(possible, low, 0.0)
    return jnp.where(possible, jax.nn.sigmoid(gap / temperature), above)
