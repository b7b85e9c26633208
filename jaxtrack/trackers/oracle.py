"""Every hypothesis of a small problem, and its exact posterior: what MHT approximates.

A track is which detection of each scan a target caused; a hypothesis is a set of tracks
that share none, and what is in no track is false. The number of hypotheses grows beyond
all bounds, so this is for a few scans of a few detections: to see what a tracker lost,
and to test it.

A target appears with the births of the scans, is detected first, missed, detected
again, and dies. When it died is summed over: a track has a probability that its target
still exists, r, and is missed with probability 1 - r + r (1 - P_D). One belief a track
is exact if the target algebra can hold it: for `single`, where nothing is nonlinear and
the births of all scans look alike by the time of the first detection.

Everything is a pure function of parameters and scans, to be jitted, vmapped and
differentiated; the hypotheses follow from the numbers of detections alone and stand in
`jaxtrack.trackers.enumeration`.

    >>> from jaxtrack.trackers import oracle
    >>> oracle.Posterior._fields[:3]
    ('log_prob', 'log_evidence', 'track_prob')

Reference: Mori, Chong and Chang, "Three mathematical formalisms of multiple hypothesis
tracking", Journal of Advances in Information Fusion 14(2), 2019, equations 18 to 37
(with n!/nu^n in equation 33).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import gammaln

from jaxtrack import cardinality, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import association, bernoulli, enumeration, undetected
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.trackers.enumeration import Table
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, PyTree, Scan, Target

SURE = association.Gating(1.0, in_missed=False, counts_clutter=False)


class Counts(NamedTuple):
    """How many there are, where that is not Poisson.

    Attributes:
        targets: Log-probabilities of 0, 1, 2, ... targets, dead ones included, or None
            for Poisson. They are all there before the first scan, each distributed as
            `Params.undetected`, and the rate of births must be 0.
        false: The same of false detections in a scan, at least as many as there are
            detections, or None for Poisson; where they fall is for the clutter model.
    """

    targets: Array | None = None
    false: Array | None = None


class Posterior(NamedTuple):
    """What is known after the last scan, exactly.

    Attributes:
        log_prob: Of each hypothesis, [H].
        log_evidence: Log-density of all scans.
        track_prob: Probability that each track is true, [A].
        existence_prob: That its target is still there if it is, [A].
        belief: About that target, [A, ...].
        num_prob: Of 0, 1, 2, ... targets that are there now, [C].
        undetected: Those never detected, expected.
    """

    log_prob: Array
    log_evidence: Array
    track_prob: Array
    existence_prob: Array
    belief: PyTree
    num_prob: Array
    undetected: Undetected


class _Leaves(NamedTuple):
    """Tracks as far as the scans have come; the first is the empty one.

    Attributes:
        log_score: Against all their detections being false, [A + 1].
        tracks: [A + 1].
        undetected: Never detected.
        found: Expected number of targets that were detected.
        gone: Expected number that died without ever being detected.
        log_clutter: Log-density of all detections if they are false.
    """

    log_score: Array
    tracks: Tracks
    undetected: Undetected
    found: Array
    gone: Array
    log_clutter: Array


def posterior(
    target: Target,
    params: Params,
    scans: Sequence[Scan],
    key: Array,
    counts: Counts | None = None,
    max_targets: int = 10,
) -> Posterior:
    """Finds the posterior of every hypothesis.

    Args:
        target: How one target is filtered.
        params: Of the targets, births and clutter; `start` must be None.
        scans: Of any number of detections, each its own; slots that are not valid are
            allowed, but count among the tracks.
        key: Random key, for targets that need one.
        counts: Numbers that are not Poisson.
        max_targets: `num_prob` goes up to here.

    Raises:
        ValueError: There are too many hypotheses, or the parameters are of another
            problem.
    """
    if params.start is not None:
        raise ValueError("start is given; give targets as undetected ones, or births")
    counts = counts or Counts()
    most = max((len(scan.valid) for scan in scans), default=0)
    if counts.false is not None and counts.false.size <= most:
        raise ValueError(
            f"counts.false has {counts.false.size} numbers and a scan has {most} "
            f"detections; give at least {most + 1}"
        )
    if counts.targets is not None and params.undetected is None:
        raise ValueError(
            "counts.targets is given and undetected is None; say where they may be"
        )
    listed = enumeration.table(tuple(len(scan.valid) for scan in scans))
    leaves = _begin(target, params, key)
    before = leaves.undetected.expected
    for k, scan in enumerate(scans):
        leaves = _grow(target, params, leaves, scan, jax.random.fold_in(key, k))
    score, tracks = jax.tree.map(lambda x: x[1:], (leaves.log_score, leaves.tracks))
    log_number, later = _targets(counts.targets, leaves, before, listed, max_targets)
    member = jnp.asarray(listed.member)
    log_weight = jnp.where(member, score[None], 0.0).sum(1) + log_number
    log_weight = log_weight + _false(counts.false, params, listed, scans)
    log_prob = mixture.log_normalise(log_weight)
    prob = jnp.exp(log_prob)
    there = jnp.where(member, tracks.existence_prob[None], 0.0)
    known = jax.vmap(lambda r: cardinality.bernoullis(r, max_targets + 1))(there)
    rest = jnp.arange(max_targets + 1)[:, None] - jnp.arange(max_targets + 1)[None]
    shifted = jnp.where(rest >= 0, later[:, jnp.maximum(rest, 0)], 0.0)  # [H, C, C]
    sums = (shifted * jnp.exp(known)[:, None]).sum(2)
    return Posterior(
        log_prob=log_prob,
        log_evidence=mixture.total(log_weight) + leaves.log_clutter,
        track_prob=jnp.where(member, prob[:, None], 0.0).sum(0),
        existence_prob=tracks.existence_prob,
        belief=tracks.belief,
        num_prob=(prob[:, None] * sums).sum(0),
        undetected=leaves.undetected,
    )


def _begin(target: Target, params: Params, key: Array) -> _Leaves:
    """Returns the empty track, of a target that is not there."""
    size = 1 if params.undetected is None else len(params.undetected.rate)
    hidden = undetected.begin(target, params, size, key)
    zero = jnp.zeros((), hidden.log_weight.dtype)
    belief = jax.tree.map(lambda x: x[:1], hidden.belief)
    label = jnp.full(1, -1)
    tracks = Tracks(zero[None], belief, label, label)
    return _Leaves(zero[None], tracks, hidden, zero, zero, zero)


def _grow(
    target: Target, params: Params, leaves: _Leaves, scan: Scan, key: Array
) -> _Leaves:
    """Follows every track by a miss and by each detection, in this order."""
    keys = jax.random.split(key)
    num_before = len(leaves.undetected.log_weight)
    hidden = undetected.predict(
        target, params, leaves.undetected, scan.interval, keys[0]
    )
    survived = jnp.exp(hidden.log_weight[:num_before]).sum()
    firsts = undetected.see(target, params, hidden, scan, keys[1])
    tracks = bernoulli.predict(target, params.target, leaves.tracks, scan.interval)
    sight = association.look(SURE, True, target, params, tracks, scan)
    correct = jax.vmap(target.correct, (None, None, 0))
    hit = jax.vmap(correct, (None, 0, None))(
        params.target, sight.views, scan.detections
    )

    def follow(missed: Array, hit: Array, first: Array) -> Array:
        # The empty track, followed by a detection, is a target's first.
        hit = hit.at[0].set(first)
        both = jnp.concatenate([missed[:, None], hit], 1)
        return both.reshape(-1, *both.shape[2:])

    score = leaves.log_score[:, None] + sight.log_score
    log_score = follow(score[:, -1], score[:, :-1], firsts.log_score)
    exists = jnp.exp(sight.log_exists + sight.log_miss - sight.log_score[:, -1])
    sure = jnp.ones_like(score[:, :-1])
    label = jnp.full(log_score.size, -1)
    after = Tracks(
        existence_prob=follow(exists, sure, sure[0]),
        belief=jax.tree.map(follow, sight.missed, hit, firsts.belief),
        label=label,
        alias=label,
    )
    return _Leaves(
        log_score=log_score,
        tracks=after,
        undetected=firsts.missed,
        found=leaves.found + firsts.found,
        gone=leaves.gone + leaves.undetected.expected - survived,
        log_clutter=leaves.log_clutter + sight.log_clutter.sum(),
    )


def _targets(
    log_number: Array | None,
    leaves: _Leaves,
    before: Array,
    listed: Table,
    max_targets: int,
) -> tuple[Array, Array]:
    """Weighs each hypothesis by its number of tracks (equation 23).

    Args:
        log_number: Of 0, 1, 2, ... targets, None for Poisson.
        leaves: After the last scan.
        before: Expected number of targets before the first.
        listed: H hypotheses.
        max_targets: C - 1.

    Returns:
        [H], and the probabilities of 0, 1, 2, ... undetected targets that are there
        now, given each hypothesis, [H, C].
    """
    size = max_targets + 1
    alive = leaves.undetected.expected
    if log_number is None:
        rest = jnp.exp(cardinality.poisson(alive, size))
        num = len(listed.num_tracks)
        return jnp.broadcast_to(-leaves.found, (num,)), jnp.tile(rest, (num, 1))
    number = jnp.arange(log_number.size)
    log_hidden = safe_log(alive + leaves.gone)
    log_start = log_number + gammaln(number + 1.0) - number * safe_log(before)

    def given(num_tracks: Array) -> tuple[Array, Array]:
        rest = number - num_tracks
        some = jnp.maximum(rest, 0)
        log_rest = jnp.where(some == 0, 0.0, some * log_hidden) - gammaln(some + 1.0)
        log_weight = jnp.where(rest < 0, -jnp.inf, log_start + log_rest)
        first = jnp.roll(mixture.log_normalise(log_weight), -num_tracks)
        hidden = alive + leaves.gone
        keep = jnp.where(hidden > 0, alive / jnp.where(hidden > 0, hidden, 1.0), 0.0)
        later = jnp.exp(cardinality.thin(first, keep))
        return mixture.total(log_weight), jnp.pad(later, (0, size))[:size]

    return jax.vmap(given)(jnp.asarray(listed.num_tracks))


def _false(
    log_number: Array | None, params: Params, listed: Table, scans: Sequence[Scan]
) -> Array:
    """Weighs each hypothesis by its numbers of false detections (equation 19)."""
    rate = jnp.asarray(params.clutter.rate)
    if log_number is None:
        return -rate * listed.num_false.shape[1]
    empty = jnp.array([(~scan.valid).sum() for scan in scans])
    number = jnp.maximum(jnp.asarray(listed.num_false) - empty[None], 0)
    log_rates = jnp.where(number == 0, 0.0, number * safe_log(rate))
    log_weight = gammaln(number + 1.0) - log_rates
    return (log_number[number] + log_weight).sum(1)
