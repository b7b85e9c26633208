"""The probability hypothesis density filter, for any target.

What is known of all targets is their intensity: how many to expect where. One scan is

    intensity = predict(intensity) + births         # some die, new ones appear
    missed:   each component, as likely as a miss
    detected: each detection shares one target, or clutter, among all components
    reduce the components, report those that stand for more than half a target

`phd(target=single())` is the GM-PHD filter (EK and UK by the target's method),
`phd(target=mixture(...))` with several modes the GM-MM-PHD filter, `phd(target=imm())`
keeps one Gaussian a mode in each component, `phd(target=particles(...))` is the SMC
form. The intensity assumes that the number of targets is Poisson: its spread is the
root of its mean, and one missed detection takes away nearly all of a target's weight.

With `partition="pairs"` each component and detection make one of their own, as in the
Gaussian mixture papers; with "detections" all that one detection corrects becomes one
component (`Target.absorb`), which needs no clustering: for particles.

The log-evidence of a scan is exact if the targets before it were a Poisson process with
this intensity, and it is what the update divides by.

    >>> from jaxtrack import targets, trackers
    >>> trackers.phd.phd(targets.single.single(), max_components=30)._fields
    ('init', 'step')

References: Mahler 2003 and Vo and Ma 2006, see `intensity`; Pasha, Vo, Tuan and Ma, "A
Gaussian mixture PHD filter for jump Markov system models", IEEE Trans. Aerospace and
Electronic Systems 45(3), 2009; Ristic, Clark and Vo, "Improved SMC implementation of
the PHD filter", Fusion 2010 (components by detection).
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.models.birth import DetectionBirth
from jaxtrack.trackers import clustering, extraction, intensity, reduction
from jaxtrack.trackers.bernoulli import Estimate
from jaxtrack.trackers.intensity import Components, Params, Sighting, Update
from jaxtrack.types import Array, Scan, Target, Tracker

__all__ = ["Estimate", "Params", "State", "correct", "phd", "update"]


class State(NamedTuple):
    """What the next scan needs: the intensity, the next free label, a random key."""

    components: Components
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    size: reduction.Reduction
    max_births: int
    report_threshold: float
    extract: clustering.Extract


@functools.cache
def phd(
    target: Target,
    max_components: int = 30,
    max_births: int = 16,
    max_updated: int | None = None,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 4.0,
    report_threshold: float = 0.5,
    partition: reduction.Partition = "pairs",
    max_parents: int = 8,
    extract: clustering.Extract = "components",
    max_scored: int | None = None,
) -> Tracker:
    """Makes a PHD filter.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_components: Components kept after a scan; the lightest go first.
        max_births: Newborn components of `DetectionBirth` kept after a scan.
        max_updated: Corrected components worked out, the heaviest; by default
            `max_components`.
        prune_threshold: Components of smaller weight go.
        merge_threshold: Squared Mahalanobis distance within which components merge.
        report_threshold: A component that stands for more targets is reported, and for
            each further target once more, three times at most.
        partition: "pairs" or "detections": what makes a corrected component.
        max_parents: Components that may share in one, where they merge or where it is
            made of all that a detection corrects.
        extract: "components", which are reported by their weight; or "clusters", as
            many as the expected number rounded, by k-means of all particles.
        max_scored: Detections that each component scores in full, see `gate.scores`;
            for particles among much clutter.

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
    extraction.check(report_threshold)
    clustering.check(extract)
    settings = Settings(target, size, max_births, report_threshold, extract)
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
    return State(nobody, jnp.zeros((), int), key)


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Predicts, adds births, updates, reduces and reports."""
    target, size = settings.target, settings.size
    key, birth_key = jax.random.split(state.key)
    components, label = state.components, state.next_label

    components, _ = intensity.predict(target, params.target, components, scan.interval)
    if not isinstance(params.birth, DetectionBirth):
        components, label = intensity.add_births(
            target, params.target, components, params.birth, label, birth_key
        )

    posterior = update(target, params, components, scan, size.max_scored)
    components, dropped = reduction.reduce(
        size, target, params.target, components.label, posterior, scan
    )
    num = components.expected
    components, estimate, label = clustering.read(
        settings.extract,
        target,
        params.target,
        components,
        extraction.above(components, settings.report_threshold),
        jnp.round(num),
        (num, posterior.log_evidence, dropped),  # a Poisson number's variance: its mean
        label,
    )

    following = components
    if isinstance(params.birth, DetectionBirth):
        births, lost = intensity.propose(
            params.birth, params.target, posterior, scan, settings.max_births
        )
        following, label = intensity.add_births(
            target, params.target, components, births, label, birth_key
        )
        estimate = estimate._replace(dropped=dropped + lost)
    return State(following, label, key), estimate


def update(
    target: Target,
    params: Params,
    components: Components,
    scan: Scan,
    max_scored: int | None = None,
) -> Update:
    """Conditions an intensity on a scan; reduces nothing.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        components: N, predicted, with the newborn.
        scan: K detections.
        max_scored: See `gate.scores`.

    Returns:
        N missed and N x K corrected components as weights.
    """
    sighting = intensity.see(target, params, components, scan, max_scored)
    return correct(sighting, params.clutter.rate)


def correct(sighting: Sighting, clutter_rate: Array) -> Update:
    """Weighs what a scan makes of an intensity (Vo and Ma 2006, Proposition 2)."""
    log_claim = sighting.log_weight[:, None] + sighting.log_score  # [N, K]
    every = jnp.concatenate([log_claim, sighting.log_clutter[None]])
    log_total = mixture.total(every)  # [K]
    log_missed = sighting.log_weight + sighting.log_miss
    expected_hits = jnp.exp(sighting.log_weight) - jnp.exp(log_missed)
    return Update(
        missed=sighting.missed,
        views=sighting.views,
        log_missed=log_missed,
        log_hit=log_claim - log_total[None],
        unexplained_prob=jnp.exp(sighting.log_clutter - log_total),
        log_evidence=log_total.sum() - clutter_rate - expected_hits.sum(),
    )
