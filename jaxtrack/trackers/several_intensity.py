"""An intensity, and a number of targets, seen by several sensors.

Both forms go from sensor to sensor and reduce each time; they differ in the weights. A
scan multiplies an intensity by a pseudo-likelihood, here for one sensor

    a (1 - P_D(x)) + sum over k of b_k P_D(x) g(z_k | x)

In the iterated form the factors a and b_k are worked out from what the sensors before
have left, in the product form from the prediction. Then the number of targets is

    p(n) proportional to p0(n) prod_s (p_s(n) / p0(n)) theta^n

p0 before, p_s after sensor s alone, and theta what the normalised pseudo-likelihoods of
all sensors have in common: the integral of their product over the normalised intensity.
The intensity is scaled to the mean of this. For the PHD filter p0 is Poisson and p_s a
Poisson number of missed targets and one Bernoulli number for each detection.

Both are exact for one target at most (a number that is 0 or 1), whatever the sensors.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import cardinality
    >>> from jaxtrack.trackers import several_intensity
    >>> prior = jnp.log(jnp.array([0.5, 0.5]))
    >>> seen = jnp.log(jnp.array([0.2, 0.8]))  # by each of two sensors alone
    >>> together = several_intensity.agree(prior, [seen, seen], jnp.log(1.0))
    >>> print(jnp.exp(together - together[1]).round(4))  # odds of 4, times 4
    [0.0625 1.    ]

References: Mahler, "Approximate multisensor CPHD and PHD filters", Fusion 2010;
iterated-corrector: Mahler, "Multitarget Bayes filtering via first-order multitarget
moments", IEEE Trans. Aerospace and Electronic Systems 39(4), 2003.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack import cardinality, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import intensity, phd, reduction
from jaxtrack.trackers.intensity import Components, Params, Sighting, Update
from jaxtrack.types import Array, Scan, Target

# (sighting, log_number, clutter_rate) -> (update, log_number), as `counting.correct`.
Weigh = Callable[[Sighting, Array, Array], tuple[Update, Array]]


class Taught(NamedTuple):
    """What several scans make of an intensity.

    Attributes:
        components: Reduced.
        log_number: Log-probability of every number of targets, [C].
        log_evidence: Log-density of all scans.
        unexplained_prob: That no known target caused a detection, [K] for each sensor.
        dropped: Expected number of targets that the capacities threw away.
    """

    components: Components
    log_number: Array
    log_evidence: Array
    unexplained_prob: tuple[Array, ...]
    dropped: Array


def poisson(
    sighting: Sighting, log_number: Array, clutter_rate: Array
) -> tuple[Update, Array]:
    """Weighs as `phd.correct`; the number after the scan is no longer Poisson.

    Args:
        sighting: A scan as N components see it.
        log_number: Poisson, [C]; says how many numbers are wanted.
        clutter_rate: Expected number of false detections.
    """
    update = phd.correct(sighting, clutter_rate)
    missed = cardinality.poisson(jnp.exp(update.log_missed).sum(), log_number.size)
    hits = cardinality.bernoullis(
        jnp.clip(1 - update.unexplained_prob, 0.0, 1.0), log_number.size
    )
    return update, cardinality.add(missed, hits)[0]


def iterated(
    weigh: Weigh,
    size: reduction.Reduction,
    target: Target,
    each: Sequence[tuple[Params, Scan]],
    components: Components,
    log_number: Array,
) -> Taught:
    """Updates by one sensor after another.

    Args:
        weigh: `counting.correct` or `poisson`.
        size: How many components to keep.
        target: How one target is filtered.
        each: Parameters and scan of each sensor, see `several.split`.
        components: N, predicted, with the newborn.
        log_number: Of every number of targets, [C].
    """
    log_evidence, dropped, unexplained = jnp.zeros(()), jnp.zeros(()), []
    for params, scan in each:
        sighting = intensity.see(target, params, components, scan, size.max_scored)
        update, log_number = weigh(sighting, log_number, params.clutter.rate)
        components, lost = reduction.reduce(
            size, target, params.target, components.label, update, scan
        )
        log_evidence, dropped = log_evidence + update.log_evidence, dropped + lost
        unexplained.append(update.unexplained_prob)
    return Taught(components, log_number, log_evidence, tuple(unexplained), dropped)


def product(
    weigh: Weigh,
    size: reduction.Reduction,
    target: Target,
    each: Sequence[tuple[Params, Scan]],
    components: Components,
    log_number: Array,
) -> Taught:
    """Multiplies what all sensors say of the prediction; arguments as in `iterated`."""
    log_before = mixture.total(components.log_weight)
    running, log_total, log_theta = components, log_before, jnp.zeros(())
    lost, alone = jnp.zeros(()), []
    for params, scan in each:
        sighting = intensity.see(target, params, components, scan, size.max_scored)
        said, number = weigh(sighting, log_number, params.clutter.rate)
        alone.append((said, number))
        seen = intensity.see(target, params, running, scan, size.max_scored)
        update = _apply(seen, *factors(sighting, said), said)
        growth = _gap(_total(update), mixture.total(running.log_weight))
        log_total = log_total + growth
        log_theta = log_theta + growth - _gap(_total(said), log_before)
        running, gone = reduction.reduce(
            size, target, params.target, running.label, update, scan
        )
        lost = lost + gone * jnp.exp(-_finite(_total(update)))

    log_joint = agree(log_number, [number for _, number in alone], log_theta)
    posterior = mixture.log_normalise(log_joint)
    expected = cardinality.mean(posterior)
    scale = safe_log(expected) - _finite(log_total)
    scaled = running._replace(log_weight=running.log_weight + scale)
    evidence = jnp.stack([said.log_evidence for said, _ in alone]).sum()
    return Taught(
        components=scaled,
        log_number=posterior,
        log_evidence=evidence + mixture.total(log_joint),
        unexplained_prob=tuple(said.unexplained_prob for said, _ in alone),
        dropped=lost * expected,
    )


def factors(sighting: Sighting, update: Update) -> tuple[Array, Array]:
    """Returns by what a scan multiplies the missed, and the hits of each detection.

    Args:
        sighting: A scan as N components see it.
        update: What it made of their weights.

    Returns:
        log a, a scalar, and log b [K] of the module's docstring; both are the same for
        all components, so the heaviest of each tells.
    """
    missed = sighting.log_weight + sighting.log_miss
    claim = sighting.log_weight[:, None] + sighting.log_score
    first, best = jnp.argmax(missed), jnp.argmax(claim, 0)
    at = jnp.arange(best.size)
    return (
        _gap(update.log_missed[first], missed[first]),
        _gap(update.log_hit[best, at], claim[best, at]),
    )


def agree(log_prior: Array, log_posteriors: Sequence[Array], log_theta: Array) -> Array:
    """Multiplies what sensors say about the number of targets.

    Args:
        log_prior: Log-probabilities before, [C].
        log_posteriors: After each sensor alone, [C] each.
        log_theta: How much better one target explains all scans together than the
            normalised pseudo-likelihoods do one by one.

    Returns:
        Logarithms [C]; the sum is the density of all scans, in units of the product of
        their densities alone.
    """
    possible = log_prior > -jnp.inf
    prior = jnp.where(possible, log_prior, 0.0)
    joint = prior + log_theta * jnp.arange(log_prior.size)
    for log_posterior in log_posteriors:
        joint = joint + log_posterior - prior
    return jnp.where(possible, joint, -jnp.inf)


def _apply(seen: Sighting, log_miss: Array, log_hit: Array, said: Update) -> Update:
    """Multiplies what a sensor says into the intensity that others have changed."""
    return said._replace(
        missed=seen.missed,
        views=seen.views,
        log_missed=seen.log_weight + seen.log_miss + log_miss,
        log_hit=seen.log_weight[:, None] + seen.log_score + log_hit[None],
    )


def _total(update: Update) -> Array:
    return mixture.total(jnp.append(update.log_missed, update.log_hit))


def _gap(after: Array, before: Array) -> Array:
    """Returns after - before; 0 where either is empty."""
    known = (after > -jnp.inf) & (before > -jnp.inf)
    return jnp.where(known, after, 0.0) - jnp.where(known, before, 0.0)


def _finite(log_total: Array) -> Array:
    return jnp.where(log_total > -jnp.inf, log_total, 0.0)
