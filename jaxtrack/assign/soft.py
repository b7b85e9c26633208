"""A smooth assignment: Sinkhorn's shares, with misses and clutter as slack.

The table of shares p maximises sum(p * score) + temperature * sum(p * (1 - log(p))),
where each track has one unit to give to detections and its miss, and each detection
takes one unit from tracks and clutter. The shares tend to the best joint event as the
temperature falls, and have derivatives everywhere.

Sinkhorn's algorithm scales rows and columns of exp(score / temperature) in turn until
both sum to one. Where there is hardly any slack that takes as many rounds as slack is
small; so here the columns are scaled as he does and the rows by Newton's method.

At temperature 1 the shares are not the association probabilities of `marginals`, but
akin to them: both maximise the expected score plus an entropy. For the probabilities it
is that of joint events, for belief propagation Bethe's approximation to it, and here
that of the entries of the table, as if each were drawn on its own.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import soft
    >>> log_score = jnp.array([[5.0, 2.0, 0.0], [4.0, -2.0, 0.0]])
    >>> print(jnp.round(soft.soft(log_score, temperature=0.01).prob, 3))
    [[0. 1. 0.]
     [1. 0. 0.]]

References: Cuturi, "Sinkhorn distances: lightspeed computation of optimal transport",
NeurIPS, 2013; Chizat, Peyre, Schmitzer and Vialard, "Scaling algorithms for unbalanced
optimal transport problems", Mathematics of Computation 87, 2018; Sun and Tran-Dinh,
"Generalized self-concordant functions", Mathematical Programming 178, 2019, for the
length of the steps.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.nn import logsumexp

from jaxtrack.assign.best import solvable
from jaxtrack.types import Array

TOLERANCE = {"float32": 1e-5, "float64": 1e-12}  # of what a track gives in all


class Soft(NamedTuple):
    """A smooth assignment.

    Attributes:
        prob: Share of each column in each track, [N, K + 1]; rows sum to one, columns
            of detections to less where `converged`. All zero if not `feasible`.
        feasible: Whether a joint event of positive weight exists (bool).
        converged: Whether the shares settled (bool).
        num_iterations: How many rounds it took.
    """

    prob: Array
    feasible: Array
    converged: Array
    num_iterations: Array


def soft(
    log_score: Array, temperature: Array | float = 1.0, max_iterations: int = 200
) -> Soft:
    """Finds the shares, from the prices of the best joint event on.

    Derivatives are those of the settled shares (the implicit function theorem), by a
    linear system of N equations; by a score of -inf they are zero. So is each round.

    Args:
        log_score: [N, K + 1], the miss last, -inf where impossible.
        temperature: Positive, in the unit of the scores; may be traced.
        max_iterations: Rounds at most.

    Raises:
        ValueError: The temperature is not positive, or there is no round.
    """
    if isinstance(temperature, (int, float)) and not temperature > 0:
        raise ValueError(f"temperature is {temperature}; it must be positive.")
    if max_iterations < 1:
        raise ValueError(f"max_iterations is {max_iterations}; give at least 1")
    scores, found = solvable(log_score)
    possible = scores > -jnp.inf
    score = jnp.where(
        possible, jnp.where(possible, scores, 0.0) / temperature, -jnp.inf
    )
    start = jax.lax.stop_gradient(found.track_price / temperature)
    bid, converged, count = _settle(max_iterations, score, start)
    prob = jax.nn.softmax(_priced(score, bid), axis=1)
    return Soft(
        prob=jnp.where(found.feasible, prob, 0.0),
        feasible=found.feasible,
        converged=converged,
        num_iterations=count,
    )


def _priced(score: Array, bid: Array) -> Array:
    """Returns scores [N, K + 1] less the prices at which detections are just taken.

    Args:
        score: In units of the temperature.
        bid: The potential of each track, [N].
    """
    offers = score[:, :-1] - bid[:, None]
    clutter = jnp.zeros_like(offers[:1])
    price = logsumexp(jnp.concatenate([offers, clutter]), axis=0)
    return jnp.concatenate([score[:, :-1] - price[None], score[:, -1:]], 1)


def _shares(score: Array, bid: Array) -> Array:
    """Returns the shares [N, K + 1] at these bids; columns sum to one with clutter."""
    return jnp.exp(_priced(score, bid) - bid[:, None])


def _solve(share: Array, right: Array) -> Array:
    """Solves the linear equations between changes of bids and of what rows sum to."""
    pair = share[:, :-1]
    given = share.sum(1)
    # Without any slack, bids may rise as prices fall: the loosening decides.
    loose = 1 + 10 * len(given) * jnp.finfo(share.dtype).eps
    system = loose * jnp.diag(given) - pair @ pair.T
    return jnp.linalg.solve(system, right)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _settle(
    max_iterations: int, score: Array, start: Array
) -> tuple[Array, Array, Array]:
    """Returns the bids [N] at which each track gives one unit, and how it went."""
    largest = jnp.where(score > -jnp.inf, jnp.abs(score), 0.0).max(initial=0.0)
    rounding = 8 * jnp.finfo(score.dtype).eps * largest
    tolerance = jnp.maximum(TOLERANCE[score.dtype.name], rounding)

    def more(state: tuple[Array, Array, Array]) -> Array:
        _, settled, count = state
        return ~settled & (count < max_iterations)

    def adjust(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        bid, _, count = state
        # A round of Sinkhorn's, which never leads astray, then one of Newton's.
        bid = logsumexp(_priced(score, bid), axis=1)
        share = _shares(score, bid)
        excess = share.sum(1) - 1
        step = _solve(share, excess)
        size = 2 * jnp.abs(step).max(initial=0.0)
        # As far as the curvature is surely known.
        damped = jnp.where(size > 1e-3, jnp.log1p(size) / jnp.maximum(size, 1e-3), 1.0)
        settled = (jnp.abs(excess) <= tolerance).all()
        return jnp.where(settled, bid, bid + damped * step), settled, count + 1

    return jax.lax.while_loop(more, adjust, (start, jnp.array(False), jnp.array(0)))


@_settle.defjvp
def _(max_iterations: int, primals: tuple, tangents: tuple) -> tuple:
    """Solves the settled equations for the change of the bids."""
    score, start = primals
    bid, settled, count = _settle(max_iterations, score, start)
    share = _shares(score, bid)
    moved = jnp.where(share > 0, share * tangents[0], 0.0)
    taken = moved[:, :-1].sum(0)
    slope = _solve(share, moved.sum(1) - share[:, :-1] @ taken)
    none = (np.zeros((), jax.dtypes.float0),) * 2
    return (bid, settled, count), (slope, *none)
