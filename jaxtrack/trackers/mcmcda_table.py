"""Tables of tracks: what is free in one, and what may follow a detection.

A hypothesis is a table: in each row the detections of a track, -1 for none in a scan,
and rows of nothing but -1 are empty. Which row a track stands in does not matter.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import mcmcda_table
    >>> table = jnp.array([[0, -1], [-1, 1]])  # two tracks with a detection each
    >>> print(mcmcda_table.free(table, valid=jnp.ones((2, 2), bool)))
    [[False  True]
     [ True False]]

Reference: Oh, Russell and Sastry, "Markov chain Monte Carlo data association for multi-
target tracking", IEEE Trans. Automatic Control 54(3), 2009, section V.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.types import Array


class Proposal(NamedTuple):
    """Where to go.

    Attributes:
        table: [N, T].
        changed: The rows that may be others than before, [2].
        log_forward: Log-probability of the choices made.
        log_backward: Of those that lead back.
        possible: Whether there is such a move (bool).
        choice: What was chosen where two ways lead to the same table (int).
    """

    table: Array
    changed: Array
    log_forward: Array
    log_backward: Array
    possible: Array
    choice: Array


def free(table: Array, valid: Array) -> Array:
    """Returns which detections are in no track, [T, K].

    Args:
        table: [N, T].
        valid: [T, K].
    """
    columns = jnp.arange(valid.shape[1])
    return valid & ~(table[:, :, None] == columns[None, None]).any(0)


def walk(
    links: Array, opened: Array, start: Array, noise: Array, given: Array, forced: Array
) -> tuple[Array, Array]:
    """Draws what follows a detection, or tells the probability of what is given.

    Args:
        links: [T K, T, K].
        opened: Which detections may follow, [T, K].
        start: Flat index of the detection.
        noise: Gumbel, [T, K + 1].
        given: [T].
        forced: Whether what is given is to follow.

    Returns:
        What follows, [T], and its log-probability.
    """
    num_slots = opened.shape[1]

    def step(now: tuple[Array, Array], here: tuple) -> tuple[tuple, Array]:
        (last, log_prob), (scan, opened, noise, given) = now, here
        log_odds = jnp.where(opened, links[last, scan], -jnp.inf)
        log_share = jax.nn.log_softmax(jnp.append(log_odds, 0.0))
        told = jnp.where(given < 0, num_slots, given)
        column = jnp.where(forced, told, jnp.argmax(log_share + noise))
        after = scan > last // num_slots
        hit = after & (column < num_slots)
        log_prob = log_prob + jnp.where(after, log_share[column], 0.0)
        last = jnp.where(hit, scan * num_slots + column, last)
        return (last, log_prob), jnp.where(hit, column, -1)

    here = jnp.arange(len(opened)), opened, noise, given
    zero = jnp.zeros((), links.dtype)
    (_, log_prob), row = jax.lax.scan(step, (start, zero), here)
    return row, log_prob


def marks(row: Array, valid: Array) -> Array:
    """Returns where the detections of a row stand, [T, K]."""
    return row[:, None] == jnp.arange(valid.shape[1])[None]


def some(log_weight: Array) -> Array:
    """Returns the weights, or any where none is possible."""
    return jnp.where((log_weight > -jnp.inf).any(), log_weight, 0.0)


def log_number(number: Array) -> Array:
    """Returns the log of a number, 0 where that is none."""
    return jnp.log(jnp.maximum(number, 1).astype(float))
