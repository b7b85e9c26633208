"""Trackers that keep one belief a track: all but the association is common to them.

One scan is

    tracks = predict(tracks)
    scores = look(tracks, scan)                   # gated, one matrix
    answer = associate(scores)                    # the algorithm
    tracks = blend(tracks, scan, answer)          # each by its share of the detections
    confirm, drop, and begin new ones where detections are unexplained

The algorithms are `nearest`, `gnn`, `pda`, `jpda`, `jpda_star`, `set_jpda` and their
integrated forms; each file gives its `associate`.

Whatever the algorithm, `existence_prob` follows from survival and from how much better
the scan is explained with the track than without. In the integrated forms the scores
count it; in the others a track is taken for certain.

`log_evidence` is the log-density of the scan given the tracks: exact for `jpda` where
the marginals are, too small for `gnn` and where only the likeliest events are
considered, too large for `pda` and `nearest`, which let tracks share a detection. New
targets are not in it.

    >>> from jaxtrack.trackers import single_scan
    >>> single_scan.Estimate._fields[:4]
    ('mean', 'cov', 'label', 'exists')

References: Bar-Shalom and Fortmann, "Tracking and Data Association", 1988; Musicki and
Evans, "Joint integrated probabilistic data association: JIPDA", IEEE Trans. Aerospace
and Electronic Systems 40(3), 2004.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.models.pairs import PairBirth
from jaxtrack.trackers import association, bernoulli, initiation, management
from jaxtrack.trackers.association import Association, Gating, Sighting
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.types import Array, PyTree, Scan, Target


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        target: The `Params` of the target.
        birth: Where tracks begin: `models.birth.DetectionBirth` (one point),
            `models.pairs.PairBirth` (two points), `MultiBernoulliBirth` or
            `PoissonBirth` (known places; only where existence is weighed), or None.
        clutter: Of `models.clutter`.
        start: Targets that may be there before the first scan, `max_tracks` of them at
            most, or None; they are confirmed where that is likelier than not.
    """

    target: Any
    birth: DetectionBirth | PairBirth | MultiBernoulliBirth | PoissonBirth | None
    clutter: Any
    start: MultiBernoulliBirth | None = None


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        tracks: N slots.
        record: What they have done, [N].
        leftovers: The last scan's least explained detections, as many as there may be
            births, for births at two points.
        next_label: The first free label.
        key: Random key.
    """

    tracks: Tracks
    record: management.Record
    leftovers: initiation.Leftovers
    next_label: Array
    key: Array


class Estimate(NamedTuple):
    """What a scan taught, for the user; confirmed tracks first.

    Attributes:
        mean: [N, D].
        cov: [N, D, D].
        label: Which target it is, [N] (int).
        exists: Confirmed: report this one, [N] (bool).
        existence_prob: [N].
        mode_prob: [N, M].
        effective_size: How many equally weighted particles each belief is worth; 0
            where it is no sample, [N].
        num_mean: Expected number of targets.
        num_var: Variance of the number of targets if their existences are independent.
        log_evidence: Log-density of the scan given the tracks.
        dropped: Expected number of targets, or parts of them, that found no room.
        association_prob: Which detection it has; last column none, [N, K + 1]; with a
            slot for a detection even where a scan has none.
        exact: Whether association_prob is what the method says, [N] (bool).
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
    association_prob: Array
    exact: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    weighs: bool
    associate: Callable[[Array], Association]
    update: Callable[[Target, Any, Sighting, Association, Scan], PyTree]
    rule: management.Rule
    gating: Gating
    max_tracks: int
    max_births: int
    start_threshold: float
    duplicate_threshold: float


def init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with the targets of `params.start`, in the first slots."""
    key, start_key = jax.random.split(key)
    tracks = bernoulli.nobody(
        settings.target,
        params.target,
        initiation.mode_prob(params.birth, params.target),
        settings.max_tracks + initiation.num_driven(params.birth, settings.max_births),
        key,
    )
    record = management.begin(tracks.existence_prob, num_hits=0)
    label = jnp.zeros((), int)
    if params.start is not None:
        known, done = initiation.at_start(
            settings.target, params, settings.max_tracks, label, start_key
        )
        tracks, record = jax.tree.map(_fill, (tracks, record), (known, done))
        label = label + known.label.size
    return State(
        tracks=tracks,
        record=record,
        leftovers=initiation.nothing(params.birth, params.target, settings.max_births),
        next_label=label,
        key=key,
    )


def _fill(slots: Array, first: Array) -> Array:
    return slots.at[: len(first)].set(first.astype(slots.dtype))


def step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Predicts, associates, updates, confirms and drops, begins and reports."""
    target, gating, scan = settings.target, settings.gating, association.filled(scan)
    key, birth_key = jax.random.split(state.key)
    record, label = state.record, state.next_label

    tracks = bernoulli.predict(target, params.target, state.tracks, scan.interval)
    tracks, record, label = initiation.at_known_places(
        target, settings.weighs, params, tracks, record, label, birth_key
    )
    sighting = association.look(gating, settings.weighs, target, params, tracks, scan)
    answer = settings.associate(sighting.log_score)
    tracks, record = _update(settings, params, tracks, record, sighting, answer, scan)
    tracks, record, kept, dropped = _keep(settings, tracks, record)
    shares = answer.log_prob, answer.exact

    unexplained = jnp.where(scan.valid, answer.unexplained_prob, 0.0)
    unexplained = jnp.where(unexplained >= settings.start_threshold, unexplained, 0.0)
    begun = initiation.begin(
        target,
        params,
        settings.max_births,
        scan,
        unexplained,
        state.leftovers,
        label,
        birth_key,
    )
    following = State(
        tracks=bernoulli.append(tracks, begun.tracks),
        record=jax.tree.map(_join, record, begun.record),
        leftovers=begun.leftovers,
        next_label=label + begun.tracks.label.size,
        key=key,
    )

    clutter = scan.valid.sum() if gating.counts_clutter else params.clutter.rate
    log_evidence = answer.log_norm + sighting.log_clutter.sum() - clutter
    told = tracks, record.confirmed, log_evidence, dropped + begun.dropped
    return following, _report(target, *told, jax.tree.map(lambda x: x[kept], shares))


def _report(
    target: Target,
    tracks: Tracks,
    confirmed: Array,
    log_evidence: Array,
    dropped: Array,
    shares: tuple[Array, Array],
) -> Estimate:
    """Makes the estimate; shares are the association's log_prob and exact."""
    basics = bernoulli.report(target, tracks, tracks.label, 0.0, log_evidence, dropped)
    log_prob, exact = shares
    return Estimate(
        **basics._replace(exists=confirmed)._asdict(),
        association_prob=jnp.exp(log_prob),
        exact=exact,
    )


def _join(old: Array, new: Array) -> Array:
    return jnp.concatenate([old, new.astype(old.dtype)])


def _update(
    settings: Settings,
    params: Params,
    tracks: Tracks,
    record: management.Record,
    sighting: Sighting,
    answer: Association,
    scan: Scan,
) -> tuple[Tracks, management.Record]:
    """Gives each track what its detections teach, and its record the scan."""
    target = settings.target
    belief = settings.update(target, params.target, sighting, answer, scan)
    prob = association.existence(tracks, sighting, answer)
    belief = jax.vmap(target.adapt, (None, 0, 0))(params.target, belief, prob)
    detected_prob = -jnp.expm1(answer.log_prob[:, -1])
    ratio = association.log_ratio(tracks, sighting, answer)
    record = management.record(record, detected_prob, ratio)
    confirmed = record.confirmed | settings.rule.confirms(record, prob)
    record = record._replace(confirmed=confirmed & (prob > 0))
    return tracks._replace(existence_prob=prob, belief=belief), record


def _keep(
    settings: Settings, tracks: Tracks, record: management.Record
) -> tuple[Tracks, management.Record, Array, Array]:
    """Drops tracks by the rule, then by the capacity: tentative and unlikely first.

    Returns the survivors, confirmed and likely first, their former slots, and the
    expected number of targets, or parts of them, that the capacities threw away.
    """
    alive = ~settings.rule.drops(record, tracks.existence_prob)
    prob = jnp.where(alive, tracks.existence_prob, 0.0)
    if settings.duplicate_threshold > 0:
        again = management.duplicates(
            jax.vmap(settings.target.moments)(tracks.belief),
            prob + (record.confirmed & alive),
            settings.duplicate_threshold,
        )
        prob = jnp.where(again, 0.0, prob)
    confirmed = record.confirmed & alive & (prob > 0)
    _, kept = jax.lax.top_k(prob + confirmed, settings.max_tracks)
    lost = jax.vmap(settings.target.lost)(tracks.belief)
    dropped = prob.sum() - prob[kept].sum() + (prob * lost)[kept].sum()
    some = tracks._replace(existence_prob=prob), record._replace(confirmed=confirmed)
    tracks, record = jax.tree.map(lambda x: x[kept], some)
    return tracks, record, kept, jnp.maximum(dropped, 0.0)
