"""The trajectory metric: localisation, missed and false targets, and track switches.

Two sets of trajectories, truth and estimate, are compared at T times. At each time
there is a matrix of weights W [N, L], whose rows and columns sum to at most one, and

    distance^p = least of  sum over times of the GOSPA costs of the weighted pairs
                           + switch_cost^p / 2 * sum of |W[t + 1] - W[t]|

so that W may change, at a price. The GOSPA costs are d^p for a pair nearer than the
cut-off c and c^p / 2 for everything that is alive and in no pair. It is the linear
programme of the paper, with Euclidean base distance; trajectories may have holes. With
one time it is GOSPA.

`metric` is jitted and vmappable and says how exact it is: the truth is between `lower`
and `distance`. `exact` solves the programme by HiGHS, on the host. Where ten targets
meet, `metric` is some twenty times as fast, many at a time; where they are spread out
HiGHS gains by leaving out pairs, and it is ten times (`benchmarks/trajectories.py`).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import trajectories
    >>> truth = jnp.array([[[0.0], [50.0]]] * 6)  # two targets at rest, six times
    >>> swapped = truth.at[3:].set(truth[3:, ::-1])  # two labels that change places
    >>> alive = jnp.ones((6, 2), bool)
    >>> score = trajectories.metric(truth, alive, swapped, alive, 10.0, switch_cost=2.0)
    >>> print(score.switch.round(3), score.missed)  # four changes, 2 each
    8.0 0.0

Reference: Garcia-Fernandez, Rahmathullah and Svensson, "A metric on the space of finite
sets of trajectories for evaluation of multi-target tracking algorithms", IEEE Trans.
Signal Processing 68, 2020, section IV (linear programme), and its decomposition.
"""

import math
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.metrics import assignment, coupled
from jaxtrack.types import Array


class Score(NamedTuple):
    """A distance and its parts: distance^p = localisation + missed + false + switch.

    The parts are kept to the p-th power, so that they add up.

    Attributes:
        distance: That of a feasible W, in the unit of the points: never too small.
        lower: Never more than the least distance; equal to it where all is exact.
        localisation: Sum of d^p over the pairs.
        missed: c^p / 2 for every missed target, at each time.
        false: c^p / 2 for every false one.
        switch: switch_cost^p / 2 for every change of a weight; a target that goes from
            one track to another changes two, two tracks that change places four.
    """

    distance: Array
    lower: Array
    localisation: Array
    missed: Array
    false: Array
    switch: Array


class _Sets(NamedTuple):
    """Two sets, in units of the cut-off.

    Attributes:
        relative: (d / c)^p of each pair, 0 where it is not close, [T, N, L].
        close: Both are alive and nearer than the cut-off, [T, N, L] (bool).
        num_truth: Truths alive, of all times.
        num_estimate: Estimates alive, of all times.
        change_cost: (switch_cost / c)^p / 2.
    """

    relative: Array
    close: Array
    num_truth: Array
    num_estimate: Array
    change_cost: Array


def metric(
    truth: Array,
    truth_alive: Array,
    estimate: Array,
    estimate_alive: Array,
    cutoff: Array | float,
    switch_cost: Array | float,
    order: Array | float = 2.0,
    tolerance: Array | float = 1e-3,
    max_steps: Array | int = 2000,
) -> Score:
    """Measures the distance of two sets of trajectories.

    Padding, and the order of trajectories, change nothing beyond the tolerance.
    Gradients are finite; the weights W count as constant in them, and `lower` as well.

    Args:
        truth: [T, N, P].
        truth_alive: When each is alive, [T, N] (bool).
        estimate: [T, L, P].
        estimate_alive: [T, L] (bool).
        cutoff: c, positive, in the unit of the points.
        switch_cost: Positive, in the unit of the points.
        order: p, at least 1 and finite.
        tolerance: Largest distance^p - lower^p, relative to distance^p.
        max_steps: At which to stop anyway, with whatever `lower` then is.

    Returns:
        Six scalars.
    """
    _check(cutoff, switch_cost, order)
    sets = _compare(
        truth, truth_alive, estimate, estimate_alive, cutoff, switch_cost, order
    )
    found = coupled.solve(
        _cost(sets), sets.change_cost, _apart(sets), tolerance, max_steps
    )
    return _score(sets, found, cutoff, order)


def exact(
    truth: Array,
    truth_alive: Array,
    estimate: Array,
    estimate_alive: Array,
    cutoff: float,
    switch_cost: float,
    order: float = 2.0,
) -> Score:
    """Measures the same by HiGHS, on the host; `lower` and `distance` are equal.

    Args:
        truth: [T, N, P].
        truth_alive: [T, N] (bool).
        estimate: [T, L, P].
        estimate_alive: [T, L] (bool).
        cutoff: c, positive, in the unit of the points.
        switch_cost: Positive, in the unit of the points.
        order: p, at least 1 and finite.

    Returns:
        Six scalars.
    """
    _check(cutoff, switch_cost, order)
    sets = jax.jit(_compare)(
        truth, truth_alive, estimate, estimate_alive, cutoff, switch_cost, order
    )
    found = coupled.exact(np.asarray(_cost(sets)), float(sets.change_cost))
    dtype = sets.relative.dtype
    found = coupled.Coupled(*(jnp.asarray(x, dtype) for x in found))
    return jax.jit(_score)(sets, found, cutoff, order)


def over_time(
    truth: Array,
    truth_alive: Array,
    estimate: Array,
    estimate_alive: Array,
    cutoff: Array | float,
    switch_cost: Array | float,
    order: Array | float = 2.0,
    tolerance: Array | float = 1e-3,
) -> Score:
    """Measures, at each time k, the sets up to then, normalised by their length.

    Distances are divided by k^(1 / p), k from 1 to T, parts by k, so that they can be
    compared over time.

    Args:
        truth: [T, N, P].
        truth_alive: [T, N] (bool).
        estimate: [T, L, P], or what was thought of all times at each: [T, T, L, P].
        estimate_alive: [T, L] or [T, T, L] (bool).
        cutoff: As of `metric`, and so are the others.
        switch_cost: See there.
        order: See there.
        tolerance: See there.

    Returns:
        Six arrays [T].
    """
    num_times = len(truth)
    own = 0 if estimate.ndim == 4 else None

    def one(k: Array, estimate: Array, estimate_alive: Array) -> Score:
        so_far = (jnp.arange(num_times) <= k)[:, None]
        sets = truth, truth_alive & so_far, estimate, estimate_alive & so_far
        score = metric(*sets, cutoff, switch_cost, order, tolerance)
        power = jnp.asarray(k + 1, score.distance.dtype)
        length = power ** (1 / order)
        return Score(*(x / length for x in score[:2]), *(x / power for x in score[2:]))

    return jax.vmap(one, (0, own, own))(jnp.arange(num_times), estimate, estimate_alive)


def _check(
    cutoff: Array | float, switch_cost: Array | float, order: Array | float
) -> None:
    """Raises ValueError for a setting that no metric has."""
    assignment.check(cutoff, order)
    if isinstance(switch_cost, (int, float)) and not 0 < switch_cost < math.inf:
        raise ValueError(f"switch_cost is {switch_cost}; give a finite number above 0.")


def _compare(
    truth: Array,
    truth_alive: Array,
    estimate: Array,
    estimate_alive: Array,
    cutoff: Array | float,
    switch_cost: Array | float,
    order: Array | float,
) -> _Sets:
    """Measures all pairs at all times."""
    (times, rows, dim), columns = truth.shape, estimate.shape[1]
    chex.assert_shape(truth_alive, (times, rows))
    chex.assert_shape(estimate, (times, columns, dim))
    chex.assert_shape(estimate_alive, (times, columns))

    distance = jax.vmap(assignment.distances)(
        jnp.where(truth_alive[..., None], truth, 0),
        jnp.where(estimate_alive[..., None], estimate, 0),
    )
    close = truth_alive[:, :, None] & estimate_alive[:, None] & (distance < cutoff)
    near = jnp.where(close, distance, 0) / cutoff
    return _Sets(
        relative=jnp.where(close, near**order, 0),
        close=close,
        num_truth=truth_alive.sum(),
        num_estimate=estimate_alive.sum(),
        change_cost=jnp.asarray(switch_cost / cutoff, near.dtype) ** order / 2,
    )


def _cost(sets: _Sets) -> Array:
    """Returns what a pair costs more than its members apart, from -1 to 0."""
    return jnp.where(sets.close, sets.relative - 1, 0)


def _apart(sets: _Sets) -> Array:
    """Returns what all cost apart, without any pair."""
    return (sets.num_truth + sets.num_estimate).astype(sets.relative.dtype) / 2


def _score(
    sets: _Sets, found: coupled.Coupled, cutoff: Array | float, order: Array | float
) -> Score:
    """Splits the cost of a W into its parts."""
    paired = jnp.where(sets.close, found.weight, 0)
    num_paired = paired.sum()
    localisation = (paired * sets.relative).sum()
    missed = jnp.maximum(sets.num_truth - num_paired, 0) / 2
    false = jnp.maximum(sets.num_estimate - num_paired, 0) / 2
    switch = coupled.changes(found.weight, sets.change_cost)

    total = localisation + missed + false + switch
    lower = jnp.maximum(_apart(sets) + found.lower, 0)
    price = jnp.asarray(cutoff, total.dtype) ** order
    return Score(
        distance=cutoff * assignment.root(total, order),
        lower=cutoff * assignment.root(jnp.minimum(lower, total), order),
        localisation=price * localisation,
        missed=price * missed,
        false=price * false,
        switch=price * switch,
    )
