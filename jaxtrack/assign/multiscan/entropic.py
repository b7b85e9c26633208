"""The linear relaxation with an entropy: shares that are smooth in the scores.

Maximise sum(share * score) + temperature * entropy, where the entropy is that of each
tree's shares, -sum(share * log(share)). Each tree's shares are the softmax of what its
leaves are worth after paying, and a price that is positive fills its detection. The
interior point method finds them as it does those of the linear programme.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import entropic, slots
    >>> log_score = jnp.array([[3.0, 0.0], [5.0, 4.0]])
    >>> given = slots.slots(log_score, jnp.array([[[0], [-1]], [[0], [-1]]]), 1)
    >>> point = entropic.solve(given, 1, jnp.array(1.0), 50, 1e-4)
    >>> print(jnp.round(point.share, 2).tolist(), jnp.round(point.table, 1))
    [[0.73, 0.27], [0.27, 0.73]] [2. 0.]

The derivatives are those of the settled shares (the implicit function theorem).

Reference: Cuturi, "Sinkhorn distances: lightspeed computation of optimal transport",
NeurIPS, 2013, of which this is the form for several scans.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.assign.multiscan import interior, primal_dual
from jaxtrack.assign.multiscan.slots import Slots, after_paying, used
from jaxtrack.assign.multiscan.system import factorize, solve_system
from jaxtrack.types import Array


class Point(NamedTuple):
    """What was found.

    Attributes:
        share: [N, L].
        table: Prices, [S (K + 1)].
        spare: What is left of each detection, [S (K + 1)].
        residual: The largest of what shares violate, of share times what it misses the
            softmax by (in logs), and of price times spare relative to the temperature.
        converged: Whether that is within the tolerance (bool).
        num_iterations: Rounds.
    """

    share: Array
    table: Array
    spare: Array
    residual: Array
    converged: Array
    num_iterations: Array


def solve(
    given: Slots,
    num_detections: int,
    temperature: Array,
    max_rounds: int,
    tolerance: float,
) -> Point:
    """Finds shares and prices.

    Args:
        given: The problem.
        num_detections: K.
        temperature: Positive, in the unit of the scores.
        max_rounds: Rounds at most.
        tolerance: Residual that ends it.
    """
    return _settle(num_detections, max_rounds, tolerance, *given, temperature)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _settle(
    num_detections: int,
    max_rounds: int,
    tolerance: float,
    log_score: Array,
    place: Array,
    there: Array,
    temperature: Array,
) -> Point:
    given = Slots(log_score, place, there)

    def judge(
        at: interior.Place, share: Array, table: Array, old: primal_dual.Point
    ) -> primal_dual.Point:
        residual = _residual(given, at, share, table, temperature, num_detections)
        new = share, table, residual, residual <= tolerance, old.num_iterations
        return primal_dual.Point(*new)

    at, point = interior.follow(given, num_detections, max_rounds, temperature, judge)
    return Point(point.share, point.table, at.spare, *point[2:])


def _residual(
    given: Slots,
    at: interior.Place,
    share: Array,
    table: Array,
    temperature: Array,
    num_detections: int,
) -> Array:
    """Returns by how much the conditions of the optimum are missed."""
    lacking = jnp.where(given.there, jnp.abs(share.sum(1) - 1), 0.0)
    real = jnp.arange(len(table)) % (num_detections + 1) < num_detections
    free = jnp.where(real, used(given, share, table) + at.spare - 1, 0.0)
    held = share > 0
    paid = jnp.where(held, after_paying(given, table) / temperature, 0.0)
    logs = jnp.where(held, paid - jnp.log(jnp.where(held, share, 1.0)), 0.0)
    # Shares are a softmax if these logs are alike in each tree.
    level = (share * logs).sum(1)
    missed = jnp.where(held, share * (logs - level[:, None]), 0.0)
    product = jnp.where(real, at.spare * table, 0.0) / temperature
    each = lacking, free, missed, product
    return jnp.stack([jnp.abs(x).max(initial=0.0) for x in each]).max()


@_settle.defjvp
def _(
    num_detections: int,
    max_rounds: int,
    tolerance: float,
    primals: tuple,
    tangents: tuple,
) -> tuple[Point, Point]:
    """Solves the settled equations for the change of the shares and prices."""
    log_score, place, there, temperature = primals
    given = Slots(log_score, place, there)
    point = _settle(num_detections, max_rounds, tolerance, *primals)
    share, table, spare = point[:3]
    real = jnp.arange(len(table)) % (num_detections + 1) < num_detections
    worth = jnp.where(share > 0, after_paying(given, table), 0.0) / temperature
    slope = jnp.where(share > 0, tangents[0], 0.0)
    slope = (slope - worth * tangents[3]) / temperature

    def moved(slope: Array) -> Array:
        return share * (slope - (share * slope).sum(1)[:, None])

    weight = spare / jnp.where(real, table, 1.0)
    system = factorize(given, share / temperature, weight)
    right = used(given, moved(slope), table)
    change = solve_system(system, jnp.zeros_like(share[:, 0]), right)[1]
    change = jnp.where(real, change, 0.0)
    slope = slope - change[place].sum(-1) / temperature
    spared = jnp.where(real, -weight * change, 0.0)
    none: Any = np.zeros((), jax.dtypes.float0)
    still = jnp.zeros_like(point.residual), none, none
    return point, Point(*(moved(slope), change, spared, *still))
