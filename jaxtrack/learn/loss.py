"""What a fit makes small: a number for the estimates of one recording.

A loss is a function (estimates, scans) -> scalar, of a tracker's `Estimate` and of
scans with a leading T, or (estimates, scans, truth) where `fit` is given the truth. It
should be a mean over scans, so that step sizes do not depend on T. One that takes
`counts` [T] (bool), named, is also told which scans those are: recordings of unequal
length are filled up at the end. `evidence` and `held_out` need no truth; `ospa` and
`gospa` are the metrics in a form with slopes:

- an estimate counts with its probability to exist, as Xia et al. have it, and
- Sinkhorn's shares stand for the assignment (`assign.soft`). As the temperature falls,
  and where existence is 0 or 1, they are the metrics themselves.

    >>> import types
    >>> import numpy as np
    >>> from jaxtrack.learn import loss
    >>> estimates = types.SimpleNamespace(log_evidence=np.array([-1.0, -3.0, -6.0]))
    >>> print(loss.evidence(estimates, None), loss.held_out(0.5)(estimates, None))
    3.3333333333333335 4.5

References: Xia, Garcia-Fernandez, Karlsson, Ge, Svensson and Yuan, "Probabilistic
GOSPA: a metric for performance evaluation of multi-object filters with uncertainties",
2024; Cuturi, "Sinkhorn distances", NeurIPS, 2013.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import assign
from jaxtrack.metrics import assignment
from jaxtrack.types import Array

Loss = Callable[..., Array]


def evidence(estimates: Any, scans: Any, *, counts: Array | None = None) -> Array:
    """Returns the negative log-evidence per scan, a scalar."""
    del scans
    return -_mean(estimates.log_evidence, counts)


@functools.cache
def held_out(fraction: float) -> Loss:
    """Makes the negative log-evidence per scan of the last scans, given the first.

    With windows it is the evidence after the tracks have begun.

    Args:
        fraction: Share of the scans that count, the last ones.

    Raises:
        ValueError: It is not above 0 and at most 1.
    """
    if not 0 < fraction <= 1:
        raise ValueError(f"fraction is {fraction}; give a number above 0, at most 1")

    return functools.partial(_held_out, fraction)


def counted(loss: Loss, num_scans: int) -> int | None:
    """Returns of how many scans of a recording a loss is the negative log-evidence.

    Args:
        loss: `evidence`, one of `held_out`, or any other.
        num_scans: T.

    Returns:
        How many, of which the loss is the mean; None for any other loss.
    """
    if loss is evidence:
        return num_scans
    if isinstance(loss, functools.partial) and loss.func is _held_out:
        return math.ceil(loss.args[0] * num_scans)
    return None


def mask_of(loss: Loss, num_scans: int, length: Array) -> Array:
    """Returns which scans count of a recording that was filled up, [T] (bool).

    Args:
        loss: See `counted`; of any other all scans count that there are.
        num_scans: T.
        length: How many there are.
    """
    last = []
    for size in range(num_scans + 1):
        told = counted(loss, size)
        last.append(size if told is None else told)
    scan = jnp.arange(num_scans)
    return (scan >= length - jnp.array(last)[length]) & (scan < length)


@functools.cache
def gospa(
    position_index: tuple[int, ...],
    cutoff: float,
    order: float = 2.0,
    temperature: float = 0.05,
) -> Loss:
    """Makes the mean over scans of GOSPA, alpha = 2, of estimates that may exist.

    Args:
        position_index: Where the positions stand in the state, of estimates and truth.
        cutoff: c, positive; a pair farther apart is none, and has no slope.
        order: p, at least 1.
        temperature: Of the shares, in units of c^p. Near 0 they are an assignment.

    Returns:
        (estimates, scans, truth) -> scalar; the truth has `state` [T, N, D] and
        `exists` [T, N], as `scenarios.world.Truth` does.

    Raises:
        ValueError: A number that makes no sense.
    """
    _check(cutoff, order, temperature)

    def scan(place: Array, there: Array, mean: Array, prob: Array) -> Array:
        paired = _gain(place, there, mean, prob, cutoff, order, temperature)
        power = (there.sum() + prob.sum()) / 2 - paired
        return cutoff * assignment.root(power, order)

    return functools.partial(_mean_over_scans, scan, position_index)


@functools.cache
def ospa(
    position_index: tuple[int, ...],
    cutoff: float,
    order: float = 2.0,
    temperature: float = 0.05,
) -> Loss:
    """Makes the mean over scans of OSPA, of estimates that may exist.

    The number of estimates is the expected one. Arguments and errors are those of
    `gospa`.
    """
    _check(cutoff, order, temperature)

    def scan(place: Array, there: Array, mean: Array, prob: Array) -> Array:
        paired = _gain(place, there, mean, prob, cutoff, order, temperature)
        larger = jnp.maximum(there.sum(), prob.sum())
        some = larger > 0
        power = jnp.where(some, 1 - paired / jnp.where(some, larger, 1.0), 0.0)
        return cutoff * assignment.root(power, order)

    return functools.partial(_mean_over_scans, scan, position_index)


def _held_out(
    fraction: float, estimates: Any, scans: Any, *, counts: Array | None = None
) -> Array:
    del scans
    told = estimates.log_evidence
    if counts is not None:
        return -_mean(told, counts)
    return -told[-math.ceil(fraction * len(told)) :].mean()


def _mean(value: Array, counts: Array | None) -> Array:
    """Returns the mean over the scans that count."""
    if counts is None:
        return value.mean()
    return jnp.where(counts, value, 0.0).sum() / counts.sum()


def _mean_over_scans(
    scan: Callable[..., Array],
    position_index: tuple[int, ...],
    estimates: Any,
    scans: Any,
    truth: Any,
    *,
    counts: Array | None = None,
) -> Array:
    del scans
    index = np.array(position_index)
    each = jax.vmap(scan)(
        truth.state[..., index],
        truth.exists,
        estimates.mean[..., index],
        estimates.existence_prob,
    )
    return _mean(each, counts)


def _gain(
    place: Array,
    there: Array,
    mean: Array,
    prob: Array,
    cutoff: float,
    order: float,
    temperature: float,
) -> Array:
    """Returns by how much pairs lower what the sets cost apart, in units of c^p.

    A pair of a truth and an estimate of probability r at distance d costs r d^p +
    (1 - r) c^p / 2 in place of (1 + r) c^p / 2: it gains r (c^p - d^p).

    Args:
        place: True positions, [N, P].
        there: [N] (bool).
        mean: Estimated positions, [L, P].
        prob: [L].
        cutoff: c.
        order: p.
        temperature: Of the shares, in units of c^p.
    """
    distance = assignment.distances(mean, jnp.where(there[:, None], place, 0.0))
    close = there[None] & (prob > 0)[:, None] & (distance < cutoff)
    relative = jnp.where(close, distance, 0.0) / cutoff
    gain = jnp.where(close, prob[:, None] * (1 - relative**order), -jnp.inf)
    score = jnp.pad(gain, ((0, 0), (0, 1)))
    share = assign.soft.soft(score, temperature).prob[:, :-1]
    return (jnp.where(close, share, 0.0) * jnp.where(close, gain, 0.0)).sum()


def _check(cutoff: float, order: float, temperature: float) -> None:
    assignment.check(cutoff, order)
    if not temperature > 0:
        raise ValueError(f"temperature is {temperature}; give a number above 0")
