"""Leaves taken tree by tree, the most pressing first: fast, and often near the best.

Trees that have most to lose by giving up their best leaf choose first, each its best
leaf of those that are left; those that cannot do without detections come before all
others. Afterwards each tree may choose again, round after round.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import greedy, problem
    >>> log_score = jnp.array([[3.0, 0.0], [5.0, 4.0]])
    >>> detection = jnp.array([[[0], [-1]], [[0], [-1]]])
    >>> found = greedy.greedy(problem.Problem(log_score, detection), num_detections=1)
    >>> print(found.leaf, found.log_score, found.log_bound)
    [0 1] 7.0 8.0
"""

import jax
import jax.numpy as jnp

from jaxtrack.assign.multiscan.problem import Answer, Problem, answer
from jaxtrack.assign.multiscan.slots import Slots, slots
from jaxtrack.types import Array

ROUNDS = 2  # of choosing again


def greedy(problem: Problem, num_detections: int) -> Answer:
    """Chooses tree by tree, and again.

    The bound is that of no prices: the sum of every tree's best score.

    Args:
        problem: [N, L] and [N, L, S].
        num_detections: K, detections of a scan at most.
    """
    fixed = jax.lax.stop_gradient(problem)
    given = slots(*fixed, num_detections)
    num_scans = given.place.shape[-1]
    num_places = num_scans * (num_detections + 1)
    leaf = choose(given, given.log_score, num_places)
    leaf = choose_again(given, leaf, num_places, ROUNDS)
    none = jnp.zeros((num_scans, num_detections), given.log_score.dtype)
    return answer(problem, leaf, none)


def choose(
    given: Slots, worth: Array, num_places: int, held: Array | None = None
) -> Array:
    """Takes the leaf of most worth for one tree after the other.

    Args:
        given: The problem.
        worth: Of each leaf, [N, L]; -inf where there is none.
        num_places: S (K + 1).
        held: Leaves that are taken already, [N], -1 for none; all free if not given.

    Returns:
        Leaves, [N], -1 where none was left.
    """
    num_trees = len(worth)
    if held is None:
        held = jnp.full(num_trees, -1, jnp.int32)
    without = (given.place % (num_places // given.place.shape[-1])) == (
        num_places // given.place.shape[-1] - 1
    )
    best = worth.max(1, initial=-jnp.inf)
    spare = jnp.where(without.all(-1), worth, -jnp.inf).max(1, initial=-jnp.inf)
    # A tree that holds a leaf, or is empty, comes last; its turn changes nothing.
    waits = given.there & (held < 0)
    safe_spare = jnp.where(spare > -jnp.inf, spare, 0.0)
    loss = jnp.where(
        spare > -jnp.inf, jnp.where(waits, best, 0.0) - safe_spare, jnp.inf
    )
    order = jnp.argsort(jnp.where(waits, -loss, jnp.inf))
    return _turns(given, worth, held, order, num_places, again=False)


def choose_again(given: Slots, leaf: Array, num_places: int, rounds: int) -> Array:
    """Lets every tree exchange its leaf for a better one that is free, in turn."""
    turns = jnp.tile(jnp.arange(len(leaf)), rounds)
    return _turns(given, given.log_score, leaf, turns, num_places, again=True)


def _turns(
    given: Slots,
    worth: Array,
    held: Array,
    turns: Array,
    num_places: int,
    again: bool,
) -> Array:
    """Gives trees their turns, in which they take the best leaf that is free."""
    num_scans = given.place.shape[-1]
    width = num_places // num_scans
    real = jnp.arange(num_places) % width < width - 1
    chosen = jnp.maximum(held, 0)[:, None, None]
    place = jnp.take_along_axis(given.place, chosen, axis=1)[:, 0]
    count = jnp.zeros(num_places, jnp.int32).at[place].add((held >= 0)[:, None])

    def turn(state: tuple[Array, Array], tree: Array) -> tuple[tuple, None]:
        leaf, taken = state
        mine, places = leaf[tree], given.place[tree]
        gives = (mine >= 0) & again
        taken = taken.at[places[jnp.maximum(mine, 0)]].add(-gives.astype(jnp.int32))
        free = ~((taken > 0) & real)[places].any(-1)
        offers = jnp.where(free, worth[tree], -jnp.inf)
        found = jnp.argmax(offers).astype(jnp.int32)
        takes = (offers.max(initial=-jnp.inf) > -jnp.inf) & (gives | (mine < 0))
        taken = taken.at[places[found]].add(takes.astype(jnp.int32))
        new = jnp.where(takes, found, jnp.where(gives, -1, mine))
        return (leaf.at[tree].set(new), taken), None

    return jax.lax.scan(turn, (held, count), turns)[0][0]
