"""The cardinalized PHD filter, for any target.

Beside the intensity of `phd` it keeps the probabilities of every number of targets, so
that a scan with too few detections makes targets unlikely everywhere and a certain
number stays certain. One scan is that of `phd`, where the weights of missed and of
corrected components depend on how many targets and detections there are in all. Targets
are reported by count, at the heaviest components: as many as are likeliest, or as there
are with more than a given probability. A new target among n old ones is believed later
than by `phd`, since any of the n + 1 might as well be anywhere.

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
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import cardinality
from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.trackers import (
    clustering,
    counting,
    extraction,
    intensity,
    reduction,
)
from jaxtrack.trackers.intensity import Components, Params, Update
from jaxtrack.types import Array, Scan, Target, Tracker

__all__ = ["Estimate", "Params", "State", "cphd", "update"]


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
        existence_prob: Expected number of targets in the slot, or 1 if more, [N].
        mode_prob: [N, M].
        effective_size: How many equally weighted particles each belief is worth; 0
            where it is no sample, [N].
        num_mean: Expected number of targets.
        num_var: Variance of the number of targets.
        log_evidence: Log-density of the scan given the past.
        dropped: Expected number of targets that the capacities threw away, and the
            probability that there are more than `max_targets`.
        cardinality_prob: Probability of every number of targets, [max_targets + 1].
    """

    mean: Array
    cov: Array
    label: Array
    exists: Array
    existence_prob: Array
    mode_prob: Array
    effective_size: Array
    num_mean: Array
    num_var: Array
    log_evidence: Array
    dropped: Array
    cardinality_prob: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    size: reduction.Reduction
    max_targets: int
    max_births: int
    report_threshold: float | None
    extract: clustering.Extract


@functools.cache
def cphd(
    target: Target,
    max_components: int = 30,
    max_targets: int = 20,
    max_births: int = 16,
    max_updated: int | None = None,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 4.0,
    report_threshold: float | None = None,
    partition: reduction.Partition = "pairs",
    max_parents: int = 8,
    extract: clustering.Extract = "components",
    max_scored: int | None = None,
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
        report_threshold: As many targets are reported as there are with more than this
            probability, 0.5 for the median; by default as many as are likeliest.
        partition: "pairs" or "detections", see `phd`.
        max_parents: Components that may share in one, where they merge or where it is
            made of all that a detection corrects.
        extract: "components", the heaviest; or "clusters" by k-means of all particles.
        max_scored: See `phd`.

    Raises:
        ValueError: A setting that makes no sense.
    """
    size = reduction.make(
        max_components,
        max_updated,
        prune_threshold,
        merge_threshold,
        partition,
        max_parents,
        max_scored,
    )
    reduction.check_births(max_births)
    if max_targets < 1:
        raise ValueError(f"max_targets is {max_targets}; give at least 1")
    if report_threshold is not None and not 0 <= report_threshold < 1:
        raise ValueError(
            f"report_threshold is {report_threshold}; give a probability from 0 up to "
            "1, e.g. 0.5, or None"
        )
    clustering.check(extract)
    settings = Settings(
        target, size, max_targets, max_births, report_threshold, extract
    )
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
        components, label = intensity.add_births(
            target, params.target, components, params.birth, label, birth_key
        )
        log_number, excess = add_newborn(log_number, params.birth)

    posterior, log_number = update(
        target, params, components, log_number, scan, size.max_scored
    )
    components, dropped = reduction.reduce(
        size, target, params.target, components.label, posterior, scan
    )
    told = cardinality.variance(log_number), posterior.log_evidence, dropped
    components, estimate, label = _report(
        settings, params, components, log_number, told, label
    )

    following = components
    if isinstance(params.birth, DetectionBirth):
        births, lost = intensity.propose(
            params.birth, params.target, posterior, scan, settings.max_births
        )
        following, label = intensity.add_births(
            target, params.target, components, births, label, birth_key
        )
        log_number, excess = add_newborn(log_number, births)
        dropped = dropped + lost
    estimate = estimate._replace(dropped=dropped + excess)
    return State(following, log_number, label, key), estimate


def _report(
    settings: Settings,
    params: Params,
    components: Components,
    log_number: Array,
    told: tuple[Array, Array, Array],
    label: Array,
) -> tuple[Components, Estimate, Array]:
    """Reports as many as are counted; the components may be renamed."""
    components = intensity.scaled(components, cardinality.mean(log_number))
    count = count_reported(log_number, settings.report_threshold)
    components, estimate, label = clustering.read(
        settings.extract,
        settings.target,
        params.target,
        components,
        extraction.heaviest(components, count),
        count,
        told,
        label,
    )
    counted = Estimate(*estimate, cardinality_prob=jnp.exp(log_number))
    return components, counted, label


def count_reported(log_number: Array, threshold: float | None) -> Array:
    """Returns how many targets to report."""
    if threshold is None:
        return cardinality.likeliest(log_number)
    more = 1 - jnp.cumsum(jnp.exp(log_number))[:-1]  # than 0, 1, ..., max_targets - 1
    return (more > threshold).sum()


def add_newborn(
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
    max_scored: int | None = None,
) -> tuple[Update, Array]:
    """Conditions an intensity and a number of targets on a scan; reduces nothing.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        components: N, predicted, with the newborn; their shares count, not their sum.
        log_cardinality: Log-probability of every number of targets, [C].
        scan: K detections.
        max_scored: See `gate.scores`.

    Returns:
        N missed and N x K corrected components as weights, and the new [C].
    """
    sighting = intensity.see(target, params, components, scan, max_scored)
    return counting.correct(sighting, log_cardinality, params.clutter.rate)
