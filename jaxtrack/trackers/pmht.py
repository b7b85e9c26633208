"""Probabilistic MHT over a sliding window: known targets, soft associations.

With every scan the paths through the last scans are found anew by `pmht_batch.smooth`,
from what was believed before the window began. What leaves the window leaves with the
weights that it had last, and is not thought over again. The estimate is about the end
of the window; `pmht_batch` has paths, and what is known to be wrong with the method.

    >>> from jaxtrack.trackers import pmht
    >>> tracker = pmht.pmht(num_scans=5)

`log_evidence` is the log-density of the scan under the method's own model, in which
detections are independent, given what a pass forward through the window believes.

References: Streit and Luginbuhl, "Probabilistic multi-hypothesis tracking", NUWC-NPT
Technical Report 10428, 1995; Willett, Ruan and Streit, "PMHT: problems and some
solutions", IEEE Trans. Aerospace and Electronic Systems 38(3), 2002.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linearize
from jaxtrack.trackers import pmht_batch, recent, thinning
from jaxtrack.trackers.bernoulli import Estimate
from jaxtrack.trackers.pmht_batch import Params
from jaxtrack.trackers.recent import Recent
from jaxtrack.types import Array, Gaussian, Scan, Tracker


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        begun: The targets before the window, mean [N, D], cov [N, D, D].
        window: The last W - 1 scans; those before the first are empty and take no time.
    """

    begun: Gaussian
    window: Recent


class Settings(NamedTuple):
    """The maker's arguments."""

    num_scans: int
    num_iterations: int
    max_detections: int
    method: linearize.Method


@functools.cache
def pmht(
    num_scans: int = 5,
    num_iterations: int = 10,
    max_detections: int = 128,
    method: linearize.Method = linearize.taylor,
) -> Tracker:
    """Makes the tracker of the targets of `params.start`, all of which stay.

    Args:
        num_scans: W, scans in the window.
        num_iterations: Of expectation-maximisation, at every scan.
        max_detections: Room for those of a scan, K; `dropped` counts what is beyond.
        method: Of `linearize`; idle where models are linear.

    Raises:
        ValueError: A setting that makes no sense.
    """
    sizes = {
        "num_scans": num_scans,
        "num_iterations": num_iterations,
        "max_detections": max_detections,
    }
    thinning.check_sizes(sizes)
    settings = Settings(num_scans, num_iterations, max_detections, method)
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with the known targets, before a window in which nobody looked."""
    del key
    pmht_batch.check(params, settings.num_iterations)
    mean, cov = jnp.asarray(params.start.mean), jnp.asarray(params.start.cov)
    outputs = jnp.zeros(params.target.sensor.num_outputs, mean.dtype)
    window = recent.begin(settings.num_scans - 1, settings.max_detections, outputs)
    return State(Gaussian(mean, cov), window)


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Smooths over the window, and lets its first scan go."""
    window, lost = recent.push(state.window, scan)
    begun = params.start._replace(mean=state.begun.mean, cov=state.begun.cov)
    found = pmht_batch.smooth(
        params._replace(start=begun),
        window.scans,
        settings.num_iterations,
        settings.method,
    )
    prob = jnp.asarray(params.start.existence_prob)
    number = jnp.arange(prob.size)
    estimate = Estimate(
        mean=found.belief.mean[:, -1],
        cov=found.belief.cov[:, -1],
        label=jnp.where(prob > 0, number, -1),
        exists=prob > 0.5,
        existence_prob=prob,
        mode_prob=jnp.ones((prob.size, 1), prob.dtype),
        effective_size=jnp.zeros_like(prob),
        num_mean=prob.sum(),
        num_var=(prob * (1 - prob)).sum(),
        log_evidence=found.log_density[-1],
        dropped=lost.astype(prob.dtype),
    )
    first = jax.tree.map(lambda x: x[:, 0], found.filtered.filtered)
    return State(first, recent.pop(window)), estimate
