"""The k best joint events, best first, each once.

Murty's partition: all joint events but the best fall into disjoint parts, one for each
track: the tracks before it are as in the best event, it is not, those after it are
free. The best events of the parts wait in a queue of k places; whichever is the best of
them comes next, and its part is cut up in the same way.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import k_best
    >>> log_score = jnp.array([[5.0, 2.0, 0.0], [4.0, -2.0, 0.0]])
    >>> found = k_best.k_best(log_score, k=3)
    >>> print(found.log_score)
    [6. 5. 4.]
    >>> print(found.column.tolist())
    [[1, 0], [0, 2], [2, 0]]

References: Murty, "An algorithm for ranking all the assignments in order of increasing
cost", Operations Research 16(3), 1968; Cox and Hingorani, "An efficient implementation
of Reid's multiple hypothesis tracking algorithm", IEEE Trans. Pattern Analysis and
Machine Intelligence 18(2), 1996.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign import detours
from jaxtrack.assign.best import best
from jaxtrack.types import Array

NEARLY = 100.0  # rounding errors of a sum


class KBest(NamedTuple):
    """The k joint events of most weight, best first.

    Attributes:
        column: Of each track, [k, N] (int): 0 to K - 1 the detection, K the miss.
        log_score: Sum of the chosen scores, [k]; -inf where not `feasible`.
        feasible: Whether there are so many joint events, [k] (bool); where there are
            not, `column` means nothing.
    """

    column: Array
    log_score: Array
    feasible: Array


class _Queue(NamedTuple):
    """Parts that wait to be cut up, with their best events, best first.

    Attributes:
        column: [k, N].
        price: Prices of the detections in that event, see `detours.Event`, [k, K].
        log_score: [k].
        pivot: The first track that is not fixed, [k].
        barred: Columns that the pivot may not take, [k, K + 1] (bool).
    """

    column: Array
    price: Array
    log_score: Array
    pivot: Array
    barred: Array


def k_best(log_score: Array, k: int) -> KBest:
    """Finds the k joint events with the largest sums of scores, exactly.

    Events of equal weight come in an order that is always the same. The gradient of
    `log_score` is that of the chosen scores. The work is that of `best` and k N short
    searches, N of them side by side (see `jaxtrack.assign.detours`).

    Args:
        log_score: [N, K + 1], the miss last, -inf where impossible.
        k: How many.

    Raises:
        ValueError: k is not positive.
    """
    if k < 1:
        raise ValueError(f"k is {k}; give at least 1")
    num_tracks, num_columns = log_score.shape
    fixed = jax.lax.stop_gradient(log_score)
    first = best(fixed)
    queue = _Queue(
        column=jnp.broadcast_to(first.column, (k, num_tracks)),
        price=jnp.broadcast_to(-first.detection_price, (k, num_columns - 1)),
        log_score=jnp.full(k, -jnp.inf, fixed.dtype).at[0].set(first.log_score),
        pivot=jnp.zeros(k, int),
        barred=jnp.zeros((k, num_columns), bool),
    )

    def pop(queue: _Queue, wanted: Array) -> tuple[_Queue, tuple[Array, Array]]:
        out = queue.column[0], queue.log_score[0]
        return _cut_up(fixed, queue, queue.log_score[wanted]), out

    left = jnp.arange(k - 1, 0, -1)  # events that are wanted beside this one
    queue, earlier = jax.lax.scan(pop, queue, left)
    column = jnp.concatenate([earlier[0], queue.column[:1]])
    feasible = jnp.concatenate([earlier[1], queue.log_score[:1]]) > -jnp.inf
    chosen = jnp.take_along_axis(log_score, column.T, axis=1)  # [N, k]
    total = jnp.where(feasible[None], chosen, 0.0).sum(0)
    return KBest(column, jnp.where(feasible, total, -jnp.inf), feasible)


def _cut_up(log_score: Array, queue: _Queue, least: Array) -> _Queue:
    """Takes the best part out of the queue and puts the parts of its rest in.

    Args:
        log_score: [N, K + 1].
        queue: What waits.
        least: Events of less weight are not wanted.
    """
    num_tracks, num_columns = log_score.shape
    column, price, total, pivot, barred = (x[0] for x in queue)
    track = jnp.arange(num_tracks)
    barred = (barred[None] & (track == pivot)[:, None]) | (track < pivot)[:, None]
    cost = jnp.where(log_score < jnp.inf, -log_score, jnp.inf)
    # Rounding must not lose an event that is just as good as the least.
    slack = NEARLY * jnp.finfo(cost.dtype).eps * jnp.abs(total)
    event = detours.Event(column, price)
    found = detours.detours(cost, event, barred, total - least + slack)

    log_scores = jnp.where(total > -jnp.inf, total - found.loss, -jnp.inf)
    taken = column[:, None] == jnp.arange(num_columns)[None]
    parts = _Queue(
        column=found.column,
        price=found.price,
        log_score=log_scores,
        pivot=track.astype(pivot.dtype),
        barred=taken | barred,
    )
    rest = queue._replace(log_score=queue.log_score.at[0].set(-jnp.inf))
    both = jax.tree.map(lambda x, y: jnp.concatenate([x, y]), rest, parts)
    kept = jax.lax.top_k(both.log_score, queue.log_score.size)[1]
    return jax.tree.map(lambda x: x[kept], both)
