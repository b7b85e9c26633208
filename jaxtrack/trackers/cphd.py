"""The cardinalized PHD filter, for any target.

Beside the intensity of `phd` it keeps the probabilities of every number of targets, so
that a scan with too few detections makes targets unlikely everywhere and a certain
number stays certain. One scan is that of `phd`, where the weights of missed and of
corrected components depend on how many targets and detections there are in all. The
targets are reported by count: as many as are likeliest, at the heaviest components.

A missed target loses its weight to the others, wherever they are (the "spooky effect"
of Franken, Schmidt and Ulmke 2009): the number is right, the place may not be.

The update of a scan and its log-evidence are exact if the targets before it were
independent and identically distributed, with this intensity and any distribution of
their number; that they are so again after the scan is the approximation.

    >>> from jaxtrack import targets, trackers
    >>> trackers.cphd.cphd(targets.single.single(), max_targets=20)._fields
    ('init', 'step')

References: Mahler, "PHD filters of higher order in target number", IEEE Trans.
Aerospace and Electronic Systems 43(4), 2007; Vo, Vo and Cantoni, "Analytic
implementations of the cardinalized probability hypothesis density filter", IEEE Trans.
Signal Processing 55(7), 2007; Georgescu and Willett, "The multiple model CPHD tracker",
IEEE Trans. Signal Processing 60(4), 2012.
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import cardinality, mixture
from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.trackers import bernoulli, extraction, intensity, reduction
from jaxtrack.trackers.intensity import Components, Params, Sighting, Update
from jaxtrack.types import Array, Scan, Target, Tracker

__all__ = ["Estimate", "Params", "State", "correct", "cphd", "update"]


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        components: The intensity.
        log_cardinality: Log-probability of every number of targets, [max_targets + 1].
        next_label: The next free label.
        key: Random key.
    """

    components: Components
    log_cardinality: Array
    next_label: Array
    key: Array


class Estimate(NamedTuple):
    """What a scan taught; the heaviest components come first.

    Attributes:
        mean: [N, D].
        cov: [N, D, D].
        label: Which target it is, [N] (int).
        exists: Report this one, [N] (bool).
        existence_prob: Expected number of targets in the slot, [N].
        mode_prob: [N, M].
        effective_size: How many equally weighted particles each belief is worth; 0
            where it is no sample, [N].
        num_var: Variance of the number of targets.
        log_evidence: Log-density of the scan given the past.
        dropped: Expected number of targets that the capacities threw away.
        log_cardinality: Log-probability of every number of targets, [max_targets + 1].
    """

    mean: Array
    cov: Array
    label: Array
    exists: Array
    existence_prob: Array
    mode_prob: Array
    effective_size: Array
    num_var: Array
    log_evidence: Array
    dropped: Array
    log_cardinality: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    size: reduction.Reduction
    max_targets: int
    max_births: int


@functools.cache
def cphd(
    target: Target,
    max_components: int = 30,
    max_targets: int = 20,
    max_births: int = 16,
    max_updated: int | None = None,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 4.0,
    partition: reduction.Partition = "pairs",
    max_parents: int = 8,
) -> Tracker:
    """Makes a CPHD filter.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_components: Components kept after a scan; the lightest go first.
        max_targets: Largest number of targets that is thought possible.
        max_births: Newborn components of `DetectionBirth` kept after a scan.
        max_updated: Corrected components worked out, the heaviest; by default
            `max_components`.
        prune_threshold: Components of smaller weight go.
        merge_threshold: Squared Mahalanobis distance within which components merge.
        partition: "pairs" or "detections", see `phd`.
        max_parents: Components that may share in one, where they merge or where it is
            made of all that a detection corrects.

    Raises:
        ValueError: A size, threshold or partition that makes no sense.
    """
    size = reduction.make(
        max_components,
        max_updated,
        prune_threshold,
        merge_threshold,
        partition,
        max_parents,
    )
    reduction.check_births(max_births)
    if max_targets < 1:
        raise ValueError(f"max_targets is {max_targets}; give at least 1")
    settings = Settings(target, size, max_targets, max_births)
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts without targets."""
    nobody = intensity.nobody(
        settings.target,
        params,
        settings.size.max_components,
        settings.max_births,
        key,
    )
    none = jnp.zeros(1, nobody.log_weight.dtype)
    log_cardinality = cardinality.bernoullis(none, settings.max_targets + 1)
    return State(nobody, log_cardinality, jnp.zeros((), int), key)


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Predicts, adds births, updates, reduces and reports."""
    target, size = settings.target, settings.size
    key, birth_key = jax.random.split(state.key)
    components, log_number, label = state[:3]

    components, survive_prob = intensity.predict(
        target, params.target, components, scan.interval
    )
    log_number, excess = cardinality.thin(log_number, survive_prob), 0.0
    if not isinstance(params.birth, DetectionBirth):
        born = intensity.begin(target, params.target, params.birth, label, birth_key)
        components, label = intensity.append(components, born), label + born.label.size
        log_number, excess = _add(log_number, params.birth)

    posterior, log_number = update(target, params, components, log_number, scan)
    components, dropped = reduction.reduce(
        size, target, params.target, components.label, posterior, scan
    )
    picked = extraction.heaviest(components, cardinality.likeliest(log_number))
    components, shown, label = extraction.tell_apart(components, picked, label)
    num_var = cardinality.variance(log_number)
    estimate = extraction.report(
        target, components, picked, shown, num_var, posterior.log_evidence, dropped
    )
    estimate = Estimate(*estimate, log_cardinality=log_number)

    following = components
    if isinstance(params.birth, DetectionBirth):
        births, lost = bernoulli.from_unexplained(
            params.birth,
            params.target,
            scan,
            posterior.unexplained_prob,
            settings.max_births,
        )
        born = intensity.begin(target, params.target, births, label, birth_key)
        following, label = intensity.append(components, born), label + born.label.size
        log_number, excess = _add(log_number, births)
        dropped = dropped + lost
    estimate = estimate._replace(dropped=dropped + excess)
    return State(following, log_number, label, key), estimate


def _add(
    log_number: Array, births: MultiBernoulliBirth | PoissonBirth
) -> tuple[Array, Array]:
    """Adds the number of newborn targets to the number of old ones."""
    if isinstance(births, PoissonBirth):
        born = cardinality.poisson(births.rate.sum(), log_number.size)
    else:
        born = cardinality.bernoullis(births.existence_prob, log_number.size)
    return cardinality.add(log_number, born)


def update(
    target: Target,
    params: Params,
    components: Components,
    log_cardinality: Array,
    scan: Scan,
) -> tuple[Update, Array]:
    """Conditions an intensity and a number of targets on a scan; reduces nothing.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        components: N, predicted, with the newborn; their shares count, not their sum.
        log_cardinality: Log-probability of every number of targets, [C].
        scan: K detections.

    Returns:
        N missed and N x K corrected components as weights, and the new [C].
    """
    sighting = intensity.see(target, params, components, scan)
    return correct(sighting, log_cardinality, params.clutter.rate)


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
    log_detected = jax.vmap(mixture.total, 1)(log_claim)  # [K], of any one target
    log_missed = mixture.total(log_share + sighting.log_miss)

    # log_ways[u][n, j]: of n targets, u are set apart, j detected and the rest missed
    log_ways = [
        _log_ways(log_cardinality.size, num_detections, u, log_missed) for u in (0, 1)
    ]
    log_sums = cardinality.symmetric(log_detected, log_ways[0].shape[1] - 1)
    by_number = jax.vmap(mixture.total)(log_ways[0] + log_sums[None])
    log_joint = log_cardinality + by_number
    log_evidence = mixture.total(log_joint)

    log_given = [
        jax.vmap(mixture.total, 1)(log_cardinality[:, None] + ways) for ways in log_ways
    ]
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


def _log_ways(size: int, most: int, apart: int, log_missed: Array) -> Array:
    """Returns log n! / (n - j - apart)! q^(n - j - apart), [size, most + 1]."""
    number = np.arange(size)[:, None]
    left = number - np.arange(min(most, size - 1) + 1)[None] - apart
    possible, left = left >= 0, np.maximum(left, 0)
    log_factorial = np.array([math.lgamma(n + 1) for n in range(size)])
    ordered = jnp.asarray(log_factorial[number] - log_factorial[left], log_missed.dtype)
    # Nobody left to be missed is sure even where no miss is possible.
    power = left * jnp.where(left > 0, log_missed, 0.0)
    return jnp.where(possible, ordered + power, -jnp.inf)
