"""Trees of track hypotheses that compete for the detections of several scans.

A leaf of a tree tells which detection of each scan a target caused, if any, and how
likely that is. Every tree takes one of its leaves, no detection is used by two trees,
and the sum of scores is to be as large as possible: an assignment in as many dimensions
as there are scans and trees, which is NP-hard from two scans on. A price on each
detection takes the trees apart again: each has its best leaf after paying, and what all
gain at these prices, paid prices included, is a bound on every selection.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import problem
    >>> log_score = jnp.array([[3.0, 0.0], [2.0, 0.0]])  # two trees, two leaves each
    >>> detection = jnp.array([[[0, 1], [-1, -1]], [[0, -1], [-1, -1]]])
    >>> given = problem.Problem(log_score, detection)  # both want the first detection
    >>> print(problem.bound(given, jnp.zeros((2, 2))), problem.label(given, 2))
    5.0 [0 0]
    >>> print(problem.bound(given, jnp.array([[2.0, 0.0], [0.0, 0.0]])))
    3.0

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, equations 33 and 34.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign import clusters
from jaxtrack.assign.lanes import lanes
from jaxtrack.assign.multiscan.slots import flat, gained, judge, slots
from jaxtrack.types import Array


class Problem(NamedTuple):
    """N trees with L leaves each, of S scans.

    Attributes:
        log_score: Of each leaf, against its detections being false, [N, L]; -inf where
            there is none. NaN and inf count as -inf, so does a leaf with a detection
            beyond the last. A tree that may be nothing has a leaf with score 0 and no
            detections; one of -inf alone is empty and takes no part.
        detection: Which one of each scan a leaf uses, [N, L, S] (int); -1 for none.
    """

    log_score: Array
    detection: Array


class Answer(NamedTuple):
    """One leaf for each tree.

    Attributes:
        leaf: Of each tree, [N] (int); -1 where the tree is empty, or finds no leaf.
        log_score: Sum of the chosen scores; -inf if not `feasible`.
        log_bound: No selection has more, up to rounding; the gap to `log_score` bounds
            what is lost.
        feasible: Whether every tree found a leaf and no detection is used twice (bool).
            Another solver may find leaves where this one did not.
        price: Of each detection, at which `log_bound` holds, [S, K]; branch and bound
            may have lowered it since.
    """

    leaf: Array
    log_score: Array
    log_bound: Array
    feasible: Array
    price: Array


def bound(problem: Problem, price: Array) -> Array:
    """Returns what no selection exceeds, up to rounding.

    Args:
        problem: [N, L] and [N, L, S].
        price: Of each detection, [S, K], any that are not negative.
    """
    return gained(slots(*problem, price.shape[1]), flat(price))


def answer(problem: Problem, leaf: Array, price: Array) -> Answer:
    """Returns an answer with its score and the bound at these prices.

    The gradient of the scores is that of the chosen ones; the bound is constant.

    Args:
        problem: [N, L] and [N, L, S].
        leaf: [N], -1 for none.
        price: [S, K].
    """
    num_scans, num_detections = price.shape
    given = slots(*problem, num_detections)
    total, feasible = judge(given, leaf, num_scans * (num_detections + 1))
    limit = jax.lax.stop_gradient(gained(given, flat(price)))
    limit = jnp.maximum(limit, jax.lax.stop_gradient(total))
    return Answer(leaf, total, limit, feasible, price)


def label(problem: Problem, num_detections: int) -> Array:
    """Returns the first tree of each tree's cluster, [N].

    Trees of different clusters share no detection, directly or through others, so that
    selections factor over clusters.

    Args:
        problem: [N, L] and [N, L, S].
        num_detections: K, detections of a scan at most.
    """
    given = slots(*problem, num_detections)
    num_trees, num_leaves, num_scans = given.place.shape
    trees = jnp.arange(num_trees)[:, None, None]
    flags = jnp.zeros((num_trees, num_scans * (num_detections + 1)), bool)
    possible = (given.log_score > -jnp.inf)[..., None]
    possible = jnp.broadcast_to(possible, (num_trees, num_leaves, num_scans))
    wanted = flags.at[trees, given.place].max(possible)
    wanted = wanted.reshape(num_trees, num_scans, -1)[:, :, :-1]
    return lanes(clusters.label)(wanted.reshape(num_trees, -1))
