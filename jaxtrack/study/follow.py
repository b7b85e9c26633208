"""Trackers that were told their targets, followed through many runs.

>>> from jaxtrack.study import follow
>>> follow.Followed._fields
('errors', 'association_prob', 'num_active')
"""

import functools
from typing import NamedTuple

import jax

from jaxtrack import engine
from jaxtrack.metrics import errors
from jaxtrack.scenarios.world import Scenario, World
from jaxtrack.targets import likely_modes
from jaxtrack.types import Array, PyTree, Tracker


class Followed(NamedTuple):
    """How the tracks with the targets' numbers for labels went.

    Attributes:
        errors: Of position and velocity, each [R, T, N].
        association_prob: Which detection was theirs; last column none, [R, T, N,
            K + 1]. Where everything is detected, detection n is target n's.
        num_active: Modes of positive probability, [R, T, N] (int).
    """

    errors: errors.Errors
    association_prob: Array
    num_active: Array


def follow(scenario: Scenario, name: str, runs: int, seed: int = 0) -> Followed:
    """Simulates and tracks R runs, and follows each target's track.

    Args:
        scenario: One whose trackers are told the targets at the start.
        name: Of a tracker of the family of `trackers.single_scan`.
        runs: R.
        seed: Of the random data; the runs are those of `engine.monte_carlo`.
    """
    tracker, params = scenario.trackers[name]
    keys = engine.run_keys(seed, 0, runs)
    return _runs(tracker, scenario.max_detections, params, scenario.world, keys)


def swapped(followed: Followed) -> Array:
    """Returns in which runs a target's last detection is not its track's own, [R].

    Only for worlds in which everything is detected, and no clutter.
    """
    own = followed.association_prob[:, -1].diagonal(axis1=1, axis2=2)
    return (own < 0.5).any(1)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _runs(
    tracker: Tracker, max_detections: int, params: PyTree, world: World, keys: Array
) -> Followed:
    def one(key: Array) -> Followed:
        _, told = engine.simulate_and_run(tracker, params, world, max_detections, key)
        truth, num = world.truth, world.truth.exists.shape[1]
        modes, _ = errors.of_labels(told.mode_prob, told, num)
        shares, _ = errors.of_labels(told.association_prob, told, num)
        return Followed(
            errors.errors(truth.state, truth.exists, told, world.motion),
            shares,
            jax.vmap(jax.vmap(likely_modes.num_active))(modes),
        )

    return jax.vmap(one)(keys)
