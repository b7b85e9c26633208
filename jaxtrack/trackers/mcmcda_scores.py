"""Scores of any tracks over a batch of scans, one at a time: what a chain walks on.

A track is a row that says which detection of each scan it has, -1 for none. Its score
is the log-density of these detections against that they are false, with births, deaths
and misses summed over as in `oracle`; those of all tracks of a hypothesis add up.

    >>> from jaxtrack.trackers import mcmcda_scores
    >>> mcmcda_scores.Scored._fields
    ('log_score', 'existence_prob', 'belief')

Reference: Chong, Mori and Reid, "Forty years of multiple hypothesis tracking", Journal
of Advances in Information Fusion 14(2), 2019, equations 1 to 12.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.linalg import safe_log
from jaxtrack.trackers import association, undetected
from jaxtrack.trackers.association import LEAST_LOG_WEIGHT
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, PyTree, Scan, Target

# Proposals take no link for less or more likely than this, so that none that can be is
# out of reach; it is not the scores' business.
LOG_ODDS = -6.0, 4.0


class Problem(NamedTuple):
    """Scans, and what about them is the same for all hypotheses.

    Attributes:
        scans: T scans of K slots, a slot at least.
        log_clutter: Log-density of clutter at each detection, [T, K].
        first_score: Score of a track that begins here, [T, K]; -inf where none can.
        first_exist: Probability that its target exists, [T, K].
        first_belief: About it, [T, K, ...].
        anyone: Some belief, for where there is no track.
        links: Log-odds with which proposals follow a detection by a later one against
            none in its scan, [T K, T, K].
        log_constant: Log-density of all scans with every detection false, and of no
            first detection.
        hidden: Targets never detected, after the last scan.
        dropped: Expected number of those that found no room.
    """

    scans: Scan
    log_clutter: Array
    first_score: Array
    first_exist: Array
    first_belief: PyTree
    anyone: PyTree
    links: Array
    log_constant: Array
    hidden: Undetected
    dropped: Array


class Scored(NamedTuple):
    """What is known of a track after the last scan.

    Attributes:
        log_score: 0 for an empty row.
        existence_prob: That its target is still there; 0 for an empty row.
        belief: About that target.
    """

    log_score: Array
    existence_prob: Array
    belief: PyTree


def prepare(
    target: Target, params: Params, scans: Scan, key: Array, max_undetected: int = 16
) -> Problem:
    """Works out what all hypotheses share.

    Args:
        target: How one target is filtered.
        params: Of the targets, births and clutter; `start` must be None.
        scans: T scans of K slots.
        key: Random key, for targets that need one.
        max_undetected: Components kept of the intensity of undetected targets.

    Raises:
        ValueError: There is a `start`, or no room for the undetected ones.
    """
    if params.start is not None:
        raise ValueError("start is given; give targets as undetected ones, or births")
    if max_undetected < 1:
        raise ValueError(f"max_undetected is {max_undetected}; give at least 1")
    scans = jax.vmap(association.filled)(scans)
    keys = jax.random.split(key)
    hidden = undetected.begin(target, params, max_undetected, keys[0])
    anyone = jax.tree.map(lambda x: x[0], hidden.belief)

    def step(hidden: Undetected, given: tuple[Scan, Array]) -> tuple[Undetected, tuple]:
        scan, key = given
        one, two = jax.random.split(key)
        hidden = undetected.predict(target, params, hidden, scan.interval, one)
        firsts = undetected.see(target, params, hidden, scan, two)
        kept, lost = undetected.reduce(firsts.missed, max_undetected)
        return kept, (firsts.log_score, firsts.belief, firsts.found, lost)

    seeds = jax.random.split(keys[1], len(scans.interval))
    hidden, firsts = jax.lax.scan(step, hidden, (scans, seeds))
    log_score, belief, found, lost = firsts
    clutter = jax.vmap(jax.vmap(params.clutter.log_density))(scans.detections)
    log_clutter = jnp.maximum(clutter, LEAST_LOG_WEIGHT)
    false = jnp.where(scans.valid, log_clutter, 0.0).sum()
    problem = Problem(
        scans=scans,
        log_clutter=log_clutter,
        first_score=log_score,
        first_exist=jnp.ones_like(log_score),
        first_belief=belief,
        anyone=anyone,
        links=jnp.zeros(()),
        log_constant=false - found.sum() - params.clutter.rate * len(scans.interval),
        hidden=hidden,
        dropped=lost.sum(),
    )
    return problem._replace(links=_links(target, params.target, problem))


def score(target: Target, params: Any, problem: Problem, row: Array) -> Scored:
    """Scores a track.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        problem: T scans.
        row: Which detection of each scan, -1 for none, [T].
    """

    def step(now: tuple[Scored, Array], given: tuple) -> tuple[tuple, None]:
        (before, begun), (scan, log_clutter, first, column) = now, given
        hit, at = column >= 0, jnp.maximum(column, 0)
        detection = scan.detections[at]
        exists, missed, view = _await(target, params, before, scan.interval)
        seen = target.score(params, view, detection[None])[0] - log_clutter[at]
        again = Scored(
            before.log_score + exists.log_hit + seen,
            jnp.ones_like(seen),
            target.correct(params, view, detection),
        )
        never = Scored(before.log_score + exists.log_none, exists.prob, missed)
        start = jax.tree.map(lambda x: x[at], first)
        later, none = _choose(hit, again, never), before
        return (
            _choose(begun, later, _choose(hit, Scored(*start), none)),
            begun | hit,
        ), None

    zero = jnp.zeros_like(problem.first_score[0, 0])
    firsts = problem.first_score, problem.first_exist, problem.first_belief
    given = problem.scans, problem.log_clutter, firsts, row
    nobody = Scored(zero, zero, problem.anyone)
    return jax.lax.scan(step, (nobody, jnp.array(False)), given)[0][0]


class _Awaited(NamedTuple):
    """Log-weights of a detection's and of no detection's coming, and r after none."""

    log_hit: Array
    log_none: Array
    prob: Array


def _await(
    target: Target, params: Any, before: Scored, interval: Array
) -> tuple[_Awaited, PyTree, PyTree]:
    """Predicts a track; returns its belief if missed and the sensor's view, too."""
    belief, log_survive = target.predict(params, before.belief, interval)
    log_exists = safe_log(before.existence_prob * jnp.exp(log_survive))
    missed, log_miss = target.miss(params, belief)
    log_miss = jnp.maximum(log_miss, LEAST_LOG_WEIGHT)
    none = association.log_absent_or_missed(log_exists, log_miss)
    prob = jnp.exp(log_exists + log_miss - none)
    view = target.look(params, belief)
    return _Awaited(log_exists, none, prob), missed, view


def _choose(which: Array, yes: PyTree, no: PyTree) -> PyTree:
    return jax.tree.map(lambda x, y: jnp.where(which, x, y), yes, no)


def _links(target: Target, params: Any, problem: Problem) -> Array:
    """Returns how likely each detection is the next of a track that begins at another.

    A track of one detection, missed until the scan of the other; [T K, T, K].
    """
    num_scans, size = problem.scans.valid.shape

    def follow(source: Array) -> Array:
        begin = source // size

        def step(now: Scored, given: tuple) -> tuple[Scored, Array]:
            index, scan, log_clutter = given
            exists, missed, view = _await(target, params, now, scan.interval)
            seen = target.score(params, view, scan.detections) - log_clutter
            odds = jnp.clip(exists.log_hit - exists.log_none + seen, *LOG_ODDS)
            never = Scored(now.log_score, exists.prob, missed)
            return _choose(index > begin, never, now), odds

        def at(x: Array) -> Array:
            return x.reshape(-1, *x.shape[2:])[source]

        known = jax.tree.map(at, (problem.first_exist, problem.first_belief))
        start = Scored(jnp.zeros_like(known[0]), *known)
        given = jnp.arange(num_scans), problem.scans, problem.log_clutter
        return jax.lax.scan(step, start, given)[1]

    return jax.vmap(follow)(jnp.arange(num_scans * size))
