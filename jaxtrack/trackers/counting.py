"""How a scan weighs an intensity beside a distribution of the number of targets.

The heart of `cphd`: of n targets, j are detected in any of the ways to pick j of the
detections (elementary symmetric functions) and the others are missed. The component's
own weight needs the same sums with one target, or one target and one detection, apart.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import counting
    >>> ways = counting.log_ways(size=3, most=1, apart=0, log_missed=jnp.log(0.5))
    >>> print(jnp.exp(ways).round(3))  # n = 0, 1, 2 targets; none or one detected
    [[1.   0.  ]
     [0.5  1.  ]
     [0.25 1.  ]]

Reference: Vo, Vo and Cantoni, "Analytic implementations of the cardinalized probability
hypothesis density filter", IEEE Trans. Signal Processing 55(7), 2007, Proposition 5.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import cardinality, mixture
from jaxtrack.trackers.intensity import Sighting, Update
from jaxtrack.types import Array


def correct(
    sighting: Sighting, log_cardinality: Array, clutter_rate: Array
) -> tuple[Update, Array]:
    """Weighs what a scan makes of an intensity and a number (Vo 2007, Proposition 5).

    Clutter is Poisson, so its terms are the same for every way to explain the scan and
    a ratio of each detection's density to clutter's is all that counts.
    """
    num_detections = sighting.log_clutter.size
    log_share = mixture.log_normalise(sighting.log_weight)
    log_share = jnp.where(sighting.log_weight > -jnp.inf, log_share, -jnp.inf)
    log_ratio = sighting.log_score - sighting.log_clutter[None]
    log_claim = log_share[:, None] + log_ratio  # [N, K]
    log_detected = mixture.total(log_claim)  # [K], of any one target
    log_missed = mixture.total(log_share + sighting.log_miss)

    # ways[u][n, j]: of n targets, u are set apart, j detected and the rest missed
    ways = [
        log_ways(log_cardinality.size, num_detections, u, log_missed) for u in (0, 1)
    ]
    log_sums = cardinality.symmetric(log_detected, ways[0].shape[1] - 1)
    by_number = jax.vmap(mixture.total)(ways[0] + log_sums[None])
    log_joint = log_cardinality + by_number
    log_evidence = mixture.total(log_joint)

    log_given = [mixture.total(log_cardinality[:, None] + way) for way in ways]
    log_apart = mixture.total(log_given[1] + log_sums)
    # What is left if clutter explains detection k, or the target that is set apart.
    log_false, log_without = jax.vmap(cardinality.leave_one_out, (None, 0))(
        log_detected, jnp.stack(log_given)
    )
    known = log_evidence > -jnp.inf
    scale = jnp.where(known, log_evidence, 0.0)
    update = Update(
        missed=sighting.missed,
        views=sighting.views,
        log_missed=log_share + sighting.log_miss + log_apart - scale,
        log_hit=log_claim + log_without[None] - scale,
        unexplained_prob=jnp.exp(jnp.minimum(log_false - scale, 0.0)),
        log_evidence=log_evidence + sighting.log_clutter.sum() - clutter_rate,
    )
    return update, mixture.log_normalise(log_joint)


def log_ways(size: int, most: int, apart: int, log_missed: Array) -> Array:
    """Returns log n! / (n - j - apart)! q^(n - j - apart), [size, most + 1]."""
    number = np.arange(size)[:, None]
    left = number - np.arange(min(most, size - 1) + 1)[None] - apart
    possible, left = left >= 0, np.maximum(left, 0)
    log_factorial = np.array([math.lgamma(n + 1) for n in range(size)])
    ordered = jnp.asarray(log_factorial[number] - log_factorial[left], log_missed.dtype)
    # Nobody left to be missed is sure even where no miss is possible.
    power = left * jnp.where(left > 0, log_missed, 0.0)
    return jnp.where(possible, ordered + power, -jnp.inf)
