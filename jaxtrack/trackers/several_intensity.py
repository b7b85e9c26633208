"""An intensity, and a number of targets, seen by several sensors.

Both forms go from sensor to sensor and reduce each time; they differ in the weights. A
scan multiplies an intensity by a pseudo-likelihood, here for one sensor

    a (1 - P_D(x)) + sum over k of b_k P_D(x) g(z_k | x)

In the iterated form the factors a and b_k are worked out from what the sensors before
have left, in the product form from the prediction. Their ratio says where in a group of
components that share detections the targets are; how many there are in each group, and
in all, is worked out for all sensors together (`several_groups`), and each group is
scaled to its expected number. For the PHD filter the number before is Poisson.

Both are exact for one target at most (a number that is 0 or 1), whatever the sensors.

    >>> from jaxtrack.trackers import several_intensity
    >>> several_intensity.Taught._fields[:2]
    ('components', 'log_number')

References: Mahler, "Approximate multisensor CPHD and PHD filters", Fusion 2010;
iterated-corrector: Mahler, "Multitarget Bayes filtering via first-order multitarget
moments", IEEE Trans. Aerospace and Electronic Systems 39(4), 2003.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import cardinality, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import intensity, phd, reduction, several_groups
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
    num, number = components.log_weight.size, log_number.size
    sightings = [
        intensity.see(target, params, components, scan, size.max_scored)
        for params, scan in each
    ]
    group = several_groups.groups(sightings)
    log_before = several_groups.totals(components.log_weight, group, num)
    # For the time being a component is called by where it comes from.
    running = components._replace(label=jnp.arange(num))
    log_theta, lost, alone = jnp.zeros(num), jnp.zeros(()), []
    log_explained = jnp.zeros((num, number))
    for (params, scan), sighting in zip(each, sightings, strict=True):
        said, _ = weigh(sighting, log_number, params.clutter.rate)
        alone.append(said)
        seen = intensity.see(target, params, running, scan, size.max_scored)
        update = _apply(seen, *factors(sighting, said), said)
        log_theta = log_theta + _growth(update, running, group[running.label], num)
        log_theta = log_theta - _growth(said, components, group, num)
        log_explained += several_groups.explain(sighting, group, number)
        running, gone = reduction.reduce(
            size, target, params.target, running.label, update, scan
        )
        lost = lost + gone * jnp.exp(-_finite(_total(update)))

    log_share = log_before - _finite(mixture.total(log_before))
    log_joint, expected = several_groups.join(
        log_number, log_share, log_explained, log_theta
    )
    clutter = [
        sighting.log_clutter.sum() - params.clutter.rate
        for (params, _), sighting in zip(each, sightings, strict=True)
    ]
    return Taught(
        components=_scaled(running, components.label, group, expected),
        log_number=mixture.log_normalise(log_joint),
        log_evidence=jnp.stack(clutter).sum() + mixture.total(log_joint),
        unexplained_prob=tuple(said.unexplained_prob for said in alone),
        dropped=lost * expected.sum(),
    )


def _growth(update: Update, components: Components, group: Array, size: int) -> Array:
    """Returns the log of what an update multiplies each group's weight by, [G]."""
    every = jnp.concatenate([update.log_missed[:, None], update.log_hit], 1)
    after = jax.vmap(mixture.total)(every)
    both = after, components.log_weight
    return _gap(*(several_groups.totals(x, group, size) for x in both))


def _scaled(
    components: Components, label: Array, group: Array, expected: Array
) -> Components:
    """Gives each group its expected number of targets, and components their labels."""
    ancestor = components.label
    own = group[ancestor]
    log_total = several_groups.totals(components.log_weight, own, group.size)
    scale = safe_log(expected) - _finite(log_total)
    return components._replace(
        log_weight=components.log_weight + scale[own], label=label[ancestor]
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
