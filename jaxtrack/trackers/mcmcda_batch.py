"""Markov chain Monte Carlo data association: the posterior of hypotheses by sampling.

A chain walks from hypothesis to hypothesis over a batch of scans, by the moves of
`mcmcda_moves`, and in the long run visits each as often as it is likely. Nothing is
pruned, and only the tracks that a move changes are scored again. What it costs is
time: the error falls with the root of the number of steps that are not alike, and
whether a chain has been everywhere only other chains can tell. Several are one `vmap`:

    problem = prepare(target, params, scans, key)
    walk = functools.partial(sample, target, params, problem)
    samples = jax.vmap(walk)(jax.random.split(key, 8))     # eight chains

    >>> from jaxtrack.trackers import mcmcda_batch
    >>> mcmcda_batch.Samples._fields[:3]
    ('table', 'log_weight', 'existence_prob')

Reference: Oh, Russell and Sastry, "Markov chain Monte Carlo data association for multi-
target tracking", IEEE Trans. Automatic Control 54(3), 2009.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import cardinality
from jaxtrack.trackers import mcmcda_moves, mcmcda_scores, mcmcda_table, thinning
from jaxtrack.trackers.mcmcda_scores import Problem, Scored
from jaxtrack.trackers.undetected import Params
from jaxtrack.types import Array, Target

# Birth and death, extension and reduction, update, split and merge, switch.
SHARES = 0.3, 0.2, 0.2, 0.2, 0.1


class Best(NamedTuple):
    """The likeliest hypothesis that the chain has seen.

    Attributes:
        table: Which detection of each scan its tracks have, -1 for none; rows of
            nothing else are empty, [N, T].
        log_weight: Log-density of all scans and this hypothesis.
        tracks: Its tracks, [N].
        prob: Share of the samples that have just this track, [N].
    """

    table: Array
    log_weight: Array
    tracks: Scored
    prob: Array


class Samples(NamedTuple):
    """What a chain has seen.

    Attributes:
        table: Which detection of each scan the tracks had, [S, N, T] (int).
        log_weight: Log-density of all scans and the hypothesis, [S].
        existence_prob: That the targets of these tracks are still there, [S, N].
        false_prob: Probability that a detection is false; 0 where there is none,
            [T, K].
        num_prob: Of 0, 1, 2, ... targets that are there now, undetected ones included,
            [C].
        best: The likeliest hypothesis.
        tried: How often each of `mcmcda_moves.KINDS` was possible, [8].
        accepted: Share of these that were accepted, [8].
        full: Share of the samples in which all rows were taken: those in which no
            track could begin.
        dropped: Expected number of undetected targets that found no room.
    """

    table: Array
    log_weight: Array
    existence_prob: Array
    false_prob: Array
    num_prob: Array
    best: Best
    tried: Array
    accepted: Array
    full: Array
    dropped: Array


class _Chain(NamedTuple):
    """Where a chain is: a hypothesis and its tracks' scores; the best; the counts."""

    table: Array
    log_score: Array
    existence_prob: Array
    best: Array
    best_score: Array
    tried: Array
    accepted: Array


def sample(
    target: Target,
    params: Params,
    problem: Problem,
    key: Array,
    max_tracks: int = 16,
    num_samples: int = 1000,
    burn_in: int = 200,
    thin: int = 5,
    max_targets: int = 20,
    shares: tuple[float, ...] = SHARES,
    start: Array | None = None,
) -> Samples:
    """Walks a chain.

    Args:
        target: How one target is filtered.
        params: Of the targets, births and clutter.
        problem: From `mcmcda_problem.prepare`.
        key: Random key.
        max_tracks: N; hypotheses of more tracks are left out.
        num_samples: S.
        burn_in: Samples that are forgotten before.
        thin: Steps for each sample.
        max_targets: `num_prob` goes up to here.
        shares: How often to try which pair of moves, as `SHARES`.
        start: Hypothesis to begin with, [N, T]; by default all is false.

    Raises:
        ValueError: A setting that makes no sense.
    """
    check(max_tracks, num_samples, burn_in, thin, shares)
    valid = problem.scans.valid
    if start is None:
        start = jnp.full((max_tracks, len(valid)), -1)
    log_share = _log_shares(shares)

    def step(chain: _Chain, key: Array) -> tuple[_Chain, None]:
        return _step(target, params, problem, log_share, chain, key), None

    def draw(chain: _Chain, key: Array) -> tuple[_Chain, tuple]:
        chain, _ = jax.lax.scan(step, chain, jax.random.split(key, thin))
        return chain, (chain.table, chain.log_score.sum(), chain.existence_prob)

    keys = jax.random.split(key, burn_in + num_samples)
    chain, seen = jax.lax.scan(draw, _begin(target, params, problem, start), keys)
    table, log_score, exists = jax.tree.map(lambda x: x[burn_in:], seen)
    free = jax.vmap(mcmcda_table.free, (0, None))(table, valid)
    tracks = mcmcda_scores.score_all(target, params.target, problem, chain.best)
    same = (table[:, None] == chain.best[None, :, None]).all(3).any(2)
    there = (chain.best >= 0).any(1)
    log_constant = problem.log_constant.sum()
    hidden = jnp.exp(problem.hidden.log_weight[-1]).sum()
    return Samples(
        table=table,
        log_weight=log_score + log_constant,
        existence_prob=exists,
        false_prob=free.mean(0, dtype=log_score.dtype),
        num_prob=_numbers(exists, hidden, max_targets + 1),
        best=Best(
            table=chain.best,
            log_weight=chain.best_score + log_constant,
            tracks=tracks,
            prob=jnp.where(there, same.mean(0, dtype=log_score.dtype), 0.0),
        ),
        tried=chain.tried,
        accepted=chain.accepted / jnp.maximum(chain.tried, 1),
        full=(table >= 0).any(2).all(1).mean(dtype=log_score.dtype),
        dropped=problem.dropped.sum(),
    )


def check(
    max_tracks: int, num_samples: int, burn_in: int, thin: int, shares: tuple
) -> None:
    """Raises a ValueError where settings make no sense."""
    sizes = {"max_tracks": max_tracks, "num_samples": num_samples, "thin": thin}
    thinning.check_sizes(sizes)
    if burn_in < 0:
        raise ValueError(f"burn_in is {burn_in}; give 0 or more")
    if len(shares) != len(SHARES) or min(shares) < 0 or sum(shares) <= 0:
        raise ValueError(
            f"shares is {shares}; give {len(SHARES)} numbers, none of them negative "
            "and one of them positive"
        )


def _log_shares(shares: tuple[float, ...]) -> Array:
    """Returns how often to try each kind of move, both of a pair alike, [8]."""
    birth, extension, update, split, switch = jnp.asarray(shares, float)
    both = [birth / 2] * 2 + [extension / 2] * 2 + [update] + [split / 2] * 2 + [switch]
    return jnp.log(jnp.stack(both))


def _begin(target: Target, params: Params, problem: Problem, start: Array) -> _Chain:
    scored = mcmcda_scores.score_all(target, params.target, problem, start)
    none = jnp.zeros(len(mcmcda_moves.KINDS), int)
    score = scored.log_score
    return _Chain(
        table=start,
        log_score=score,
        existence_prob=scored.existence_prob,
        best=start,
        best_score=score.sum(),
        tried=none,
        accepted=none,
    )


def _step(
    target: Target,
    params: Params,
    problem: Problem,
    log_share: Array,
    chain: _Chain,
    key: Array,
) -> _Chain:
    """Proposes a move, scores what it changes, and takes it or not."""
    keys = jax.random.split(key, 3)
    kind = jax.random.categorical(keys[0], log_share)
    move = mcmcda_moves.propose(
        keys[1], kind, chain.table, problem.scans.valid, problem.links
    )
    changed = mcmcda_scores.score_all(
        target, params.target, problem, move.table[move.changed]
    )
    score = chain.log_score.at[move.changed].set(changed.log_score)
    gain = score.sum() - chain.log_score.sum()
    log_ratio = gain + move.log_backward - move.log_forward
    luck = jnp.log(jax.random.uniform(keys[2], dtype=log_ratio.dtype))
    possible = move.possible & ~_forbidden(move.table, problem)
    taken = possible & (luck < log_ratio)
    exists = chain.existence_prob.at[move.changed].set(changed.existence_prob)

    def pick(new: Array, old: Array) -> Array:
        return jnp.where(taken, new, old)

    score, table = pick(score, chain.log_score), pick(move.table, chain.table)
    better = score.sum() > chain.best_score
    return _Chain(
        table=table,
        log_score=score,
        existence_prob=pick(exists, chain.existence_prob),
        best=jnp.where(better, table, chain.best),
        best_score=jnp.maximum(score.sum(), chain.best_score),
        tried=chain.tried.at[kind].add(possible),
        accepted=chain.accepted.at[kind].add(taken),
    )


def _forbidden(table: Array, problem: Problem) -> Array:
    """Says whether a hypothesis calls something false that is not."""
    return (mcmcda_table.free(table, problem.scans.valid) & problem.sure).any()


def _numbers(existence_prob: Array, hidden: Array, size: int) -> Array:
    """Returns the mean distribution of the number of targets over samples, [C]."""
    unseen = cardinality.poisson(hidden, size)

    def one(prob: Array) -> Array:
        known = cardinality.bernoullis(prob, size)
        return jnp.exp(cardinality.convolve(known, unseen))

    return jax.vmap(one)(existence_prob).mean(0)
