"""Heavy joint events of many problems at once, found by Gibbs sampling.

As `k_best_of_many`, but for what a walk does not come to and what it says of the rest:
chains are shared out among the problems, each draws the columns of its tracks one after
another, and of all the events that any chain has been at the heaviest are kept, each
once. The work grows with the tracks and the detections only as fast as their product.

Chains are shared out by the square roots of the weights, so that light problems have
more than their weights' share, and begin where nobody has a detection, which counts
only where a chain comes back to it.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack.assign import sample_of_many
    >>> two = jnp.array([[[5.0, 2.0, 0.0]], [[1.0, 4.0, 0.0]]])
    >>> found = jax.jit(sample_of_many.sample_of_many, static_argnums=(3, 4))(
    ...     jax.random.key(0), two, jnp.array([0.0, 0.5]), 3, 20)
    >>> print(found.log_weight, found.problem, found.column[:, 0])
    [5.  4.5 2. ] [0 1 0] [0 1 1]

Reference: Vo, Vo and Hoang, "An efficient implementation of the generalized labeled
multi-Bernoulli filter", IEEE Trans. Signal Processing 65(8), 2017, section III.
"""

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.assign.k_best_of_many import Found
from jaxtrack.assign.sample import walk
from jaxtrack.resampling import systematic_index
from jaxtrack.types import Array


def sample_of_many(
    key: Array,
    log_score: Array,
    log_weight: Array,
    k: int,
    num_sweeps: int,
    ways: int = 1,
) -> Found:
    """Finds k heavy pairs of a problem and a joint event.

    The gradients of `log_score` and `log_weight` are those of the chosen ones.

    Args:
        key: Random key.
        log_score: [H, N, K + W], -inf where impossible; the last W columns are ways of
            having no detection, and any number of tracks may have them. Every track
            must have one that is possible.
        log_weight: Of the problems, [H]; -inf for none.
        k: How many, and how many chains.
        num_sweeps: Events that a chain comes to.
        ways: W.

    Returns:
        The heaviest that were found. `log_lost` is what no event exceeds, by the best
        of each track by itself; `log_left` has what was found and not kept, and the
        problems without a chain, and nothing for what no chain came to.

    Raises:
        ValueError: A number is not positive.
    """
    if min(k, num_sweeps, ways) < 1:
        raise ValueError(
            f"k is {k}, num_sweeps is {num_sweeps} and ways is {ways}; give at least 1"
        )
    fixed, begin = jax.lax.stop_gradient((log_score, log_weight))
    num, tracks = log_score.shape[2] - ways, jnp.arange(log_score.shape[1])
    share_key, hash_key, walk_key = jax.random.split(key, 3)
    chain = systematic_index(share_key, begin.astype(jnp.float32) / 2, k, k)  # [k]
    start = jnp.full(tracks.size, num)
    column = jax.vmap(lambda key, scores: walk(key, scores, num_sweeps, start, ways))(
        jax.random.split(walk_key, k), fixed.astype(jnp.float32)[chain]
    ).reshape(-1, tracks.size)  # [k S, N]
    problem = jnp.repeat(chain, num_sweeps)
    rank = fixed[problem[:, None], tracks[None], column].sum(1) + begin[problem]
    rank = jnp.where(_again(hash_key, problem, column), -jnp.inf, rank)
    # XLA on CPU finds the best of many in float32 only without sorting them all.
    kept = jax.lax.top_k(rank.astype(jnp.float32), k)[1]
    left = rank.at[kept].set(-jnp.inf)
    there, problem, column = rank[kept] > -jnp.inf, problem[kept], column[kept]
    chosen = log_score[problem[:, None], tracks[None], column]
    total = jnp.where(there[:, None], chosen, 0.0).sum(1)
    total = total + jnp.where(there, log_weight[problem], -jnp.inf)
    total, order = jax.lax.top_k(total, k)
    alone = begin.at[chain].set(-jnp.inf) + jax.nn.logsumexp(fixed, axis=2).sum(1)
    return Found(
        log_weight=total,
        problem=problem[order],
        column=column[order],
        log_lost=(begin + fixed.max(2).sum(1)).max(),
        log_left=mixture.total(jnp.append(left, alone)),
    )


def _again(key: Array, problem: Array, column: Array) -> Array:
    """Tells which pairs of a problem and an event were there before, [M] (bool).

    Equal ones are neighbours if sorted by numbers that are random, and hardly ever
    equal where the pairs are not.
    """
    both = jnp.concatenate([problem[:, None], column], axis=1).astype(jnp.uint32)
    factor = jax.random.bits(key, (2, both.shape[1]), jnp.uint32) | 1
    # A product alone would tell pairs apart no better than their sums.
    mixed = both[None] * factor[:, None]
    mixed = (mixed ^ (mixed >> 15)) * jnp.uint32(0x2C1B3C6D)
    numbers = (mixed ^ (mixed >> 12)).sum(2, dtype=jnp.uint32)  # [2, M]
    place = jnp.arange(len(both))
    *_, order = jax.lax.sort((*numbers, place), num_keys=2)
    some = both[order]
    same = jnp.append(False, (some[1:] == some[:-1]).all(1))
    return jnp.zeros(len(both), bool).at[order].set(same)
