"""The track-oriented Poisson multi-Bernoulli filter: PMB, or TOMB/P.

A PMBM of a single hypothesis: after each scan the mixture over all joint events is
projected on the one set of independent tracks that has the same probability of each
track to exist and the same belief about it, summed over what it may have been given.
What is left is one belief a track, as in JIPDA, which it is but for the Poisson
intensity of the targets that were never detected.

`log_evidence` is the log-density of the scan given the projection of the past; it is
exact for the first scan.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import pmb
    >>> tracker = pmb.pmb(targets.single.single(), max_tracks=16)

Reference: Williams, "Marginal multi-Bernoulli filters: RFS derivation of MHT, JIPDA,
and association-based MeMBer", IEEE Trans. Aerospace and Electronic Systems 51(3), 2015,
section IV (Fig. 6); recycling: Williams, "Hybrid Poisson and multi-Bernoulli filters",
Proc. 15th International Conference on Information Fusion, 2012.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import assign, gate
from jaxtrack.trackers import (
    arrivals,
    association,
    bernoulli,
    jpda,
    projection,
    thinning,
    undetected,
)
from jaxtrack.trackers.association import Association, Sighting
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.trackers.undetected import Firsts, Params, Undetected
from jaxtrack.types import Array, Scan, Target, Tracker


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        tracks: N slots, likeliest first.
        undetected: U components.
        next_label: The first free label.
        key: Random key.
    """

    tracks: Tracks
    undetected: Undetected
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    associate: Callable[[Array], Association]
    max_tracks: int
    max_undetected: int
    gating: association.Gating
    exist_threshold: float
    recycle_threshold: float
    report_threshold: float


@functools.cache
def pmb(
    target: Target,
    method: str = "auto",
    max_cluster: int = assign.exact.MAX_CLUSTER,
    max_events: int | None = None,
    max_tracks: int = 32,
    max_undetected: int = 16,
    gate_prob: float = 0.999,
    exist_threshold: float = 1e-4,
    recycle_threshold: float = 0.0,
    report_threshold: float = 0.5,
) -> Tracker:
    """Makes a track-oriented Poisson multi-Bernoulli filter.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        method: Of the association probabilities: "auto" or "belief", as of
            `jpda.jpda`; the estimate does not tell which it was.
        max_cluster: Tracks that are summed over together, at most.
        max_events: Instead, take as many of the likeliest joint events, and no other.
        max_tracks: Tracks kept after a scan, the likeliest.
        max_undetected: Components kept of the intensity of undetected targets.
        gate_prob: P_G; 1 for no gate.
        exist_threshold: A track goes where its target exists with less probability.
        recycle_threshold: And where it exists with less than this, it becomes part of
            the undetected targets; 0 for never.
        report_threshold: A track is reported where its target exists with more.

    Raises:
        ValueError: A setting that makes no sense.
    """
    sizes = {"max_tracks": max_tracks, "max_undetected": max_undetected}
    thinning.check_sizes(sizes)
    gate.check(gate_prob)
    thinning.check_share("exist_threshold", exist_threshold)
    thinning.check_share("recycle_threshold", recycle_threshold)
    thinning.check_share("report_threshold", report_threshold)
    settings = Settings(
        target=target,
        associate=jpda.rule(method, max_cluster, max_events),
        max_tracks=max_tracks,
        max_undetected=max_undetected,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        exist_threshold=exist_threshold,
        recycle_threshold=recycle_threshold,
        report_threshold=report_threshold,
    )
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with the known targets."""
    arrivals.check(params, hides=True, recycles=settings.recycle_threshold > 0)
    keys, target = jax.random.split(key, 4), settings.target
    hidden = undetected.begin(target, params, settings.max_undetected, keys[0])
    tracks = bernoulli.nobody(
        target, params.target, arrivals.modes(params), settings.max_tracks, keys[1]
    )
    tracks = projection.begin(target, params, tracks, keys[2])
    number = (tracks.label >= 0).sum()
    return State(tracks, hidden, number, keys[3])


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, bernoulli.Estimate]:
    """Predicts, scores, finds the marginals, and projects."""
    target, scan = settings.target, association.filled(scan)
    keys = jax.random.split(state.key, 3)
    hidden = undetected.predict(
        target, params, state.undetected, scan.interval, keys[0]
    )
    firsts = undetected.see(target, params, hidden, scan, keys[1])
    tracks = bernoulli.predict(target, params.target, state.tracks, scan.interval)
    sight = association.look(settings.gating, True, target, params, tracks, scan)
    log_new = arrivals.log_new(firsts)
    hit = sight.log_score[:, :-1] - log_new[None]
    sight = sight._replace(log_score=jnp.append(hit, sight.log_score[:, -1:], axis=1))
    answer = settings.associate(sight.log_score)
    grown = _project(settings, params, tracks, sight, answer, firsts, scan, state)
    tracks, hidden, lost = _thin(settings, grown, firsts.missed)
    estimate = bernoulli.report(
        target,
        tracks,
        tracks.label,
        settings.report_threshold,
        answer.log_norm
        + log_new.sum()
        + sight.log_clutter.sum()
        - params.clutter.rate
        - firsts.found,
        lost,
    )
    estimate = estimate._replace(
        num_mean=estimate.num_mean + hidden.expected,
        num_var=estimate.num_var + hidden.expected,
    )
    label = state.next_label + scan.valid.sum()
    return State(tracks, hidden, label, keys[2]), estimate


def _project(
    settings: Settings,
    params: Params,
    tracks: Tracks,
    sight: Sighting,
    answer: Association,
    firsts: Firsts,
    scan: Scan,
    state: State,
) -> Tracks:
    """Returns the old tracks, each over all that it may have, and the new ones."""
    old = projection.update(settings.target, params.target, tracks, sight, answer, scan)
    label = state.next_label + jnp.cumsum(scan.valid) - 1
    new = Tracks(
        existence_prob=answer.unexplained_prob * jax.nn.sigmoid(firsts.log_score),
        belief=firsts.belief,
        label=label.astype(old.label.dtype),
        alias=jnp.full_like(label, -1),
    )
    return bernoulli.append(old, new)


def _thin(
    settings: Settings, tracks: Tracks, hidden: Undetected
) -> tuple[Tracks, Undetected, Array]:
    """Keeps the likeliest tracks; returns how many targets found no room, too."""
    prob = tracks.existence_prob
    if settings.recycle_threshold:
        number = jnp.where(prob < settings.recycle_threshold, prob, 0.0)
        hidden = undetected.add(hidden, number, tracks.belief)
        prob = prob - number
    hidden, unseen = undetected.reduce(hidden, settings.max_undetected)
    some, lost = projection.keep(
        tracks._replace(existence_prob=prob),
        settings.max_tracks,
        settings.exist_threshold,
    )
    return some, hidden, lost + unseen
