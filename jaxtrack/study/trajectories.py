"""Trackers scored over whole runs: by the trajectories known after each scan.

What a tracker says of the past changes with every scan, so that what is scored is, at
each time k, all trajectories as they are known then, up to k. Trackers that report
`paths` say so themselves; of others estimates with the same label are connected.

    >>> from jaxtrack.study import trajectories
    >>> trajectories.Scored._fields
    ('gospa', 'filtered', 'smoothed', 'dropped')

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, section VII.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import engine
from jaxtrack.metrics import gospa, trajectories
from jaxtrack.scenarios.world import Scenario, World
from jaxtrack.trackers.trajectories import Paths, assemble
from jaxtrack.types import Array, PyTree, Tracker


class Scored(NamedTuple):
    """How R runs of T scans went.

    Attributes:
        gospa: Of the targets that are there, each [R, T].
        filtered: The trajectory metric up to each scan, normalised by their number (see
            `metrics.trajectories.over_time`), without smoothing, each [R, T].
        smoothed: The same, of the trajectories as reported.
        dropped: Trajectories that found no room, at worst, [R].
    """

    gospa: gospa.Gospa
    filtered: trajectories.Score
    smoothed: trajectories.Score
    dropped: Array


def score_runs(
    scenario: Scenario,
    name: str,
    runs: int,
    switch_cost: float,
    max_trajectories: int = 48,
    seed: int = 0,
    block: int = 4,
) -> Scored:
    """Simulates, tracks and scores R runs; they are those of `engine.monte_carlo`.

    Args:
        scenario: What to track; cut-off and order are its own.
        name: Of one of its trackers.
        runs: R.
        switch_cost: Of the trajectory metric.
        max_trajectories: Scored at most.
        seed: Of the random data.
        block: Runs that are computed side by side, see `engine.map_runs`.
    """
    tracker, params = scenario.trackers[name]
    static = tracker, scenario.max_detections, max_trajectories
    values = params, scenario.world, scenario.cutoff, scenario.order, switch_cost
    keys = engine.run_keys(seed, 0, runs)
    axes = [None] * len(values) + [0]
    return engine.map_runs(
        _one, *values, keys, in_axes=axes, static=static, block=block
    )


def known(estimates: Any) -> Paths:
    """Returns the paths that a tracker reports, or makes them of its labels.

    Args:
        estimates: Any tracker's `Estimate` of T scans, with labels.
    """
    paths = getattr(estimates, "paths", None)
    if paths is not None:
        return paths
    mean, there = estimates.mean[:, :, None], estimates.exists[:, :, None]
    cov = estimates.cov[:, :, None]
    exists = there.astype(mean.dtype)
    return Paths(mean, cov, mean, exists, there, estimates.label)


def _one(
    tracker: Tracker,
    max_detections: int,
    size: int,
    params: PyTree,
    world: World,
    cutoff: Array,
    order: Array,
    switch_cost: Array,
    key: Array,
) -> Scored:
    """Scores one run."""
    _, told = engine.simulate_and_run(tracker, params, world, max_detections, key)
    place, truth = jnp.array(world.motion.position_index), world.truth
    where = truth.state[..., place]

    def one(x: Array, there: Array, mean: Array, exists: Array) -> gospa.Gospa:
        return gospa.gospa(x, there, mean[:, place], exists, cutoff, order)

    near = jax.vmap(one)(where, truth.exists, told.mean, told.exists)
    paths = known(told)

    def score(paths: Paths) -> tuple[trajectories.Score, Array]:
        each = jax.vmap(lambda k: assemble(paths, size, k))
        found = each(jnp.arange(len(where)))
        sets = where, truth.exists, found.mean[..., place], found.alive
        score = trajectories.over_time(*sets, cutoff, switch_cost, order)
        return score, found.dropped.max()

    filtered, dropped = score(paths._replace(mean=paths.filtered))
    return Scored(near, filtered, score(paths)[0], dropped)
