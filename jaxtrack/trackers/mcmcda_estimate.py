"""What a chain's samples tell of the tracks in a sliding window.

>>> import jax.numpy as jnp
>>> from jaxtrack.trackers import mcmcda_estimate
>>> names = jnp.array([[7, -1], [8, 9]])  # a known track, then two detections
>>> table = jnp.array([[0, 1], [-1, 0], [-1, -1]])
>>> print(mcmcda_estimate.called(names, table))
[ 7  8 -1]

Reference: Oh, Russell and Sastry, "Markov chain Monte Carlo data association for multi-
target tracking", IEEE Trans. Automatic Control 54(3), 2009.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import mixture
from jaxtrack.trackers.bernoulli import Estimate
from jaxtrack.trackers.mcmcda_batch import Samples
from jaxtrack.trackers.mcmcda_scores import Problem
from jaxtrack.types import Array, Target


def report(
    target: Target, threshold: float, samples: Samples, problem: Problem, names: Array
) -> Estimate:
    """Tells of the tracks of the best hypothesis, and how likely the samples have them.

    Args:
        target: How one target is filtered.
        threshold: Tracks that exist with more probability are reported.
        samples: Of a chain.
        problem: What it walked on.
        names: From `names`.

    Returns:
        All but `log_evidence` and `dropped`, which are 0.
    """
    tracks = samples.best.tracks
    label = called(names, samples.best.table)
    every = jax.vmap(called, (None, 0))(names, samples.table)  # [S, N]
    exists = samples.existence_prob
    mine = every[:, :, None] == label[None, None]
    prob = jnp.where(mine, exists[:, :, None], 0.0).sum(1).mean(0)
    number, hidden = exists.sum(1), jnp.exp(problem.hidden.log_weight[-1]).sum()
    moments = jax.vmap(target.moments)(tracks.belief)
    return Estimate(
        mean=moments.mean,
        cov=moments.cov,
        label=label,
        exists=(label >= 0) & (tracks.existence_prob > threshold),
        existence_prob=jnp.where(label >= 0, prob, 0.0),
        mode_prob=jax.vmap(target.modes)(tracks.belief),
        effective_size=jax.vmap(target.effective_size)(tracks.belief),
        num_mean=number.mean() + hidden,
        num_var=number.var() + (exists * (1 - exists)).sum(1).mean() + hidden,
        log_evidence=jnp.zeros_like(hidden),
        dropped=jnp.zeros_like(hidden),
    )


def names(problem: Problem, known: Array, label: Array) -> Array:
    """Returns what a track is called that begins here, [T, K], for `go_on`'s problem.

    Args:
        problem: T scans of K slots, the first of which are known tracks.
        known: Their labels, [N].
        label: Of a track that begins with a detection, [T - 1, any number].
    """
    size = problem.scans.valid.shape[1]

    def wide(x: Array) -> Array:
        short = size - x.shape[-1]
        return jnp.pad(x, (*[(0, 0)] * (x.ndim - 1), (0, short)), constant_values=-1)

    return jnp.concatenate([wide(known)[None], wide(label)])


def called(names: Array, table: Array) -> Array:
    """Returns the label of each track of a hypothesis, -1 for none, [N].

    Args:
        names: From `names`, [T, K].
        table: [N, T].
    """
    first = jnp.argmax(table >= 0, axis=1)
    column = table[jnp.arange(len(table)), first]
    return jnp.where(column >= 0, names[first, jnp.maximum(column, 0)], -1)


def log_share(samples: Samples, num_scans: int) -> Array:
    """Returns the log-probability of the best hypothesis among all that were found.

    Args:
        samples: S of them; each hypothesis counts once, with its weight.
        num_scans: Only those count that agree with the best one in so many first scans.
    """
    best = samples.best
    table = jnp.concatenate([best.table[None], samples.table])
    log_weight = jnp.append(best.log_weight, samples.log_weight)
    early = jax.vmap(_fingerprint)(table[:, :, :num_scans])
    whole = jax.vmap(_fingerprint)(table)
    order = jnp.argsort(whole)
    again = jnp.diff(whole[order], prepend=whole[order[:1]] + 1) == 0
    counts = (early == early[0])[order] & ~again
    total = mixture.total(jnp.where(counts, log_weight[order], -jnp.inf))
    return best.log_weight - total


def _fingerprint(table: Array) -> Array:
    """Returns a number that is the same for the same tracks in other rows [N, T]."""
    factor = np.random.default_rng(0).integers(1, 2**32, table.shape[1], np.uint32)
    number = ((table + 1).astype(jnp.uint32) * factor[None]).sum(1, dtype=jnp.uint32)
    for _ in range(2):
        number = (number ^ (number >> 16)) * np.uint32(0x45D9F3B)
    number = number ^ (number >> 16)
    some = (table >= 0).any(1)
    return jnp.where(some, number, np.uint32(0)).sum(dtype=jnp.uint32)
