"""Markov chain Monte Carlo data association over a sliding window.

With every scan a chain walks over the hypotheses about the last scans, from the best
one so far on. The best one that it saw then decides what lies `num_scans` back, as in
`mht`: its tracks there are known from now on, and what it calls false there is. All
that is told is an average over the chain's samples, and as uncertain as that.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import mcmcda
    >>> tracker = mcmcda.mcmcda(targets.single.single(), num_scans=2)

`log_evidence` is the log-density of the scan given what was decided, summed over the
hypotheses that the chain found. `dropped` is the sum of the detections that found no
room, the targets expected in what was given up, known or never detected, and the share
of samples that had no row left in which a track could begin.

Reference: Oh, Russell and Sastry, "Markov chain Monte Carlo data association for multi-
target tracking", IEEE Trans. Automatic Control 54(3), 2009, section VI (online).
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.birth import DetectionBirth
from jaxtrack.trackers import (
    bernoulli,
    mcmcda_batch,
    mcmcda_estimate,
    mcmcda_problem,
    mcmcda_scores,
    recent,
    thinning,
    undetected,
)
from jaxtrack.trackers.bernoulli import Estimate, Tracks
from jaxtrack.trackers.mcmcda_batch import SHARES, Samples
from jaxtrack.trackers.mcmcda_scores import Problem
from jaxtrack.trackers.recent import Recent
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, Scan, Target, Tracker


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        known: Tracks before the window, as decided, N.
        window: The last W - 1 scans, of K slots.
        label: What a track is called that begins with a detection, [W - 1, K].
        hidden: Targets never detected before the window, U.
        table: The best hypothesis so far: which known track or, in the other columns,
            detection is in each row, [N, W].
        log_prob: Of that one, among those found that agree with what was decided.
        next_label: The first free label.
        key: Random key.
    """

    known: Tracks
    window: Recent
    label: Array
    hidden: Undetected
    table: Array
    log_prob: Array
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    num_scans: int
    num_samples: int
    burn_in: int
    thin: int
    max_tracks: int
    max_detections: int
    max_undetected: int
    exist_threshold: float
    report_threshold: float
    shares: tuple[float, ...]


@functools.cache
def mcmcda(
    target: Target,
    num_scans: int = 3,
    num_samples: int = 200,
    burn_in: int = 20,
    thin: int = 5,
    max_tracks: int = 16,
    max_detections: int = 32,
    max_undetected: int = 16,
    exist_threshold: float = 1e-3,
    report_threshold: float = 0.5,
    shares: tuple[float, ...] = SHARES,
) -> Tracker:
    """Makes the tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        num_scans: Scans after which the best hypothesis decides; 0 decides at once.
        num_samples: Of hypotheses, at every scan.
        burn_in: Samples that are forgotten before.
        thin: Steps of the chain for each sample.
        max_tracks: N, tracks in a hypothesis.
        max_detections: Room for those of a scan, K.
        max_undetected: Components kept of the intensity of undetected targets.
        exist_threshold: A known track goes where its target exists with less and the
            window has no detection of it.
        report_threshold: A track of the best hypothesis is reported where its target
            exists with more probability.
        shares: How often to try which pair of moves, as `mcmcda_batch.SHARES`.

    Raises:
        ValueError: A setting that makes no sense.
    """
    settings = Settings(
        target=target,
        num_scans=num_scans,
        num_samples=num_samples,
        burn_in=burn_in,
        thin=thin,
        max_tracks=max_tracks,
        max_detections=max_detections,
        max_undetected=max_undetected,
        exist_threshold=exist_threshold,
        report_threshold=report_threshold,
        shares=shares,
    )
    _check(settings)
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _check(settings: Settings) -> None:
    for name in ("max_detections", "max_undetected"):
        if (size := getattr(settings, name)) < 1:
            raise ValueError(f"{name} is {size}; give at least 1")
    if settings.num_scans < 0:
        raise ValueError(f"num_scans is {settings.num_scans}; give 0 or more")
    steps = settings.num_samples, settings.burn_in, settings.thin
    mcmcda_batch.check(settings.max_tracks, *steps, settings.shares)
    for name in ("exist_threshold", "report_threshold"):
        thinning.check_share(name, getattr(settings, name))


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with the known targets, before a window in which nobody looked."""
    keys, size = jax.random.split(key, 4), settings.max_tracks
    target, birth = settings.target, params.birth
    hidden = undetected.begin(target, params, settings.max_undetected, keys[0])
    driven = isinstance(birth, DetectionBirth)
    mode_prob = birth.mode_prob if driven else birth.mode_prob[0]
    known = bernoulli.nobody(target, params.target, mode_prob, size, keys[1])
    number = 0 if params.start is None else len(params.start.existence_prob)
    if number > size:
        raise ValueError(
            f"start has {number} targets and max_tracks is {size}; make room for them"
        )
    if params.start is not None:
        there = bernoulli.begin(
            target, params.target, params.start, jnp.array(0), keys[2]
        )
        known = jax.tree.map(lambda x: x[:size], bernoulli.append(there, known))
    zero = jnp.zeros((), hidden.log_weight.dtype)
    outputs = jnp.zeros(params.target.sensor.num_outputs, zero.dtype)
    room = settings.num_scans, settings.max_detections
    rows, columns = jnp.arange(size)[:, None], jnp.arange(settings.num_scans + 1)
    begun = (known.existence_prob > 0)[:, None] & (columns == 0)[None]
    return State(
        known=known,
        window=recent.begin(*room, outputs),
        label=jnp.full(room, -1),
        hidden=hidden,
        table=jnp.where(begun, rows, -1),
        log_prob=zero,
        next_label=jnp.array(number),
        key=keys[3],
    )


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Walks a chain over the window, reports, and decides about its first scan."""
    target, (key, *seeds) = settings.target, jax.random.split(state.key, 3)
    window, lost = recent.push(state.window, scan)
    fresh = state.next_label + jnp.arange(settings.max_detections)
    label = jnp.concatenate([state.label, fresh[None]])
    problem = mcmcda_problem.go_on(
        target, params, window, state.hidden, state.known, seeds[0]
    )
    samples = _walk(settings, params, state, problem, seeds[1])
    log_share = mcmcda_estimate.log_share(samples, 0)
    earlier = mcmcda_scores.head(problem, len(label))
    score = mcmcda_scores.score_all(target, params.target, earlier, state.table)
    log_before = score.log_score.sum() + earlier.log_constant.sum() - state.log_prob
    names = mcmcda_estimate.names(problem, state.known.label, label)
    estimate = mcmcda_estimate.report(
        target, settings.report_threshold, samples, problem, names
    )
    known, table, gone = _decide(settings, params, problem, samples.best.table, names)
    estimate = estimate._replace(
        log_evidence=samples.best.log_weight - log_share - log_before,
        dropped=lost + gone + samples.full + problem.dropped[-1],
    )
    following = State(
        known=known,
        window=recent.pop(window),
        label=label[1:],
        hidden=jax.tree.map(lambda x: x[1], problem.hidden),
        table=table,
        log_prob=mcmcda_estimate.log_share(samples, 2),
        next_label=state.next_label + settings.max_detections,
        key=key,
    )
    return following, estimate


def _walk(
    settings: Settings, params: Params, state: State, problem: Problem, key: Array
) -> Samples:
    """Samples hypotheses, from the best one so far on with nothing new in it."""
    return mcmcda_batch.sample(
        settings.target,
        params,
        problem,
        key,
        num_samples=settings.num_samples,
        burn_in=settings.burn_in,
        thin=settings.thin,
        shares=settings.shares,
        start=jnp.pad(state.table, ((0, 0), (0, 1)), constant_values=-1),
    )


def _decide(
    settings: Settings, params: Params, problem: Problem, best: Array, names: Array
) -> tuple[Tracks, Array, Array]:
    """Takes the best hypothesis for true up to the first scan of the window.

    Returns:
        The tracks known now, the hypothesis that goes on from them, and the expected
        number of targets that were given up.
    """
    first, decided = mcmcda_scores.head(problem, 2), best[:, :2]
    tracks = mcmcda_scores.score_all(settings.target, params.target, first, decided)
    prob = tracks.existence_prob
    # Who is seen again later in the window is there, whatever was likely until now.
    again = (decided >= 0).any(1) & (best[:, 2:] >= 0).any(1)
    stays = again | (prob > settings.exist_threshold)
    known = Tracks(
        existence_prob=jnp.where(stays, prob, 0.0),
        belief=tracks.belief,
        label=jnp.where(stays, mcmcda_estimate.called(names, best), -1),
        alias=jnp.full(len(best), -1),
    )
    rows = jnp.where(stays, jnp.arange(len(best)), -1)
    table = jnp.concatenate([rows[:, None], best[:, 2:]], axis=1)
    return known, table, jnp.where(stays, 0.0, prob).sum()
