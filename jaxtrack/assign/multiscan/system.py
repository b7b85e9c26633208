"""Linear equations between changes of prices and changes of what they bring about.

When prices on detections change, each tree moves shares between its leaves, so much as
their weights say, without changing their sum; so the use of detections changes. Shares
and the gains of trees are eliminated, and a dense system in the prices is left.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import slots, system
    >>> log_score = jnp.array([[3.0, 0.0]])  # one tree, with a detection or without
    >>> given = slots.slots(log_score, jnp.array([[[0], [-1]]]), 1)
    >>> made = system.factorize(given, jnp.array([[0.5, 0.5]]), jnp.array([0.75, 1.0]))
    >>> print(system.solve_system(made, jnp.zeros(1), jnp.array([1.0, 0.0]))[1])
    [1. 0.]
"""

from typing import NamedTuple

import jax.numpy as jnp
import jax.scipy as jsp

from jaxtrack.assign.multiscan.slots import Slots
from jaxtrack.types import Array


class System(NamedTuple):
    """The linear equations of a round, after elimination of the shares.

    Attributes:
        factor: Lower factor of the scaled system in prices, [S (K + 1), S (K + 1)].
        scale: By which its rows and columns were divided, [S (K + 1)].
        share: Of each tree's weight, that of leaves that use a detection,
            [N, S (K + 1)].
        whole: Weight of all of each tree's leaves, [N]; 1 where there is none.
    """

    factor: Array
    scale: Array
    share: Array
    whole: Array


def factorize(given: Slots, weight: Array, diagonal: Array) -> System:
    """Prepares the solution of equations with one weight a leaf, one a detection.

    The matrix is that of a change of usage with prices, where shares change by `weight`
    times the change of their reduced score and each tree's shares keep their sum; plus
    `diagonal`. The places of no detection are left alone.

    Args:
        given: The problem.
        weight: [N, L], zero where there is no leaf.
        diagonal: [S (K + 1)], positive.
    """
    num_trees, num_leaves, num_scans = given.place.shape
    size = len(diagonal)
    real = jnp.arange(size) % (size // num_scans) < size // num_scans - 1
    # Leaves are counted by what they use beyond their tree's heaviest: its weight may
    # be so large that others vanish beside it, and then it hardly matters.
    base = jnp.argmax(weight, axis=1)[:, None]
    heaviest = base == jnp.arange(num_leaves)[None]
    rest = jnp.where(heaviest, 0.0, weight)
    total = weight.sum(1)
    whole = jnp.where(total > 0, total, 1.0)[:, None]
    light = rest.sum(1)[:, None]
    place = jnp.take_along_axis(given.place, base[..., None], axis=1)[:, 0]
    trees = jnp.arange(num_trees)[:, None]
    none = jnp.zeros((num_trees, size), weight.dtype)
    heavy = jnp.where(real[None], none.at[trees, place].set(1.0), 0.0)
    many = jnp.broadcast_to(rest[..., None], given.place.shape)
    pair = jnp.where(real[None], none.at[trees[..., None], given.place].add(many), 0.0)
    beyond = pair - light * heavy
    matrix = _both(given, rest, size) + jnp.diag(pair.sum(0))
    matrix = jnp.where(real[:, None] & real[None], matrix, 0.0)
    matrix -= beyond.T @ (heavy + beyond / whole)
    matrix -= heavy.T @ (beyond + light * heavy)
    matrix += jnp.diag(jnp.where(real, diagonal, 1.0))
    scale = jnp.sqrt(jnp.maximum(matrix.diagonal(), jnp.finfo(weight.dtype).tiny))
    loose = 4 * jnp.finfo(weight.dtype).eps
    scaled = matrix / scale[:, None] / scale[None]
    scaled += loose * jnp.eye(size, dtype=weight.dtype)
    share = (pair + (whole - light) * heavy) / whole
    return System(jnp.linalg.cholesky(scaled), scale, share, whole[:, 0])


def _both(given: Slots, weight: Array, size: int) -> Array:
    """Adds up the weights of leaves that use two detections, [size, size]."""
    place = given.place.reshape(-1, given.place.shape[-1])
    first, second = jnp.triu_indices(place.shape[1], 1)
    table = jnp.zeros((size, size), weight.dtype)
    if not first.size:
        return table
    many = jnp.broadcast_to(weight.reshape(-1, 1), (weight.size, first.size))
    table = table.at[place[:, first], place[:, second]].add(many)
    return table + table.T


def solve_system(
    system: System, trees: Array, detections: Array
) -> tuple[Array, Array]:
    """Solves for gains [N] and prices [S (K + 1)] with these right sides."""
    right = (detections - system.share.T @ trees) / system.scale
    prices = jsp.linalg.cho_solve((system.factor, True), right) / system.scale
    return trees / system.whole - system.share @ prices, prices
