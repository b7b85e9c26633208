"""The best joint event: which track caused which detection, exactly.

The solver is that of `jaxtrack.assign.paths`, shortest augmenting paths. Under
`jax.vmap` many problems are solved side by side. A single problem alone takes some
thirty times as long as by SciPy's `linear_sum_assignment`; a thousand together take a
third of the time of a loop over it with 5 tracks, and a fifth more with 20 (see
`benchmarks/assign.py`).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import best
    >>> log_score = jnp.array([[5.0, 2.0, 0.0], [4.0, -2.0, 0.0]])
    >>> found = best.best(log_score)  # two tracks, two detections, the miss
    >>> print(found.column, found.log_score)
    [1 0] 6.0
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.paths import place
from jaxtrack.types import Array


class Best(NamedTuple):
    """The joint event of most weight.

    Attributes:
        column: Of each track, [N] (int): 0 to K - 1 the detection, K the miss.
        log_score: Sum of the chosen scores; -inf where nothing is feasible.
        feasible: Whether a joint event of positive weight exists (bool). Where none
            does, `column` is finite but means nothing.
        track_price: Dual potential u of each track, [N].
        detection_price: Dual potential v of each detection, not negative, [K]. No
            score[n, k] exceeds u[n] + v[k], no miss exceeds u[n], the chosen ones are
            equal to it, and v is 0 where nobody takes the detection, up to rounding.
    """

    column: Array
    log_score: Array
    feasible: Array
    track_price: Array
    detection_price: Array


class Least(NamedTuple):
    """The assignment of least cost.

    Attributes:
        column: Of each row, [N] (int), all different and less than L where feasible; L
            where a row finds none.
        cost: Sum of the chosen costs; inf where nothing is feasible.
        feasible: Whether every row has a column of its own at finite cost (bool).
    """

    column: Array
    cost: Array
    feasible: Array


def best(log_score: Array) -> Best:
    """Finds the joint event with the largest sum of scores, exactly.

    Ties are broken by the order of tracks and detections, always in the same way. A
    score that is NaN or +inf counts as impossible and makes the problem infeasible. The
    gradient of `log_score` is that of the chosen scores; the other fields are constant.

    Args:
        log_score: [N, K + 1], the miss last, -inf where impossible.
    """
    fixed = jax.lax.stop_gradient(log_score)
    sane = (fixed < jnp.inf).all()
    cost = jnp.where(fixed < jnp.inf, -fixed, jnp.inf)
    column, fits, track_price, detection_price = place(cost[:, :-1], cost[:, -1])
    chosen = _pick(log_score, column)
    feasible = fits & sane
    total = jnp.where(feasible, chosen, 0.0).sum()
    return Best(
        column=column,
        log_score=jnp.where(feasible, total, -jnp.inf),
        feasible=feasible,
        track_price=-track_price,
        detection_price=-detection_price,
    )


def solvable(log_score: Array) -> tuple[Array, Best]:
    """Returns scores that are feasible at any rate, and the best joint event.

    Where nothing is feasible, the scores say that all tracks are missed, and all prices
    are zero; `Best.feasible` still tells.

    Args:
        log_score: [N, K + 1], the miss last, -inf where impossible.
    """
    found = best(log_score)
    missed = jnp.full(log_score.shape, -jnp.inf).at[:, -1].set(0.0)
    scores = jnp.where(found.feasible, log_score, missed.astype(log_score.dtype))
    return scores, found._replace(
        track_price=jnp.where(found.feasible, found.track_price, 0.0),
        detection_price=jnp.where(found.feasible, found.detection_price, 0.0),
    )


def least(cost: Array) -> Least:
    """Finds the assignment of every row to a column of its own at least cost, exactly.

    The gradient of `cost` is that of the chosen costs.

    Args:
        cost: [N, L]; inf or NaN where impossible. With N > L nothing is feasible.
    """
    fixed = jax.lax.stop_gradient(cost)
    sane = (fixed > -jnp.inf).all() & ~jnp.isnan(fixed).any()
    usable = jnp.where(jnp.abs(fixed) < jnp.inf, fixed, jnp.inf)
    column, fits, _, _ = place(usable, jnp.full(cost.shape[:1], jnp.inf, cost.dtype))
    feasible = fits & sane
    padded = jnp.pad(cost, ((0, 0), (0, 1)))
    total = jnp.where(feasible, _pick(padded, column), 0.0).sum()
    return Least(column, jnp.where(feasible, total, jnp.inf), feasible)


def _pick(matrix: Array, column: Array) -> Array:
    """Returns the entry of each row [N] in its column."""
    return jnp.take_along_axis(matrix, column[:, None], axis=1)[:, 0]
