"""Components that share detections, and how many targets each group of them holds.

What a sensor says about the number of all targets does not know where they are. Sensors
with different fields of view then contradict each other: to one a newborn target in
sight is one more, to the other, which sees only its own side, the number is as before,
and the product of both says that there is hardly a newborn. But detections speak of
places. Let components be in one group if they share a detection of any sensor, directly
or through others. With n targets, each drawn from the normalised intensity, and Poisson
clutter the density of all scans is, beside that of clutter,

    n! [x^n] prod_g sum_m (c_g x)^m / m! L_g(m)

with c_g the share of group g in the intensity and L_g(m) the density of its detections
given m targets in it: exact, since no detection belongs to two groups. The product form
is an approximation within a group only,

    L_g(m) = prod_s L_gs(m) theta_g^m

L_gs that of sensor s alone, and theta_g what the sensors' normalised pseudo-likelihoods
have in common there: the integral of their product over the group's normalised
intensity. With one group this is Mahler's form, p0 prod_s (p_s / p0) theta^n.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import several_groups
    >>> prior = jnp.log(jnp.array([0.25, 0.5, 0.25]))
    >>> share = jnp.log(jnp.array([0.5, 0.5]))
    >>> sure = jnp.array([[0.0, 5.0, 5.0], [0.0, 0.0, 0.0]])  # a target in the first
    >>> number, expected = several_groups.join(prior, share, sure, jnp.zeros(2))
    >>> print(expected.round(2))
    [1.13 0.29]

Reference: see `several_intensity`; the groups are not in Mahler's paper.
"""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import cardinality, mixture
from jaxtrack.assign import clusters
from jaxtrack.trackers import counting
from jaxtrack.trackers.intensity import Sighting
from jaxtrack.types import Array

LINKED = 1e-12  # share of a detection from which on a component has a say in it


def groups(sightings: Sequence[Sighting]) -> Array:
    """Returns the first component of each component's group, [N] (int).

    Args:
        sightings: Of each sensor, of the same N components.
    """
    linked = []
    for seen in sightings:
        claim = seen.log_weight[:, None] + seen.log_score
        every = jnp.concatenate([claim, seen.log_clutter[None]])
        log_total = mixture.total(every)
        linked.append(claim > log_total[None] + math.log(LINKED))
    return clusters.label(jnp.concatenate(linked, 1)[..., None])[:, 0]


def totals(log_weight: Array, group: Array, size: int) -> Array:
    """Returns the log of the summed weight of each of G groups, [G].

    Args:
        log_weight: [N].
        group: Of each, [N] (int).
        size: G.
    """
    own = group[None] == jnp.arange(size)[:, None]
    return jax.vmap(mixture.total)(jnp.where(own, log_weight[None], -jnp.inf))


def explain(sighting: Sighting, group: Array, size: int) -> Array:
    """Returns how well 0, 1, ... targets of each group explain a scan, [N, C].

    Args:
        sighting: Of N components.
        group: Of each component, [N] (int).
        size: C.

    Returns:
        Log-densities beside that of clutter; a group is called by its first component.
    """
    num, num_detections = sighting.log_score.shape
    log_ratio = sighting.log_score - sighting.log_clutter[None]

    def one(number: Array) -> Array:
        log_weight = jnp.where(group == number, sighting.log_weight, -jnp.inf)
        log_share = mixture.log_normalise(log_weight)
        log_share = jnp.where(log_weight > -jnp.inf, log_share, -jnp.inf)
        log_detected = mixture.total(log_share[:, None] + log_ratio)
        log_missed = mixture.total(log_share + sighting.log_miss)
        some = log_missed > -jnp.inf
        log_missed = jnp.where(some, log_missed, 0.0)
        ways = counting.log_ways(size, num_detections, 0, log_missed)
        log_sums = cardinality.symmetric(log_detected, ways.shape[1] - 1)
        return jax.vmap(mixture.total)(ways + log_sums[None])

    return jax.vmap(one)(jnp.arange(num))


def join(
    log_number: Array, log_share: Array, log_explained: Array, log_theta: Array
) -> tuple[Array, Array]:
    """Finds how many targets there are in all, and in each of G groups.

    Args:
        log_number: Log-probabilities before, [C].
        log_share: Of each group in the intensity, [G]; -inf for none.
        log_explained: How well 0, 1, ... targets explain all scans, [G, C].
        log_theta: What the sensors have in common, [G].

    Returns:
        Log-probability of each number, times the density of all scans beside that of
        clutter, [C]; and the expected number in each group, [G].
    """
    (size,) = log_number.shape
    number = jnp.arange(size, dtype=log_number.dtype)
    some = log_share > -jnp.inf
    log_scale = jnp.where(some, log_share, 0.0) + log_theta
    log_factorial = np.array([math.lgamma(n + 1) for n in range(size)])
    log_factorial = jnp.asarray(log_factorial, log_number.dtype)
    log_ways = log_explained - log_factorial[None] + number[None] * log_scale[:, None]
    possible = some[:, None] | (number == 0)[None]
    log_ways = jnp.where(possible, log_ways, -jnp.inf)

    def joint(log_more: Array) -> tuple[Array, Array]:
        """Returns what is wanted if each group's targets count more."""
        each = log_ways + number[None] * log_more[:, None]
        nothing = jnp.where(number == 0, 0.0, -jnp.inf)

        def grow(log_sums: Array, one: Array) -> tuple[Array, None]:
            return cardinality.convolve(log_sums, one), None

        log_all, _ = jax.lax.scan(grow, nothing, each)
        log_joint = log_number + log_factorial + log_all
        return mixture.total(log_joint), log_joint

    expected, log_joint = jax.grad(joint, has_aux=True)(jnp.zeros_like(log_share))
    return log_joint, expected
