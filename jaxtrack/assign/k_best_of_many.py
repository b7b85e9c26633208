"""The k best joint events over many problems at once: the children of all hypotheses.

Every hypothesis has a matrix of its own for the same detections, and a weight; wanted
are the heaviest pairs of a hypothesis and a joint event. A hypothesis has as many among
them as it is worth, which no fixed share of k would tell.

Tracks choose one after another, and so many partial events are kept: those that could
still come to the most at given prices of the detections, by what their tracks have
after paying and what the tracks to come have at most. With the prices that prove a
problem's best event to be the best, that is nearly what they do come to. `log_lost`
says what no event exceeds that was left out on the way, so that all above it are known
to be the best; with room for all joint events nothing is left out.

Murty's partition of each problem, as `k_best` has it, finds the same by k searches for
every track of every problem; here each problem is solved but once.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack.assign import k_best_of_many
    >>> two = jnp.array([[[5.0, 2.0, 0.0]], [[1.0, 4.0, 0.0]]])
    >>> found = jax.jit(k_best_of_many.k_best_of_many, static_argnums=2)(
    ...     two, jnp.array([0.0, 0.5]), 3)
    >>> print(found.log_weight, found.problem, found.column[:, 0])
    [5.  4.5 2. ] [0 1 0] [0 1 1]

References: Murty, "An algorithm for ranking all the assignments in order of increasing
cost", Operations Research 16(3), 1968, for the problem; Lawler, "A procedure for
computing the K best solutions to discrete optimization problems", Management Science
18(7), 1972, for bounds by dual prices.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.assign.best import best
from jaxtrack.types import Array


class Found(NamedTuple):
    """The k heaviest pairs of a problem and a joint event, heaviest first.

    Attributes:
        log_weight: Of the problem and the chosen scores, [k]; -inf where there are not
            so many.
        problem: [k] (int).
        column: Of each track, [k, N] (int).
        log_lost: What nothing exceeds that is not among them, up to rounding in
            float32; -inf where nothing was left out.
        log_left: About how much was left out, all told: the best that could have come
            of each partial event that was.
    """

    log_weight: Array
    problem: Array
    column: Array
    log_lost: Array
    log_left: Array


class _Partial(NamedTuple):
    """B partial events.

    Attributes:
        rank: What they can come to at most, [B].
        problem: [B].
        free: Which detections nobody has, [B, K] (bool).
        lost: What none exceeds that was left out.
        left: Their sum, log-scale.
    """

    rank: Array
    problem: Array
    free: Array
    lost: Array
    left: Array


def k_best_of_many(
    log_score: Array, log_weight: Array, k: int, width: int | None = None, ways: int = 1
) -> Found:
    """Finds the k heaviest pairs of a problem and a joint event.

    Those that differ by no more than rounding in float32 may stand in for each other at
    the end of the list. The gradients of `log_score` and `log_weight` are those of the
    chosen ones.

    Args:
        log_score: [H, N, K + W], -inf where impossible; the last W columns are ways of
            having no detection, and any number of tracks may have them.
        log_weight: Of the problems, [H]; -inf for none.
        k: How many.
        width: B, partial events that are kept; twice k if None.
        ways: W.

    Raises:
        ValueError: A number is not positive.
    """
    if min(k, ways) < 1:
        raise ValueError(f"k is {k} and ways is {ways}; give at least 1")
    width = max(k, width or 2 * k)
    # XLA on CPU finds the best of many in float32 only without sorting them all.
    fixed, begin = jax.lax.stop_gradient((log_score, log_weight))
    fixed, begin = fixed.astype(jnp.float32), begin.astype(jnp.float32)
    num = log_score.shape[2] - ways
    price = jax.vmap(_price, (0, None))(fixed, num)
    paid = fixed - jnp.pad(price, ((0, 0), (0, ways)))[:, None]
    gain = paid.max(2)  # [H, N]
    rank, problem, *left = _keep(begin + gain.sum(1) + price.sum(1), width)
    partial = _Partial(rank, problem, jnp.ones((width, num), bool), *left)
    own = jnp.where(gain > -jnp.inf, gain, 0.0)
    loss = jnp.moveaxis(own[..., None] - paid, 1, 0)  # [N, H, K + W]
    partial, steps = jax.lax.scan(_choose, partial, loss)
    unpaid = jnp.where(partial.free, price[partial.problem], 0.0).sum(1)
    rank, kept, lost, left = _keep(partial.rank - unpaid, k)
    problem, column = partial.problem[kept], _trace(*steps, kept)
    there = rank > -jnp.inf
    track = jnp.arange(log_score.shape[1])[None]
    chosen = log_score[problem[:, None], track, column]
    total = jnp.where(there[:, None], chosen, 0.0).sum(1)
    total = total + jnp.where(there, log_weight[problem], -jnp.inf)
    total, order = jax.lax.top_k(total, k)
    log_lost = jnp.maximum(partial.lost, lost).astype(total.dtype)
    log_left = jnp.logaddexp(partial.left, left).astype(total.dtype)
    return Found(total, problem[order], column[order], log_lost, log_left)


def _price(log_score: Array, num: int) -> Array:
    """Returns prices of the detections, by the best event of a problem, [K]."""
    none = log_score[:, num:].max(1, keepdims=True)
    found = best(jnp.concatenate([log_score[:, :num], none], 1))
    return jnp.where(found.feasible, found.detection_price, 0.0)


def _keep(rank: Array, size: int) -> tuple[Array, Array, Array, Array]:
    """Keeps the highest ranks.

    Returns:
        These, whose they are, and the highest and the log of the sum of the others.
    """
    if (short := size - rank.size) > 0:
        rank = jnp.pad(rank, (0, short), constant_values=-jnp.inf)
        at = jnp.minimum(jnp.arange(size), size - short - 1)
        none = jnp.full((), -jnp.inf, rank.dtype)
        return rank, at, none, none
    kept, at = jax.lax.top_k(rank, size)
    others = rank.at[at].set(-jnp.inf)
    return kept, at, others.max(), mixture.total(others)


def _choose(partial: _Partial, loss: Array) -> tuple[_Partial, tuple[Array, Array]]:
    """Has the next track choose; returns from which partial event, and its column.

    Args:
        partial: B partial events.
        loss: What it loses by each column in each problem, [H, K + W].
    """
    width, num = partial.free.shape
    ways = loss.shape[1] - num
    free = jnp.pad(partial.free, ((0, 0), (0, ways)), constant_values=True)
    ahead = partial.rank[:, None] - loss[partial.problem]
    rank, at, lost, left = _keep(jnp.where(free, ahead, -jnp.inf).ravel(), width)
    source, column = jnp.divmod(at, loss.shape[1])
    taken = column[:, None] == jnp.arange(num)[None]
    chosen = _Partial(
        rank=rank,
        problem=partial.problem[source],
        free=partial.free[source] & ~taken,
        lost=jnp.maximum(partial.lost, lost),
        left=jnp.logaddexp(partial.left, left),
    )
    return chosen, (source, column)


def _trace(source: Array, column: Array, kept: Array) -> Array:
    """Returns the columns of some events [k], from what tracks chose, [N, B]."""

    def back(at: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        source, column = step
        return source[at], column[at]

    return jax.lax.scan(back, kept, (source, column), reverse=True)[1].T
