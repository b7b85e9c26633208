"""The linear relaxation: trees share themselves out on leaves, and each has one in all.

Its value is the least bound that prices on detections can give, and where all shares
are 0 or 1 they are the best selection. That is so with two scans of which one is the
trees themselves (that is, S = 1), and where every tree may have its best leaf; else it
depends on the numbers. Three ways to solve it: an interior point method, which is the
fastest on a CPU; primal-dual gradients, which need no factorization; and the form with
an entropy, whose shares are unique and have derivatives, and which becomes the linear
programme as the temperature falls.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign.multiscan import problem, relax
    >>> log_score = jnp.array([[2.0, 0.0], [2.0, 0.0], [2.0, 0.0]])
    >>> detection = jnp.full((3, 2, 3), -1)  # any two first leaves share a detection
    >>> detection = detection.at[0, 0, :2].set(0).at[1, 0, 1:].set(0)
    >>> detection = detection.at[2, 0, ::2].set(0)
    >>> given = problem.Problem(log_score, detection)
    >>> found = relax.relax(given, num_detections=1)
    >>> print(jnp.round(found.share[:, 0], 2), jnp.round(found.log_score, 2))
    [0.5 0.5 0.5] 3.0

References: Liu et al., the randomized multiple-model multiple hypothesis tracker, 2021,
equation 32 and Proposition 3; see also `interior`, `primal_dual` and `entropic`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.multiscan import entropic, interior, primal_dual
from jaxtrack.assign.multiscan.problem import Problem
from jaxtrack.assign.multiscan.slots import Slots, flat, gained, slots, unflat
from jaxtrack.types import Array

TOLERANCE = {"float32": 1e-4, "float64": 1e-8}
ROUNDS = {"interior": 50, "primal-dual": 4000, "entropic": 50}


class Relaxed(NamedTuple):
    """Shares of leaves.

    Attributes:
        share: Of each leaf in its tree, [N, L]; a tree's add up to one, those that use
            a detection to no more than one, up to `residual`.
        log_score: Sum of share * score.
        entropy: Sum of -share * log(share).
        log_bound: No selection has more, up to rounding, at any residual.
        price: Of each detection, at which `log_bound` holds, [S, K].
        residual: By how much the shares violate what they should hold, or the gap
            between value and bound relative to them, whichever is larger; with a
            temperature, prices times spares relative to it in place of the gap.
        converged: Whether that is within the tolerance (bool). Where no shares hold
            what they should, it never is.
        num_iterations: How many rounds it took.
    """

    share: Array
    log_score: Array
    entropy: Array
    log_bound: Array
    price: Array
    residual: Array
    converged: Array
    num_iterations: Array


def relax(
    problem: Problem,
    num_detections: int,
    temperature: Array | float | None = None,
    method: str = "interior",
    max_iterations: int | None = None,
    tolerance: float | None = None,
) -> Relaxed:
    """Solves the linear relaxation, or its form with an entropy.

    Without a temperature shares are constant, and the gradient of `log_score` is the
    shares. With one, shares have the derivatives of the settled ones, and the gradient
    of `log_score + temperature * entropy`, the maximum, is the shares.

    Args:
        problem: [N, L] and [N, L, S].
        num_detections: K, detections of a scan at most.
        temperature: Positive, in the unit of the scores, may be traced; None for none.
        method: Without a temperature, "interior" or "primal-dual".
        max_iterations: Rounds at most; None for what has always been enough
            (`ROUNDS`), but for gradients in large problems.
        tolerance: Residual that ends it; None for 1e-4 in float32, 1e-8 in float64.

    Raises:
        ValueError: The temperature is not positive, the method unknown, or there is no
            round.
    """
    if isinstance(temperature, (int, float)) and not temperature > 0:
        raise ValueError(f"temperature is {temperature}; it must be positive.")
    if method not in ("interior", "primal-dual"):
        raise ValueError(f'method is "{method}"; give "interior" or "primal-dual"')
    name = method if temperature is None else "entropic"
    rounds = ROUNDS[name] if max_iterations is None else max_iterations
    if rounds < 1:
        raise ValueError(f"max_iterations is {rounds}; give at least 1")
    given = slots(*problem, num_detections)
    kind = given.log_score.dtype
    near = TOLERANCE[kind.name] if tolerance is None else tolerance
    if temperature is None:
        point = _linear(given, num_detections, name, rounds, near)
    else:
        heat = jnp.asarray(temperature, kind)
        point = entropic.solve(given, num_detections, heat, rounds, near)
    share = point.share
    score = jnp.where(share > 0, given.log_score, 0.0)
    logs = jnp.log(jnp.where(share > 0, share, 1.0))
    price = unflat(jnp.maximum(jax.lax.stop_gradient(point.table), 0.0), num_detections)
    return Relaxed(
        share=share,
        log_score=(share * score).sum(),
        entropy=-(share * logs).sum(),
        log_bound=gained(jax.lax.stop_gradient(given), flat(price)),
        price=price,
        residual=point.residual,
        converged=point.converged,
        num_iterations=point.num_iterations,
    )


def _linear(
    given: Slots, num_detections: int, method: str, rounds: int, tolerance: float
) -> primal_dual.Point:
    fixed = jax.lax.stop_gradient(given)
    if method == "interior":
        return interior.solve(fixed, num_detections, rounds, tolerance)
    size = given.place.shape[-1] * (num_detections + 1)
    table = jnp.zeros(size, given.log_score.dtype)
    return primal_dual.solve(fixed, table, rounds, tolerance)
