"""The loss of many recordings, and its slopes in the free numbers.

`Problem` is what a program depends on, `Data` the arrays that it takes; a fit of other
recordings of the same shape compiles nothing anew.

    >>> import jax, numpy as np
    >>> from jaxtrack.learn import slopes
    >>> data = slopes.gather(np.arange(12.0), truth=None, seed=0, several=False)
    >>> part = slopes.pick(jax.random.key(0), data, batch=None, window=5)
    >>> print(part.scans.shape, np.diff(part.scans[0]))
    (1, 5) [1. 1. 1. 1.]
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import engine
from jaxtrack.learn import leaves, recordings, segments
from jaxtrack.learn.loss import Loss, counted, mask_of
from jaxtrack.learn.sizes import needs_counts
from jaxtrack.types import Array, PyTree, Tracker

REDRAWN = 2  # no key of `pick`


class Problem(NamedTuple):
    """What is made small; static.

    Attributes:
        tracker: The tracker.
        plan: What of its `Params` is learned.
        loss: Of `learn.loss`.
        prior: (params) -> log-density, or None.
        batch: Recordings of a step, drawn anew for each; None for all.
        window: Scans of a step, drawn anew for each and each recording; None for all.
        block: Recordings that are computed side by side.
        segment: See `segments.run`.
        redraw: Whether trackers that draw do so anew in each step.
    """

    tracker: Tracker
    plan: leaves.Plan
    loss: Loss
    prior: Any
    batch: int | None
    window: int | None
    block: int
    segment: int | None
    redraw: bool = False


class Data(NamedTuple):
    """What is learned from.

    Attributes:
        scans: With a leading R, T.
        truth: What the loss is told besides, with a leading R, T; or None.
        keys: A tracker's random key for each recording, the same in every step, so
            that the loss is a function of the parameters alone, unless they are to be
            drawn anew; [R].
        length: How many of the scans there are, [R]; None if all.
    """

    scans: PyTree
    truth: PyTree
    keys: Array
    length: Array | None = None


class Slope(NamedTuple):
    """A place that a fit came to.

    Attributes:
        loss: A scalar.
        free: The free numbers, by path.
        gradient: Of the loss, by path.
        values: What the free numbers stand for, by path.
    """

    loss: Array
    free: leaves.Free
    gradient: leaves.Free
    values: dict[str, Array]


def gather(
    scans: PyTree,
    truth: PyTree,
    seed: int,
    several: bool = True,
    length: np.ndarray | None = None,
) -> Data:
    """Puts recordings together; a single one gets a leading axis of 1."""
    both = scans, truth
    if not several:
        both = jax.tree.map(lambda x: jnp.asarray(x)[None], both)
    scans, truth = jax.tree.map(jnp.asarray, both)
    number = len(jax.tree.leaves(scans)[0])
    told = None if length is None else jnp.asarray(length)
    return Data(scans, truth, engine.run_keys(seed, 0, number), told)


@functools.partial(jax.jit, static_argnums=0)
def slope(
    problem: Problem, params: PyTree, data: Data, free: leaves.Free, key: Array
) -> Slope:
    """Returns loss and slopes at free numbers.

    Args:
        problem: Static.
        params: Those at the start.
        data: Of all recordings.
        free: Free numbers.
        key: What batch and windows are drawn with, and trackers draw with anew.
    """

    def value(free: leaves.Free) -> Array:
        return value_of(problem, params, free, data, key)

    loss, gradient = jax.value_and_grad(value)(free)
    return Slope(loss, free, gradient, leaves.values_of(problem.plan, params, free))


def value_of(
    problem: Problem, params: PyTree, free: leaves.Free, data: Data, key: Array
) -> Array:
    """Returns the mean loss of a step's recordings, less the log-prior per scan."""
    params = leaves.constrain(problem.plan, params, free)
    if problem.redraw:  # apart from what batch and windows are drawn with
        fresh = jax.random.split(jax.random.fold_in(key, REDRAWN), len(data.keys))
        data = data._replace(keys=fresh)
    part = pick(key, data, problem.batch, problem.window)
    each = engine.map_runs(
        _one,
        params,
        part,
        in_axes=(None, 0),
        static=(problem.tracker, problem.loss, problem.window, problem.segment),
        block=problem.block,
    )
    mean = each.mean()
    if part.length is not None:
        # Not by the weight of this batch: its mean over batches would be another one.
        mean = (each * _counted(problem, part)).mean() / _counted(problem, data).mean()
    if problem.prior is None:
        return mean
    density = problem.prior(params)
    _check_scalar("prior", density)
    return mean - density / num_scans(problem, data)


def is_noisy(problem: Problem) -> bool:
    """Returns whether every step draws anew, scans or what a tracker draws."""
    return problem.redraw or problem.batch is not None or problem.window is not None


def num_scans(problem: Problem, data: Data) -> int | Array:
    """Returns how many scans of all recordings the loss is a mean of."""
    if data.length is not None:
        return _counted(problem, data).sum()
    number, total = jax.tree.leaves(data.scans)[0].shape[:2]
    # With windows each scan comes to be among the last ones of some.
    told = counted(problem.loss, total) if problem.window is None else None
    return number * (total if told is None else told)


def _counted(problem: Problem, data: Data) -> Array:
    """Returns how many scans of each recording count, [R]."""
    assert data.length is not None
    if problem.window is not None:  # each scan comes to be among the last ones of some
        return data.length
    total = jax.tree.leaves(data.scans)[0].shape[1]
    count = functools.partial(mask_of, problem.loss, total)
    return jax.vmap(count)(data.length).sum(1)


def pick(key: Array, data: Data, batch: int | None, window: int | None) -> Data:
    """Draws the recordings of a step, and where each one's window begins."""
    batch_key, window_key = jax.random.split(key)
    if batch is not None:
        chosen = jax.random.choice(batch_key, len(data.keys), (batch,), replace=False)
        data = jax.tree.map(lambda x: x[chosen], data)
    if window is None:
        return data
    number, total = jax.tree.leaves(data.scans)[0].shape[:2]
    end = total if data.length is None else data.length
    first = jax.random.randint(window_key, (number,), 0, end - window + 1)

    def cut(x: Array) -> Array:
        one = functools.partial(jax.lax.dynamic_slice_in_dim, slice_size=window)
        return jax.vmap(one)(x, first)

    scans, truth = jax.tree.map(cut, (data.scans, data.truth))
    return data._replace(scans=scans, truth=truth)


def _one(
    tracker: Tracker,
    loss: Loss,
    window: int | None,
    segment: int | None,
    params: PyTree,
    data: Data,
) -> Array:
    """Returns the loss of one recording."""
    told = (data.scans,) if data.truth is None else (data.scans, data.truth)
    total = len(jax.tree.leaves(data.scans)[0])
    more = {"counts": jnp.ones(total, bool)} if needs_counts(loss, len(told)) else {}
    if data.length is not None and window is None:  # a window has no scans but its own
        tracker = recordings.stopped(tracker, data.length)
        more = {"counts": mask_of(loss, total, data.length)}
    estimates = segments.run(tracker, params, data.scans, data.keys, segment)
    value = loss(estimates, *told, **more)
    _check_scalar("loss", value)
    return value


def _check_scalar(name: str, value: Any) -> None:
    """Refuses what a function of the caller's returned, before all else does."""
    leaf = jax.tree.structure(value) == jax.tree.structure(0)
    if not (leaf and jnp.shape(value) == ()):
        shape = f"shape {jnp.shape(value)}" if leaf else f"a {type(value).__name__}"
        raise ValueError(f"the {name} returns {shape}; return a scalar, as of .mean()")
    if not jnp.issubdtype(jnp.result_type(value), jnp.floating):
        kind = jnp.result_type(value)
        raise ValueError(f"the {name} returns {kind}, not a float; it has no slope")
