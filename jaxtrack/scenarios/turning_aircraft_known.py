"""The three turning aircraft with known association: an IMM filter for each.

What a tracker could do at best if it knew which detection is whose: every aircraft is
detected in every scan, and nothing is false.

    >>> import jax
    >>> from jaxtrack.scenarios import turning_aircraft, turning_aircraft_known
    >>> scenario = turning_aircraft.make(interval=10.0)
    >>> key = jax.random.key(0)
    >>> path = turning_aircraft_known.follow(scenario, "p1", key)
    >>> path.mean.shape, path.mode_prob.shape
    ((50, 3, 4), (50, 3, 2))

Reference: Liu, Shen, Wang and Meng, "Randomized multimodel multiple hypothesis
tracking", 2021, supplement, figures E2(a) and E3.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.probability import Constant
from jaxtrack.scenarios import world
from jaxtrack.scenarios.world import Scenario
from jaxtrack.targets import imm
from jaxtrack.types import Array, Gaussian, Mixture, Scan


class Path(NamedTuple):
    """What is believed of three aircraft over T scans.

    Attributes:
        mean: [T, 3, 4].
        mode_prob: [T, 3, M].
        error: Of the positions, metres, [T, 3]; where no two aircraft are mistaken for
            each other its mean is OSPA of order 1.
    """

    mean: Array
    mode_prob: Array
    error: Array


def follow(scenario: Scenario, name: str, key: Array) -> Path:
    """Follows the aircraft through one run.

    Args:
        scenario: Made by `turning_aircraft.make`.
        name: Of the transition matrix, as in `turning_aircraft_trackers.TRANSITIONS`.
        key: Random key.
    """
    target, there = imm.imm(), scenario.world
    params = scenario.trackers[f"imm-mht-{name}"][1]
    sure = Constant(jnp.ones(()))
    nothing = there.clutter._replace(rate=jnp.zeros(()))
    scans: Any = world.observe(
        key, there.truth, there.motion, there.sensor, sure, nothing, 3
    )
    prior = Gaussian(params.start.mean, params.start.cov)
    begin = jax.vmap(target.begin, (None, 0, 0, None))
    banks = begin(params.target, prior, params.start.mode_prob, key)

    def one(bank: Mixture, detection: Array, interval: Array) -> Mixture:
        bank, _ = target.predict(params.target, bank, interval)
        return target.correct(
            params.target, target.look(params.target, bank), detection
        )

    def step(banks: Mixture, scan: Scan) -> tuple[Mixture, tuple[Array, Array]]:
        banks = jax.vmap(one, (0, 0, None))(banks, scan.detections, scan.interval)
        mean = jax.vmap(target.moments)(banks).mean
        return banks, (mean, jax.vmap(target.modes)(banks))

    _, (mean, mode_prob) = jax.lax.scan(step, banks, scans)
    index = jnp.array(params.target.layout.position_index)
    off = (mean - there.truth.state)[..., index]
    return Path(mean, mode_prob, jnp.sqrt((off * off).sum(-1)))
