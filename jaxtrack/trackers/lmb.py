"""The labeled multi-Bernoulli filter: LMB.

Targets have labels from birth; each is there or not independently of the others, with a
belief about it. A scan makes that a mixture over who has which detection, whose labels
stay the same; it is projected on the independent targets that are each there with the
same probability, and about which the same is believed, see `projection`. Whether a
target that has no detection was missed or is not there is summed over at once, so that
none of the hypotheses about who is there need be told apart, as a GLMB update does.

The probabilities of who has which detection are summed exactly where few compete, come
from belief propagation, or from the likeliest joint events, ranked or drawn by Gibbs
sampling.

With exact sums it is the JIPDA of `jpda.jipda` with births at known places, but that
tracks are neither confirmed nor held on to: what is reported follows from the scan
alone. `pmb` is the same for a Poisson number of births.

`log_evidence` is the log-density of the scan given the projection of the past, exact
for the first scan where the sums are.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import lmb
    >>> tracker = lmb.lmb(targets.single.single(), method="belief", max_tracks=64)

References: Reuter, Vo, Vo and Dietmayer, "The labeled multi-Bernoulli filter", IEEE
Trans. Signal Processing 62(12), 2014; Reuter, Danzer, Stuebler, Scheel and Granstrom,
"A fast implementation of the labeled multi-Bernoulli filter using Gibbs sampling",
IEEE Intelligent Vehicles Symposium, 2017; Kropfreiter, Meyer and Hlawatsch, "A fast
labeled multi-Bernoulli filter using belief propagation", IEEE Trans. Aerospace and
Electronic Systems 56(3), 2020.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import assign, gate
from jaxtrack.assign.sample_of_many import sample_of_many
from jaxtrack.models.birth import DetectionBirth
from jaxtrack.trackers import (
    arrivals,
    association,
    bernoulli,
    estimators,
    glmb,
    jpda,
    projection,
    thinning,
)
from jaxtrack.trackers.association import Association
from jaxtrack.trackers.bernoulli import Estimate, Tracks
from jaxtrack.trackers.undetected import Params
from jaxtrack.types import Array, Scan, Target, Tracker

METHODS = "auto", "belief", "k-best", "gibbs"


class State(NamedTuple):
    """What the next scan needs: tracks, likeliest first, the next label, random key."""

    tracks: Tracks
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments; `associate` is (key, scores [N, K + 1]) -> Association."""

    target: Target
    associate: Callable[[Array, Array], Association]
    max_tracks: int
    max_births: int
    gating: association.Gating
    exist_threshold: float
    estimator: str
    report_threshold: float


@functools.cache
def lmb(
    target: Target,
    method: str = "auto",
    max_cluster: int = assign.exact.MAX_CLUSTER,
    max_events: int = 100,
    num_sweeps: int = 10,
    max_tracks: int = 32,
    max_births: int = 16,
    gate_prob: float = 0.999,
    exist_threshold: float = 1e-4,
    estimator: str = "number",
    report_threshold: float = 0.5,
) -> Tracker:
    """Makes an LMB filter.

    Its `undetected.Params` have a `MultiBernoulliBirth`, or a `DetectionBirth`: where
    the last scan left detections unexplained; and nobody undetected.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        method: Of the association probabilities: "auto" or "belief", as of `jpda.jpda`,
            "k-best", of the likeliest joint events, or "gibbs", of those drawn. The
            estimate does not tell which were exact, nor what the events leave out.
        max_cluster: Tracks that are summed over together, at most.
        max_events: Joint events of "k-best", and of "gibbs", with as many chains.
        num_sweeps: Joint events that each chain of "gibbs" comes to.
        max_tracks: Tracks kept after a scan, the likeliest.
        max_births: Newborn tracks of `DetectionBirth` kept after a scan.
        gate_prob: P_G; 1 for no gate.
        exist_threshold: A track goes where its target exists with less probability.
        estimator: What is reported, see `estimators`; "number" are so many of the
            likeliest tracks as it is likeliest that there are, "heaviest" those above a
            threshold.
        report_threshold: Of "heaviest".

    Raises:
        ValueError: A setting that makes no sense.
    """
    thinning.check_sizes({"max_tracks": max_tracks, "max_births": max_births})
    gate.check(gate_prob)
    thinning.check_share("exist_threshold", exist_threshold)
    thinning.check_share("report_threshold", report_threshold)
    estimators.check(estimator)
    settings = Settings(
        target=target,
        associate=_rule(method, max_cluster, max_events, num_sweeps),
        max_tracks=max_tracks,
        max_births=max_births,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        exist_threshold=exist_threshold,
        estimator=estimator,
        report_threshold=report_threshold,
    )
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _rule(
    method: str, max_cluster: int, max_events: int, num_sweeps: int
) -> Callable[[Array, Array], Association]:
    """Makes a function from a key and scores [N, K + 1] to an association."""
    glmb.check(method, num_sweeps, METHODS)
    jpda.check(max_events)
    if method == "gibbs":
        return functools.partial(_drawn, max_events, num_sweeps)
    ranked = method == "k-best"
    sums = "auto" if ranked else method
    rule = jpda.rule(sums, max_cluster, max_events if ranked else None)
    return lambda key, log_score: rule(log_score)


def _drawn(
    max_events: int, num_sweeps: int, key: Array, log_score: Array
) -> Association:
    """Finds the marginal probabilities over the joint events that are drawn."""
    alone = jnp.zeros(1, log_score.dtype)
    found = sample_of_many(key, log_score[None], alone, max_events, num_sweeps)
    return jpda.of_events(
        log_score, found.column, found.log_weight, complete=jnp.array(False)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with the known targets."""
    driven = isinstance(params.birth, DetectionBirth)
    if not driven:
        arrivals.check(params, hides=False, recycles=False)
    elif params.undetected is not None:
        raise ValueError(
            "undetected is given and nobody is with an LMB filter; give them as start"
        )
    keys, target = jax.random.split(key, 3), settings.target
    mode_prob, size = arrivals.modes(params), settings.max_tracks
    tracks = bernoulli.nobody(target, params.target, mode_prob, size, keys[0])
    tracks = projection.begin(target, params, tracks, keys[1])
    number = (tracks.label >= 0).sum()
    if driven:
        size = settings.max_births
        none = bernoulli.nobody(target, params.target, mode_prob, size, keys[0])
        tracks = bernoulli.append(tracks, none)
    return State(tracks, number, keys[2])


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Predicts, adds births, finds the marginals, projects, keeps the likeliest."""
    target, scan = settings.target, association.filled(scan)
    keys, label = jax.random.split(state.key, 3), state.next_label
    tracks = bernoulli.predict(target, params.target, state.tracks, scan.interval)
    if not isinstance(params.birth, DetectionBirth):
        born = bernoulli.begin(target, params.target, params.birth, label, keys[0])
        tracks, label = bernoulli.append(tracks, born), label + born.label.size
    sight = association.look(settings.gating, True, target, params, tracks, scan)
    answer = settings.associate(keys[1], sight.log_score)
    tracks = projection.update(target, params.target, tracks, sight, answer, scan)
    tracks, lost = projection.keep(
        tracks, settings.max_tracks, settings.exist_threshold
    )
    following = tracks
    if isinstance(params.birth, DetectionBirth):
        births, more = bernoulli.from_unexplained(
            params.birth,
            params.target,
            scan,
            answer.unexplained_prob,
            settings.max_births,
        )
        born = bernoulli.begin(target, params.target, births, label, keys[0])
        following, label = bernoulli.append(tracks, born), label + born.label.size
        lost = lost + more
    log_evidence = answer.log_norm + sight.log_clutter.sum() - params.clutter.rate
    estimate = _report(settings, tracks, log_evidence, lost)
    return State(following, label, keys[2]), estimate


def _report(
    settings: Settings, tracks: Tracks, log_evidence: Array, dropped: Array
) -> Estimate:
    """Reports the tracks that the estimator chooses."""
    there, threshold = tracks.existence_prob, settings.report_threshold
    estimate = bernoulli.report(
        settings.target, tracks, tracks.label, threshold, log_evidence, dropped
    )
    all_of_it = jnp.ones(1, there.dtype)
    choice = estimators.choose(settings.estimator, all_of_it, there[None], threshold)
    return estimate._replace(exists=choice[1])
