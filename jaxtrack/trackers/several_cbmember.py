"""The CBMeMBer filter with several sensors, for any target.

Iterated, it is the filter of `cbmember` sensor after sensor: each detection of each
sensor makes an updated track of those that are left.

The product form needs to know what a sensor says about one track, so it goes by the
claims of `multi_bernoulli`: for each sensor alone, the probabilities that track n does
not exist, was missed, or caused detection k, from the exact joint events. They are
taken for independent between tracks, as they are before the scan. A track's odds with
all sensors are its own, times for each sensor the odds after it divided by those
before, where a chain of causes (missed or detected by each sensor in turn) is worth

    r prod_s (P_s(cause_s) / (r L_s(cause_s))) L(all causes)

L_s being how likely the cause is to sensor s alone and L how likely they are together,
that is, how well its detections fit one target. All chains with the same detections
make one updated track, that without detections is the legacy track. For one sensor this
is `cbmember(balance="claims")`. For one target at most it is exact, whatever the
clutter and the number of sensors.

    >>> from jaxtrack import targets, trackers
    >>> make = trackers.several_cbmember.several_cbmember
    >>> make(targets.single.single(), form="product", max_tracks=16)._fields
    ('init', 'step')

Reference: Mahler, "Approximate multisensor CPHD and PHD filters", Fusion 2010, divides
the posterior of each sensor by the prior; here that is done for Bernoulli tracks.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.birth import DetectionBirth
from jaxtrack.trackers import bernoulli, cbmember, chains, multi_bernoulli, several
from jaxtrack.trackers.bernoulli import Estimate, Tracks
from jaxtrack.trackers.cbmember import State
from jaxtrack.trackers.multi_bernoulli import Settings
from jaxtrack.trackers.several import Form, Params
from jaxtrack.types import Array, Scan, Scans, Target, Tracker

# Of a sensor's parameters and its scan, see `several.split`.
Each = Sequence[tuple[Any, Scan]]


class Taught(NamedTuple):
    """What several scans make of N tracks.

    Attributes:
        tracks: The likeliest first.
        log_evidence: Log-density of all scans.
        unexplained_prob: That no known track caused a detection, [K] for each sensor.
        dropped: Expected number of targets that the capacities threw away.
    """

    tracks: Tracks
    log_evidence: Array
    unexplained_prob: tuple[Array, ...]
    dropped: Array


@functools.cache
def several_cbmember(
    target: Target,
    form: Form = "iterated",
    max_tracks: int = 32,
    max_births: int = 16,
    max_parents: int = 8,
    max_updated: int | None = None,
    prune_threshold: float = 1e-3,
    report_threshold: float = 0.5,
    merge_threshold: float = 0.0,
    split_threshold: float = 0.8,
    balance: multi_bernoulli.Balance = "paper",
) -> Tracker:
    """Makes a CBMeMBer filter with several sensors.

    Its `Params` are those of `several`, its scans `types.Scans`.

    Args:
        target: How one target is filtered, e.g. `targets.imm.imm()`.
        form: "iterated" or "product", see `several`.
        max_tracks: Tracks kept after each sensor; the least likely go first.
        max_births: Newborn tracks of `DetectionBirth` kept after a scan.
        max_parents: Tracks that may share in one detection's updated track.
        max_updated: Updated tracks kept after each sensor; in the product form, pairs
            of a track and a detection. By default `max_tracks`.
        prune_threshold: Tracks that exist with less probability go.
        report_threshold: Tracks that exist with more probability are reported.
        merge_threshold: As in `cbmember.cbmember`.
        split_threshold: As in `cbmember.cbmember`.
        balance: As in `cbmember.cbmember`; the product form always goes by claims.

    Raises:
        ValueError: A size, threshold, balance or form that makes no sense.
    """
    several.check(form)
    settings = Settings(
        target,
        max_tracks,
        max_births,
        max_parents,
        max_tracks if max_updated is None else max_updated,
        prune_threshold,
        report_threshold,
        merge_threshold,
        split_threshold,
        balance,
    )
    cbmember.check(settings)
    update = iterated if form == "iterated" else product
    one = cbmember.cbmember(*settings)
    return Tracker(init=one.init, step=functools.partial(_step, settings, update))


def _step(
    settings: Settings, update: Any, params: Params, state: State, scans: Scans
) -> tuple[State, Estimate]:
    """Predicts, adds births, updates by each sensor and reports."""
    target = settings.target
    key, birth_key = jax.random.split(state.key)
    label, interval = state.next_label, scans.each[0].interval
    each = several.split(params, scans)

    tracks = bernoulli.predict(target, params.target, state.tracks, interval)
    if not isinstance(params.birth, DetectionBirth):
        born = bernoulli.begin(target, params.target, params.birth, label, birth_key)
        tracks, label = bernoulli.append(tracks, born), label + born.label.size

    taught = update(settings, each, tracks)
    tracks, shown, label = cbmember.tell_apart(settings, taught.tracks, label)

    following, dropped = tracks, taught.dropped
    if isinstance(params.birth, DetectionBirth):
        births, lost = several.propose(
            params.birth, each, scans, taught.unexplained_prob, settings.max_births
        )
        born = bernoulli.begin(target, params.target, births, label, birth_key)
        following, label = bernoulli.append(tracks, born), label + born.label.size
        dropped = dropped + lost
    estimate = cbmember.report(settings, tracks, shown, taught.log_evidence, dropped)
    return State(following, label, key), estimate


def iterated(settings: Settings, each: Each, tracks: Tracks) -> Taught:
    """Updates by one sensor after another.

    Args:
        settings: The maker's.
        each: Parameters and scan of each sensor.
        tracks: N, predicted, with the newborn.
    """
    log_evidence, dropped, unexplained = jnp.zeros(()), jnp.zeros(()), []
    for params, scan in each:
        update = multi_bernoulli.update(
            settings.balance, settings.target, params, tracks, scan
        )
        tracks, lost = multi_bernoulli.keep(
            settings, params.target, tracks, scan, update
        )
        log_evidence, dropped = log_evidence + update.log_evidence, dropped + lost
        unexplained.append(update.unexplained_prob)
    return Taught(tracks, log_evidence, tuple(unexplained), dropped)


def product(settings: Settings, each: Each, tracks: Tracks) -> Taught:
    """Multiplies what all sensors say of the prediction; arguments as in `iterated`."""
    target = settings.target
    # A rounding below one, as the sensors take it: certainty has no odds.
    tiny = jnp.finfo(tracks.existence_prob.dtype).eps
    prob = jnp.minimum(tracks.existence_prob, 1 - tiny)
    chain = chains.start(tracks._replace(existence_prob=prob))
    log_absent, lost, alone = jnp.log1p(-prob), jnp.zeros(()), []
    for params, scan in each:
        said = chains.factors(target, params, tracks, scan)
        chain, gone = chains.grow(
            settings.max_updated, target, params, said, chain, scan
        )
        log_absent, lost = log_absent + said.log_absent, lost + gone
        alone.append(said)
    layout = each[0][0].target
    kept, log_norm, dropped = chains.gather(settings, layout, tracks, chain, log_absent)
    return Taught(
        tracks=kept,
        log_evidence=jnp.stack([said.log_evidence for said in alone]).sum() + log_norm,
        unexplained_prob=tuple(said.unexplained_prob for said in alone),
        dropped=dropped + lost * kept.existence_prob.sum(),
    )
