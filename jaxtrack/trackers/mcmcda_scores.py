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
from jaxtrack.trackers import association
from jaxtrack.trackers.association import LEAST_LOG_WEIGHT
from jaxtrack.trackers.undetected import Undetected
from jaxtrack.types import Array, PyTree, Scan, Target


class Problem(NamedTuple):
    """Scans, and what about them is the same for all hypotheses.

    Attributes:
        scans: T scans of K slots, a slot at least.
        looked: Whether anybody looked for detections, [T] (bool). Where not, nothing
            moves and nothing is missed.
        sure: Which detections are certainly not false, [T, K] (bool).
        log_clutter: Log-density of clutter at each detection, [T, K].
        first_score: Score of a track that begins here, [T, K]; -inf where none can.
        first_exist: Probability that its target exists, [T, K].
        first_belief: About it, [T, K, ...].
        anyone: Some belief, for where there is no track.
        links: Log-odds with which proposals follow a detection by a later one against
            none in its scan, [T K, T, K].
        log_constant: Log-density of each scan with every detection false, and of no
            first detection, [T].
        hidden: Targets never detected, after each scan, [T, U, ...].
        dropped: Expected number of those that found no room, [T].
    """

    scans: Scan
    looked: Array
    sure: Array
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


def head(problem: Problem, num_scans: int) -> Problem:
    """Returns the problem of the first scans alone."""
    shared = {"anyone": problem.anyone, "links": problem.links}
    bare = problem._replace(anyone=None, links=None)
    return jax.tree.map(lambda x: x[:num_scans], bare)._replace(**shared)


def score(target: Target, params: Any, problem: Problem, row: Array) -> Scored:
    """Scores a track.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        problem: T scans.
        row: Which detection of each scan, -1 for none, [T].
    """

    def step(now: tuple[Scored, Array], given: tuple) -> tuple[tuple, None]:
        (before, begun), (scan, looked, log_clutter, first, column) = now, given
        hit, at = column >= 0, jnp.maximum(column, 0)
        detection = scan.detections[at]
        exists, missed, view = wait(target, params, before, scan.interval)
        seen = target.score(params, view, detection[None])[0] - log_clutter[at]
        again = Scored(
            before.log_score + exists.log_hit + seen,
            jnp.ones_like(seen),
            target.correct(params, view, detection),
        )
        never = Scored(before.log_score + exists.log_none, exists.prob, missed)
        start = jax.tree.map(lambda x: x[at], first)
        later = choose(looked, choose(hit, again, never), before)
        new = choose(hit, Scored(*start), before)
        return (choose(begun, later, new), begun | hit), None

    zero = jnp.zeros_like(problem.first_score[0, 0])
    firsts = problem.first_score, problem.first_exist, problem.first_belief
    given = problem.scans, problem.looked, problem.log_clutter, firsts, row
    nobody = Scored(zero, zero, problem.anyone)
    return jax.lax.scan(step, (nobody, jnp.array(False)), given)[0][0]


class Awaited(NamedTuple):
    """What a track expects of a scan.

    Attributes:
        log_hit: Log-probability that it is there to be detected.
        log_none: That it is not detected, there or not.
        prob: That it is there, if it is not detected.
    """

    log_hit: Array
    log_none: Array
    prob: Array


def wait(
    target: Target, params: Any, before: Scored, interval: Array
) -> tuple[Awaited, PyTree, PyTree]:
    """Predicts a track.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        before: The track after the last scan.
        interval: Seconds since.

    Returns:
        What it expects, its belief if missed, and how the sensor sees it.
    """
    belief, log_survive = target.predict(params, before.belief, interval)
    log_exists = safe_log(before.existence_prob * jnp.exp(log_survive))
    missed, log_miss = target.miss(params, belief)
    log_miss = jnp.maximum(log_miss, LEAST_LOG_WEIGHT)
    none = association.log_absent_or_missed(log_exists, log_miss)
    prob = jnp.exp(log_exists + log_miss - none)
    view = target.look(params, belief)
    return Awaited(log_exists, none, prob), missed, view


def choose(which: Array, yes: PyTree, no: PyTree) -> PyTree:
    """Returns one of two trees, all of it."""
    return jax.tree.map(lambda x, y: jnp.where(which, x, y), yes, no)


def score_all(target: Target, params: Any, problem: Problem, table: Array) -> Scored:
    """Scores the tracks of a hypothesis, [N, T]."""
    each = jax.vmap(score, (None, None, None, 0))
    return each(target, params, problem, table)
