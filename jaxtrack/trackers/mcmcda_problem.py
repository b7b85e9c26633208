"""The scans that a chain walks on: what is the same for all hypotheses about them.

    problem = prepare(target, params, scans, key)       # from births alone
    problem = go_on(target, params, window, hidden, known, key)    # from tracks, too

    >>> from jaxtrack.trackers import mcmcda_problem
    >>> mcmcda_problem.LOG_ODDS
    (-6.0, 4.0)

Reference: Oh, Russell and Sastry, "Markov chain Monte Carlo data association for multi-
target tracking", IEEE Trans. Automatic Control 54(3), 2009; the links are its
neighbours with a likelihood.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack.trackers import association, undetected
from jaxtrack.trackers.association import LEAST_LOG_WEIGHT
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.trackers.mcmcda_scores import Problem, Scored, choose, wait
from jaxtrack.trackers.recent import Recent
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, Scan, Target

# Proposals take no link for less or more likely than this, so that none that can be is
# out of reach; it is not the scores' business.
LOG_ODDS = -6.0, 4.0


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
    keys = jax.random.split(key)
    hidden = undetected.begin(target, params, max_undetected, keys[0])
    window = Recent(scans, jnp.ones(len(scans.interval), bool))
    problem = _collect(target, params, window, hidden, keys[1])
    return problem._replace(links=_links(target, params.target, problem))


def go_on(
    target: Target,
    params: Params,
    window: Recent,
    hidden: Undetected,
    known: Tracks,
    key: Array,
) -> Problem:
    """Works out what all hypotheses share that go on from known tracks.

    Args:
        target: How one target is filtered.
        params: Of the targets, births and clutter.
        window: T - 1 scans.
        hidden: Targets never detected before them, U.
        known: N tracks before them.
        key: Random key, for targets that need one.

    Returns:
        The problem of T scans, in the first of which the N tracks are the detections.
    """
    rest = _collect(target, params, window, hidden, key)
    there = known.existence_prob > 0
    size = max(rest.scans.valid.shape[1], len(there))
    zero = jnp.zeros_like(rest.log_clutter[0, 0])
    blank = jnp.zeros((len(there), rest.scans.detections.shape[2]))
    first = Problem(
        scans=Scan(blank, there, zero),
        looked=jnp.array(False),
        sure=there,
        log_clutter=jnp.zeros_like(known.existence_prob),
        first_score=jnp.where(there, 0.0, -jnp.inf),
        first_exist=known.existence_prob,
        first_belief=known.belief,
        anyone=rest.anyone,
        links=rest.links,
        log_constant=zero,
        hidden=hidden,
        dropped=zero,
    )

    def wide(problem: Problem, axis: int) -> Problem:
        def one(x: Array) -> Array:
            index = jnp.minimum(jnp.arange(size), x.shape[axis] - 1)
            return jnp.take(x, index, axis)

        scans, kept = problem.scans, jnp.arange(size) < problem.sure.shape[axis]
        valid = one(scans.valid) & (kept[None] if axis else kept)
        scans = scans._replace(detections=one(scans.detections), valid=valid)
        names = "sure", "log_clutter", "first_score", "first_exist", "first_belief"
        wider = {name: jax.tree.map(one, getattr(problem, name)) for name in names}
        return problem._replace(scans=scans, **wider)

    shared = {"anyone": None, "links": None}
    both = [wide(x._replace(**shared), axis) for axis, x in enumerate((first, rest))]
    joined = jax.tree.map(
        lambda x, y: jnp.concatenate([x[None].astype(y.dtype), y]), *both
    )
    problem = joined._replace(anyone=rest.anyone)
    return problem._replace(links=_links(target, params.target, problem))


def _collect(
    target: Target, params: Params, window: Recent, hidden: Undetected, key: Array
) -> Problem:
    """Works out all but the links."""
    scans, size = jax.vmap(association.filled)(window.scans), len(hidden.log_weight)
    anyone = jax.tree.map(lambda x: x[0], hidden.belief)

    def step(before: Undetected, given: tuple) -> tuple[Undetected, tuple]:
        scan, looked, key = given
        one, two = jax.random.split(key)
        hidden = undetected.predict(target, params, before, scan.interval, one)
        firsts = undetected.see(target, params, hidden, scan, two)
        kept, lost = undetected.reduce(firsts.missed, size)
        after = choose(looked, kept, before)
        found, lost = jnp.where(looked, firsts.found, 0.0), jnp.where(looked, lost, 0.0)
        return after, (after, firsts.log_score, firsts.belief, found, lost)

    seeds = jax.random.split(key, len(scans.interval))
    after, log_score, belief, found, lost = jax.lax.scan(
        step, hidden, (scans, window.looked, seeds)
    )[1]
    clutter = jax.vmap(jax.vmap(params.clutter.log_density))(scans.detections)
    log_clutter = jnp.maximum(clutter, LEAST_LOG_WEIGHT)
    false = jnp.where(scans.valid, log_clutter, 0.0).sum(1)
    return Problem(
        scans=scans,
        looked=window.looked,
        sure=jnp.zeros_like(scans.valid),
        log_clutter=log_clutter,
        first_score=log_score,
        first_exist=jnp.ones_like(log_score),
        first_belief=belief,
        anyone=anyone,
        links=jnp.zeros(()),
        log_constant=false - found - jnp.where(window.looked, params.clutter.rate, 0.0),
        hidden=after,
        dropped=lost,
    )


def _links(target: Target, params: Any, problem: Problem) -> Array:
    """Returns how likely each detection is the next of a track that begins at another.

    A track of one detection, missed until the scan of the other; [T K, T, K].
    """
    num_scans, size = problem.scans.valid.shape

    def follow(source: Array) -> Array:
        begin = source // size

        def step(now: Scored, given: tuple) -> tuple[Scored, Array]:
            index, scan, looked, log_clutter = given
            exists, missed, view = wait(target, params, now, scan.interval)
            seen = target.score(params, view, scan.detections) - log_clutter
            odds = jnp.clip(exists.log_hit - exists.log_none + seen, *LOG_ODDS)
            never = Scored(now.log_score, exists.prob, missed)
            return choose(looked & (index > begin), never, now), odds

        def at(x: Array) -> Array:
            return x.reshape(-1, *x.shape[2:])[source]

        known = jax.tree.map(at, (problem.first_exist, problem.first_belief))
        start = Scored(jnp.zeros_like(known[0]), *known)
        index = jnp.arange(num_scans)
        given = index, problem.scans, problem.looked, problem.log_clutter
        return jax.lax.scan(step, start, given)[1]

    return jax.vmap(follow)(jnp.arange(num_scans * size))
