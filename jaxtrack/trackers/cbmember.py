"""The cardinality balanced multi-target multi-Bernoulli filter, for any target.

The belief about all targets is a set of independent tracks, each with a probability
that it exists. One scan is

    tracks = predict(tracks) + births               # each may die, new ones may appear
    for each track:      a legacy track             # it was missed
    for each detection:  an updated track           # it was caused, by whomever
    keep the likeliest tracks, report those that exist with more than even odds

`cbmember(target=mixture(...))` with several modes is the GM-MM-CBMeMBer filter, with
one mode the GM-CBMeMBer filter; with a nonlinear model and `linearize.taylor` or
`unscented` it is the EK or UK form; `cbmember(target=imm())` keeps one Gaussian a mode.

Labels (left open by the paper) follow ancestry: a legacy track keeps its label, an
updated track takes that of the track that explains its detection best, a newborn gets a
new one. Where two reported tracks share a label, the likelier is the heir and the other
is reported under an alias (`bernoulli.tell_apart`).

The log-evidence of a scan is that of a product form, in which several detections may
stem from one track: exact for a single detection or where no two detections compete for
a track. It is the normaliser that the filter's own update uses. A detection that
neither a track nor clutter can explain makes it -inf: keep the clutter's box wide and
its rate above zero.

How far off it is: with one detection the expected number of targets and the evidence
are exact, for any number of tracks; but a track that exists almost surely passes only
(1 - r) / (1 - r p_D) of its existence on to its detection, so p_D should be near one.
Two targets so close that they compete for two detections are overcounted by 0.11 on
average, one target with three detections in reach by 0.56 (p_D 0.9 to 0.99, heavy
clutter, 300 random scenes of `tests/test_cbmember.py` against brute force).
`limits` has a table by P_D and clutter; `balance="claims"` takes the overcount away.

    >>> from jaxtrack import targets, trackers
    >>> trackers.cbmember.cbmember(targets.imm.imm(), max_tracks=16)._fields
    ('init', 'step')

References: Yuan, Lian and Han, "Multiple-model cardinality balanced multitarget multi-
Bernoulli filter for tracking maneuvering targets", 2013, equations 6 to 13 and 30 to
36, Algorithm 1; Vo, Vo and Cantoni, "The cardinality balanced multi-target
multi-Bernoulli filter and its implementations", IEEE Trans. Signal Processing 57(2),
2009, whose denominators hold where the paper's print slips.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate
from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.trackers import alternatives, bernoulli, multi_bernoulli
from jaxtrack.trackers.bernoulli import Estimate, Tracks
from jaxtrack.trackers.multi_bernoulli import Balance, Settings
from jaxtrack.types import Array, Scan, Target, Tracker


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        target: The `Params` of the target.
        birth: `models.birth.MultiBernoulliBirth` or `PoissonBirth` (known places, after
            the prediction; at most one a place), or `DetectionBirth` (where the last
            scan left detections unexplained).
        clutter: Of `models.clutter`.
    """

    target: Any
    birth: MultiBernoulliBirth | PoissonBirth | DetectionBirth
    clutter: Any


class State(NamedTuple):
    """What the next scan needs: the tracks, the next free label, a random key."""

    tracks: Tracks
    next_label: Array
    key: Array


@functools.cache
def cbmember(
    target: Target,
    max_tracks: int = 32,
    max_births: int = 16,
    max_parents: int = 8,
    max_updated: int | None = None,
    prune_threshold: float = 1e-3,
    report_threshold: float = 0.5,
    merge_threshold: float = 0.0,
    split_threshold: float = 0.8,
    balance: Balance = "paper",
    max_scored: int | None = None,
) -> Tracker:
    """Makes a CBMeMBer filter.

    Args:
        target: How one target is filtered, e.g. `targets.imm.imm()`.
        max_tracks: Tracks kept after a scan; the least likely go first.
        max_births: Newborn tracks of `DetectionBirth` kept after a scan.
        max_parents: Tracks that may share in one detection's updated track.
        max_updated: Updated tracks kept after a scan; by default `max_tracks`.
        prune_threshold: Tracks that exist with less probability go.
        report_threshold: Tracks that exist with more probability are reported.
        merge_threshold: Squared Mahalanobis distance within which tracks under one
            label merge; then a label counts as a whole when it is reported. With 0
            nothing merges and each track counts for itself.
        split_threshold: Where tracks merge, a track beside a likelier one under its
            label starts its own if it exists with more probability than this.
        balance: "paper", or "claims", which gives each detection to one track at most:
            no overcount, for more work; see `multi_bernoulli`.
        max_scored: Detections that each track scores in full, see `gate.scores`; for
            particles among much clutter.

    Raises:
        ValueError: A size, threshold or balance that makes no sense.
    """
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
        max_scored,
    )
    check(settings)
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def check(settings: Settings) -> None:
    """Raises a ValueError for settings that make no sense."""
    for name in ("max_tracks", "max_births", "max_parents", "max_updated"):
        if (size := getattr(settings, name)) < 1:
            raise ValueError(f"{name} is {size}; give at least 1")
    for name in ("prune_threshold", "report_threshold", "split_threshold"):
        if not 0 <= (value := getattr(settings, name)) < 1:
            raise ValueError(f"{name} is {value}; give a probability from 0 up to 1")
    if not settings.merge_threshold >= 0:
        raise ValueError(
            f"merge_threshold is {settings.merge_threshold}; give a squared distance, "
            "e.g. 4"
        )
    gate.check_scored(settings.max_scored)
    if settings.balance not in ("paper", "claims"):
        raise ValueError(
            f'balance is {settings.balance!r}; give "paper" (each detection by itself) '
            'or "claims" (by the probabilities of all joint events)'
        )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts without targets."""
    driven = isinstance(params.birth, DetectionBirth)
    mode_prob = params.birth.mode_prob if driven else params.birth.mode_prob[0]
    size = settings.max_tracks + (settings.max_births if driven else 0)
    tracks = bernoulli.nobody(settings.target, params.target, mode_prob, size, key)
    return State(tracks, jnp.zeros((), int), key)


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Predicts, adds births, updates, keeps the likeliest and reports."""
    target = settings.target
    key, birth_key = jax.random.split(state.key)
    label = state.next_label

    tracks = bernoulli.predict(target, params.target, state.tracks, scan.interval)
    if not isinstance(params.birth, DetectionBirth):
        born = bernoulli.begin(target, params.target, params.birth, label, birth_key)
        tracks, label = bernoulli.append(tracks, born), label + born.label.size

    update = multi_bernoulli.update(
        settings.balance, target, params, tracks, scan, settings.max_scored
    )
    tracks, dropped = multi_bernoulli.keep(
        settings, params.target, tracks, scan, update
    )
    tracks, shown, label = tell_apart(settings, tracks, label)

    if not isinstance(params.birth, DetectionBirth):
        following = tracks
    else:
        births, lost = bernoulli.from_unexplained(
            params.birth,
            params.target,
            scan,
            update.unexplained_prob,
            settings.max_births,
        )
        born = bernoulli.begin(target, params.target, births, label, birth_key)
        following, label = bernoulli.append(tracks, born), label + born.label.size
        dropped = dropped + lost
    estimate = report(settings, tracks, shown, update.log_evidence, dropped)
    return State(following, label, key), estimate


def tell_apart(
    settings: Settings, tracks: Tracks, label: Array
) -> tuple[Tracks, Array, Array]:
    """Merges the tracks of one target, if asked to, and finds labels to report.

    Args:
        settings: The maker's.
        tracks: N tracks, likeliest first.
        label: The first free label.

    Returns:
        The tracks, the labels [N] and the next free label.
    """
    if not settings.merge_threshold > 0:
        return bernoulli.tell_apart(tracks, label, settings.report_threshold)
    tracks = alternatives.merge(settings.target, tracks, settings.merge_threshold)
    tracks, shown, label = bernoulli.tell_apart(tracks, label, settings.split_threshold)
    # A label is one target, so a rival has its own for good.
    tracks = tracks._replace(label=shown, alias=jnp.full_like(shown, -1))
    return tracks, shown, label


def report(
    settings: Settings,
    tracks: Tracks,
    shown: Array,
    log_evidence: Array,
    dropped: Array,
) -> Estimate:
    """Reports the tracks, see `bernoulli.report`, or the labels where tracks merge."""
    threshold = settings.report_threshold
    estimate = bernoulli.report(
        settings.target, tracks, shown, threshold, log_evidence, dropped
    )
    if settings.merge_threshold > 0:
        return estimate._replace(exists=alternatives.heirs(tracks, threshold))
    return estimate
