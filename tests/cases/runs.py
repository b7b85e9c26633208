"""Runs of the trackers, each compiled once for all tests.

Alone with gradients, over a batch of variants (with more padding) and of steps for
finite differences, with large capacities, and in float32.
"""

import functools
from typing import Any, NamedTuple

import jax
import numpy as np
from cases import slopes
from cases.trackers import case_of, random_scans, tracker_of, variants

from jaxtrack import engine

KEY = np.array(jax.random.key_data(jax.random.key(0)))
STEP = 1e-6  # of differences: a large one would change which tracks are kept


def to_numpy(tree):
    return jax.tree.map(np.array, tree)


def evidence_and_estimates(tracker, params, scans):
    estimates = engine.run(tracker, params, scans, jax.random.wrap_key_data(KEY))
    return estimates.log_evidence.sum(), estimates


@functools.cache
def runner(name):
    """(params, scans) -> ((evidence, estimates), slope in params), without a batch."""
    function = functools.partial(evidence_and_estimates, tracker_of(name))
    return jax.jit(jax.value_and_grad(function, has_aux=True))


@functools.cache
def alone(name):
    """The evidence and estimates of the base scans, and the gradient in params."""
    return to_numpy(runner(name)(case_of(name).params, random_scans(name, 0)))


class Batch(NamedTuple):
    """Estimates of all variants by name, and the slopes of the base's evidence."""

    variant: dict
    slopes: Any
    scale: Any


@functools.cache
def batched(name):
    params, named = case_of(name).params, variants(name)
    moved, scale = slopes.walks(params, floor=0.1, step=STEP)
    size = 2 * len(scale)

    def joined(same, each):
        return np.concatenate([same, each])

    same = jax.tree.map(lambda x: np.stack([x] * len(named)), params)
    scans = jax.tree.map(lambda *x: np.stack(x), *named.values())
    base = jax.tree.map(lambda x: np.stack([x] * size), named["base"])
    function = functools.partial(evidence_and_estimates, tracker_of(name))
    run = jax.jit(jax.vmap(function))
    _, estimates = to_numpy(
        run(jax.tree.map(joined, same, moved), jax.tree.map(joined, scans, base))
    )
    pick = {
        key: jax.tree.map(lambda x, i=i: x[i], estimates) for i, key in enumerate(named)
    }
    evidence = estimates.log_evidence[len(named) :].sum(1)
    return Batch(pick, slopes.differences(evidence, STEP), scale)


@functools.cache
def roomy(name):
    """The estimates of the base scans with large capacities."""
    function = functools.partial(evidence_and_estimates, tracker_of(name, large=True))
    return to_numpy(jax.jit(function)(case_of(name).params, random_scans(name, 0)))[1]


@functools.cache
def in_float32(name):
    """The estimates of the base scans in float32, where that is the default."""

    def narrow(x):
        return np.array(x, np.float32) if x.dtype == np.float64 else np.array(x)

    args = jax.tree.map(narrow, (case_of(name).params, random_scans(name, 0)))
    with jax.enable_x64(False):
        function = functools.partial(evidence_and_estimates, tracker_of(name))
        return to_numpy(jax.jit(function)(*args))[1]
