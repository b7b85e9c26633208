"""The auction algorithm: tracks bid for detections until nobody would rather change.

All tracks without a column bid at once: each for the column of most value, score less
price, offering what it is worth more than the second best plus epsilon. It ends with a
joint event whose sum of scores is within N epsilon of the best; with scores that are
whole multiples of some unit, and epsilon below a unit / N, it is the best.

A miss is a column of one track's own, so a track whose detections have become too dear
is missed and bids no more. Prices start from zero in one phase: of a detection nobody
takes the price must stay zero, so those of an earlier, coarser phase cannot be kept.

`best` is exact and bounded in its work; an auction needs no searches, only rounds in
which all tracks work side by side, but their number grows as epsilon falls.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import auction
    >>> log_score = jnp.array([[5.0, 2.0, 0.0], [4.0, -2.0, 0.0]])
    >>> print(auction.auction(log_score, epsilon=0.1).column)
    [1 0]

Reference: Bertsekas, "The auction algorithm: a distributed relaxation method for the
assignment problem", Annals of Operations Research 14, 1988.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.types import Array


class Auction(NamedTuple):
    """A joint event that is nearly the best.

    Attributes:
        column: Of each track, [N] (int): 0 to K - 1 the detection, K the miss; K too
            for a track that found none.
        log_score: Sum of the chosen scores; -inf where not `feasible`.
        feasible: Whether every track found a possible column (bool); false too if the
            rounds were not enough, see `converged`.
        converged: Whether nobody would bid any more (bool).
        num_rounds: How many rounds it took.
    """

    column: Array
    log_score: Array
    feasible: Array
    converged: Array
    num_rounds: Array


class _State(NamedTuple):
    """Where the auction stands.

    Attributes:
        column: Of each track, [N]; K + 1 while it waits to bid.
        price: Of each detection, inf where nobody else can have it, [K].
        stuck: Tracks that have no possible column left, [N] (bool).
        count: Rounds so far.
    """

    column: Array
    price: Array
    stuck: Array
    count: Array


def auction(
    log_score: Array, epsilon: Array | float, max_rounds: int = 10_000
) -> Auction:
    """Finds a joint event within N epsilon of the largest sum of scores.

    The number of rounds grows as the range of scores over epsilon. Bids that are equal
    go to the first track. The gradient of `log_score` is that of the chosen scores.

    Args:
        log_score: [N, K + 1], the miss last, -inf where impossible.
        epsilon: Positive, in the unit of the scores; may be traced.
        max_rounds: Rounds at most.

    Raises:
        ValueError: Epsilon is not positive, or there is no round.
    """
    if isinstance(epsilon, (int, float)) and not epsilon > 0:
        raise ValueError(f"epsilon is {epsilon}; it must be positive.")
    if max_rounds < 1:
        raise ValueError(f"max_rounds is {max_rounds}; give at least 1")
    num_tracks, num_columns = log_score.shape
    fixed = jax.lax.stop_gradient(log_score)
    fixed = jnp.where(fixed < jnp.inf, fixed, -jnp.inf)

    def waits(state: _State) -> Array:
        waiting = state.column == num_columns
        return waiting.any() & (state.count < max_rounds)

    start = _State(
        column=jnp.full(num_tracks, num_columns),
        price=jnp.zeros(num_columns - 1, fixed.dtype),
        stuck=jnp.zeros(num_tracks, bool),
        count=jnp.array(0),
    )
    end = jax.lax.while_loop(waits, lambda state: _bid(fixed, epsilon, state), start)
    converged = (end.column < num_columns).all()
    feasible = converged & ~end.stuck.any()
    column = jnp.minimum(end.column, num_columns - 1)
    chosen = jnp.take_along_axis(log_score, column[:, None], axis=1)[:, 0]
    total = jnp.where(feasible, chosen, 0.0).sum()
    total = jnp.where(feasible, total, -jnp.inf)
    return Auction(column, total, feasible, converged, end.count)


def _bid(log_score: Array, epsilon: Array | float, state: _State) -> _State:
    """Lets all waiting tracks bid, and gives each detection to whoever bids most."""
    num_tracks, num_columns = log_score.shape
    waiting = state.column == num_columns
    columns, tracks = jnp.arange(num_columns), jnp.arange(num_tracks)
    price = jnp.append(state.price, 0.0)
    value = log_score - price[None]
    wanted = jnp.argmax(value, axis=1)
    wants = columns[None] == wanted[:, None]  # [N, K + 1]
    most = value.max(1)
    second = jnp.where(wants, -jnp.inf, value).max(1, initial=-jnp.inf)
    # Were there a way to a free detection or a miss, of at most N tracks that each give
    # up at most 2 C + epsilon, with C the largest score, no value could be so low.
    largest = jnp.where(log_score > -jnp.inf, jnp.abs(log_score), 0.0).max()
    stuck = waiting & ~(most >= -2 * num_tracks * (largest + epsilon))
    missed = waiting & (stuck | (wanted == num_columns - 1))

    bids = waiting & ~missed
    gain = jnp.where(bids, most, 0.0) - jnp.where(bids, second, 0.0) + epsilon
    offer = jnp.where(wants & bids[:, None], (price[wanted] + gain)[:, None], -jnp.inf)
    best_offer = offer[:, :-1].max(0)
    sold = best_offer > -jnp.inf
    winner = jnp.argmax(offer[:, :-1], axis=0)
    wins = (sold[None] & (winner[None] == tracks[:, None])).any(1)  # [N]
    loses = jnp.append(sold, False)[jnp.minimum(state.column, num_columns - 1)]
    column = jnp.where(loses & ~waiting, num_columns, state.column)
    column = jnp.where(missed, num_columns - 1, jnp.where(wins, wanted, column))
    return _State(
        column=column,
        price=jnp.where(sold, best_offer, state.price),
        stuck=state.stuck | stuck,
        count=state.count + 1,
    )
