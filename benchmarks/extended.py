"""How fast are the extended and the unscented Kalman filter?

A coordinated turn at an unknown rate, seen in range and bearing: through the library's
models, and with two plain Python functions of a user, whose Jacobians are found by
automatic differentiation. The C loop has its Jacobians by hand.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import climit, common, peers, problems
from benchmarks.common import Job, Row, Size
from benchmarks.problems import Problem
from jaxtrack import kalman, linearize
from jaxtrack.models.sensor import RangeBearing
from jaxtrack.models.turn import TurnRate
from jaxtrack.types import Array, Gaussian

KIND = "float32"
TOLERANCE = 2e-3  # of float32 with angles


def model_log_likelihood(
    method: linearize.Method,
    motion: TurnRate,
    sensor: RangeBearing,
    interval: Array,
    prior: Gaussian,
    detections: Array,
) -> Array:
    """Returns the log-density of the detections [T, 2] of one run."""

    def step(belief: Gaussian, detection: Array) -> tuple[Gaussian, Array]:
        move = linearize.motion_affine(motion, belief, interval, method)
        belief = kalman.predict(belief, move)
        look = linearize.sensor_affine(sensor, motion, belief, method)
        return kalman.update(belief, look, detection, sensor.residual)

    return jax.lax.scan(step, prior, detections)[1].sum()


def own_log_likelihood(
    noise: Array, sensor_noise: Array, prior: Gaussian, detections: Array
) -> Array:
    """Returns the same from a user's functions."""

    def step(belief: Gaussian, detection: Array) -> tuple[Gaussian, Array]:
        move = linearize.taylor(peers.turn, belief, noise)
        belief = kalman.predict(belief, move)
        look = linearize.taylor(peers.look, belief, sensor_noise)
        return kalman.update(belief, look, detection)

    return jax.lax.scan(step, prior, detections)[1].sum()


def models() -> tuple[TurnRate, RangeBearing, Array]:
    """Returns motion, sensor and interval."""
    motion = TurnRate(jnp.asarray(problems.DENSITY), jnp.asarray(problems.TURN_DENSITY))
    radar = RangeBearing(jnp.array(problems.RADAR_STD), jnp.zeros(2), jnp.zeros(()))
    return motion, radar, jnp.asarray(problems.INTERVAL)


def loop(problem: Problem, check: Callable) -> Job | None:
    """Returns the loop in C, checked; None without a compiler."""
    runs, scans, _ = problem.detections.shape
    last = common.runs_last(problem.mean, problem.cov, problem.detections)
    noises = problem.noise, problem.sensor_noise
    mean, cov, total = (np.empty((n, runs), KIND) for n in (5, 25, 1))
    arguments = runs, scans, problems.INTERVAL, *noises, *last, mean, cov, total
    call = climit.call("extended", KIND, *arguments)
    if call is None:
        return None
    call()
    return Job("C", call, runs * scans, error=check("the loop in C", total[0]))


def dynamax(exact: Problem, unscented: bool, check: Callable) -> list[Job]:
    """Returns dynamax's filter, checked."""
    function, arguments = peers.dynamax_turning(exact, unscented)
    arguments = jax.tree.map(lambda x: np.asarray(x, KIND), arguments)
    call, _ = common.compiled(function, *arguments)
    items = exact.detections[..., 0].size
    return [Job("dynamax", call, items, error=check("dynamax", call()))]


def filterpy(exact: Problem, check: Callable) -> list[Job]:
    """Returns FilterPy's extended filter on a few runs, checked."""
    call = functools.partial(peers.filterpy_extended, exact)
    result = call()
    items = result.size * exact.detections.shape[1]
    return [Job("FilterPy", call, items, error=check("FilterPy", result))]


def extended_rows(size: Size, exact: Problem) -> list[Row]:
    """Times the extended filter, through models and through functions."""
    answer, problem = problems.extended(exact).log_density, exact.to(KIND)

    def check(name: str, result: Any) -> float:
        return common.check(name, result, answer[: len(result)], TOLERANCE)

    limit, them = loop(problem, check), []
    if peers.installed("dynamax"):
        them += dynamax(exact, False, check)
    if peers.installed("filterpy"):
        them += filterpy(exact, check)

    function = functools.partial(model_log_likelihood, linearize.taylor)
    own = common.library(function, models(), problem, check)
    work = "extended Kalman filter, models"
    made = common.compare(work, KIND, own, them, limit, size.rounds)

    noises = problem.noise, problem.sensor_noise
    own = common.library(own_log_likelihood, noises, problem, check)
    work = "extended Kalman filter, a user's functions"
    return made + common.compare(work, KIND, own, them[:1], limit, size.rounds)


def unscented_rows(size: Size, exact: Problem) -> list[Row]:
    """Times the unscented filter beside dynamax, whose float64 is the reference."""
    if not peers.installed("dynamax"):
        return []
    with common.precision("float64"):
        function, arguments = peers.dynamax_turning(exact, unscented=True)
        answer = common.compiled(function, *arguments)[0]()

    def check(name: str, result: Any) -> float:
        return common.check(name, result, answer, TOLERANCE)

    function = functools.partial(model_log_likelihood, linearize.unscented)
    own = common.library(function, models(), exact.to(KIND), check)
    them = dynamax(exact, True, check)
    work = "unscented Kalman filter, models"
    return common.compare(work, KIND, own, them, rounds=size.rounds)


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    exact = problems.turning(size.runs, size.scans)
    with common.precision(KIND):
        return extended_rows(size, exact) + unscented_rows(size, exact)


if __name__ == "__main__":
    common.main(rows)
