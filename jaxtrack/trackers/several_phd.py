"""PHD and CPHD filters with several sensors, for any target.

    >>> from jaxtrack import targets, trackers
    >>> make = trackers.several_phd.several_cphd
    >>> make(targets.single.single(), form="product", max_targets=10)._fields
    ('init', 'step')

References: see `several_intensity`.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import cardinality
from jaxtrack.models.birth import DetectionBirth
from jaxtrack.trackers import (
    bernoulli,
    counting,
    cphd,
    extraction,
    intensity,
    reduction,
    several,
    several_intensity,
)
from jaxtrack.trackers.cphd import State
from jaxtrack.trackers.several import Form, Params
from jaxtrack.trackers.several_intensity import Taught
from jaxtrack.types import Array, Scans, Target, Tracker

COUNTED = 40  # numbers of targets that the product form of the PHD filter considers


class Settings(NamedTuple):
    """The makers' arguments; a PHD filter has no say in the number of targets."""

    target: Target
    form: Form
    size: reduction.Reduction
    counts: bool
    max_targets: int
    max_births: int
    report_threshold: float | None


@functools.cache
def several_phd(
    target: Target,
    form: Form = "iterated",
    max_components: int = 30,
    max_births: int = 16,
    report_threshold: float = 0.5,
    max_targets: int = COUNTED,
    **sizes: Any,
) -> Tracker:
    """Makes a PHD filter with several sensors.

    Its `Params` are those of `several`, its scans `types.Scans`.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        form: "iterated" or "product", see `several`.
        max_components: Components kept after each sensor; the lightest go first.
        max_births: Newborn components of `DetectionBirth` kept after a scan.
        report_threshold: A component that stands for more targets is reported.
        max_targets: Largest number of targets that the product form thinks possible.
        **sizes: Further settings of `phd.phd`: max_updated, prune_threshold,
            merge_threshold, partition and max_parents.

    Raises:
        ValueError: A size, threshold or form that makes no sense.
    """
    size = reduction.make(max_components, **sizes)
    extraction.check(report_threshold)
    return _make(
        Settings(target, form, size, False, max_targets, max_births, report_threshold)
    )


@functools.cache
def several_cphd(
    target: Target,
    form: Form = "iterated",
    max_components: int = 30,
    max_targets: int = 20,
    max_births: int = 16,
    report_threshold: float | None = None,
    **sizes: Any,
) -> Tracker:
    """Makes a CPHD filter with several sensors.

    Its `Params` are those of `several`, its scans `types.Scans`.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        form: "iterated" or "product", see `several`.
        max_components: Components kept after each sensor; the lightest go first.
        max_targets: Largest number of targets that is thought possible.
        max_births: Newborn components of `DetectionBirth` kept after a scan.
        report_threshold: As in `cphd.cphd`.
        **sizes: Further settings of `cphd.cphd`: max_updated, prune_threshold,
            merge_threshold, partition and max_parents.

    Raises:
        ValueError: A size, threshold or form that makes no sense.
    """
    size = reduction.make(max_components, **sizes)
    if report_threshold is not None:
        extraction.check(report_threshold)
    return _make(
        Settings(target, form, size, True, max_targets, max_births, report_threshold)
    )


def _make(settings: Settings) -> Tracker:
    several.check(settings.form)
    reduction.check_births(settings.max_births)
    if settings.max_targets < 1:
        raise ValueError(f"max_targets is {settings.max_targets}; give at least 1")
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts without targets."""
    sizes = {"max_components": settings.size.max_components}
    sizes |= {"max_births": settings.max_births, "max_targets": settings.max_targets}
    one = intensity.Params(params.target, params.birth, None)
    return cphd.cphd(settings.target, **sizes).init(one, key)


def _step(
    settings: Settings, params: Params, state: State, scans: Scans
) -> tuple[State, bernoulli.Estimate | cphd.Estimate]:
    """Predicts, adds births, updates by each sensor and reports."""
    target = settings.target
    key, birth_key = jax.random.split(state.key)
    each = several.split(params, scans)
    components, log_number, label = state[:3]

    components, survive_prob = intensity.predict(
        target, params.target, components, scans.each[0].interval
    )
    log_number, excess = cardinality.thin(log_number, survive_prob), 0.0
    if not isinstance(params.birth, DetectionBirth):
        components, label = intensity.add_births(
            target, params.target, components, params.birth, label, birth_key
        )
        log_number, excess = cphd.add_newborn(log_number, params.birth)

    if settings.counts:
        weigh = counting.correct
    else:
        weigh, excess = several_intensity.poisson, 0.0
        log_number = cardinality.poisson(components.expected, log_number.size)
    update = getattr(several_intensity, settings.form)
    taught = update(weigh, settings.size, target, each, components, log_number)
    components, label, estimate = _report(settings, taught, label)

    following, log_number, dropped = components, taught.log_number, estimate.dropped
    if isinstance(params.birth, DetectionBirth):
        births, lost = several.propose(
            params.birth, each, scans, taught.unexplained_prob, settings.max_births
        )
        following, label = intensity.add_births(
            target, params.target, components, births, label, birth_key
        )
        log_number, excess = cphd.add_newborn(log_number, births)
        dropped = dropped + lost
    dropped = dropped + (excess if settings.counts else 0.0)
    estimate = estimate._replace(dropped=dropped)
    return State(following, log_number, label, key), estimate


def _report(
    settings: Settings, taught: Taught, label: Array
) -> tuple[intensity.Components, Array, Any]:
    """Finds what to report, and under which labels."""
    components, threshold = taught.components, settings.report_threshold
    if settings.counts:
        mean = cardinality.mean(taught.log_number)
        components = intensity.scaled(components, mean)
        count = cphd.count_reported(taught.log_number, threshold)
        picked = extraction.heaviest(components, count)
        num_var = cardinality.variance(taught.log_number)
    else:
        picked = extraction.above(components, threshold or 0.0)
        num_var = components.expected  # that of a Poisson number
    components, shown, label = extraction.tell_apart(components, picked, label)
    estimate = extraction.report(
        settings.target,
        components,
        picked,
        shown,
        num_var,
        taught.log_evidence,
        taught.dropped,
    )
    if settings.counts:
        estimate = cphd.Estimate(*estimate, cardinality_prob=jnp.exp(taught.log_number))
    return components, label, estimate
