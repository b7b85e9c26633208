"""How fast is the Kalman filter?

Four states, two outputs. Dense: transition and sensor are arrays, of which nothing is
known. Models: `ConstantVelocity` and `Position`, whose zeros and ones the library
knows. The C loop is the dense one for all.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import climit, common, peers, problems
from benchmarks.common import Job, Row, Size
from benchmarks.problems import Problem
from jaxtrack import kalman, linearize
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.sensor import Position
from jaxtrack.types import Affine, Array, Gaussian

TOLERANCE = {"float32": 2e-4, "float64": 1e-8}


def log_likelihood(
    motion: Affine, sensor: Affine, prior: Gaussian, detections: Array
) -> Array:
    """Returns the log-density of the detections [T, 2] of one run."""

    def step(belief: Gaussian, detection: Array) -> tuple[Gaussian, Array]:
        return kalman.update(kalman.predict(belief, motion), sensor, detection)

    return jax.lax.scan(step, prior, detections)[1].sum()


def model_log_likelihood(
    motion: Any, sensor: Any, interval: Array, prior: Gaussian, detections: Array
) -> Array:
    """Returns the same through models."""

    def step(belief: Gaussian, detection: Array) -> tuple[Gaussian, Array]:
        move = linearize.motion_affine(motion, belief, interval, linearize.taylor)
        belief = kalman.predict(belief, move)
        look = linearize.sensor_affine(sensor, motion, belief, linearize.taylor)
        return kalman.update(belief, look, detection, sensor.residual)

    return jax.lax.scan(step, prior, detections)[1].sum()


def all_beliefs(
    motion: Affine, sensor: Affine, prior: Gaussian, detections: Array
) -> Gaussian:
    """Returns the filtered beliefs of one run, mean [T, 4] and cov [T, 4, 4]."""
    scans = len(detections)
    motions, sensors = jax.tree.map(lambda x: jnp.stack([x] * scans), (motion, sensor))
    seen = jnp.ones(scans, bool)
    return kalman.filter(prior, motions, sensors, detections, seen).filtered


def dense(problem: Problem) -> tuple[Affine, Affine]:
    """Returns motion and sensor as arrays."""
    motion = Affine(problem.transition, np.zeros_like(problem.mean[0]), problem.noise)
    nothing = np.zeros_like(problem.sensor_noise[0])
    return motion, Affine(problem.matrix, nothing, problem.sensor_noise)


def models() -> tuple[ConstantVelocity, Position, Array]:
    """Returns the same as models, and the interval."""
    motion = ConstantVelocity(problems.DENSITY * jnp.ones(2))
    sensor = Position(problems.SENSOR_STD * jnp.ones(2))
    return motion, sensor, jnp.asarray(problems.INTERVAL)


def loop(
    problem: Problem, check: Callable[[str, Any], float], keep: bool = False
) -> Job | None:
    """Returns the loop in C, checked; None without a compiler.

    Args:
        problem: The runs.
        check: (name, result) -> error; of the log-densities, or with `keep` of the
            filtered beliefs, mean [R, T, 4] and cov [R, T, 4, 4].
        keep: Whether all beliefs are kept.
    """
    runs, scans, _ = problem.detections.shape
    kind, kept = problem.mean.dtype.name, scans if keep else 1
    mean, cov = np.empty((kept, 4, runs), kind), np.empty((kept, 4, 4, runs), kind)
    total = np.empty(runs, kind)
    last = common.runs_last(problem.mean, problem.cov, problem.detections)
    outputs = mean, cov, total, int(keep)
    call = climit.call("kalman", kind, runs, scans, *problem[:4], *last, *outputs)
    if call is None:
        return None
    call()
    beliefs = np.moveaxis(mean, -1, 0), np.moveaxis(cov, -1, 0)
    check("the loop in C", beliefs if keep else total)
    return Job("C", call, runs * scans)


def others(problem: Problem, check: Callable[[str, Any], float]) -> list[Job]:
    """Returns the peers that compute log-likelihoods, checked."""
    runs, scans, _ = problem.detections.shape
    num, calls = min(runs, peers.FEW), []
    if peers.installed("dynamax"):
        function, arguments = peers.dynamax_kalman(problem, lambda x: x.marginal_loglik)
        calls.append(("dynamax", common.compiled(function, *arguments)[0], runs))
    calls.append(("NumPy", lambda: problems.kalman(problem).log_density, runs))
    if problem.mean.dtype == "float64" and peers.installed("filterpy"):
        calls.append(("FilterPy", lambda: peers.filterpy_kalman(problem), num))
    if problem.mean.dtype == "float64" and peers.installed("stonesoup"):
        calls.append(("Stone Soup", peers.stonesoup_kalman(problem), num))
    return [
        Job(name, call, many * scans, error=check(name, call()))
        for name, call, many in calls
    ]


def keeping(problem: Problem, check: Callable[[str, Any], float]) -> list[Job]:
    """Returns dynamax when all filtered beliefs are kept, checked."""
    if not peers.installed("dynamax"):
        return []
    function, arguments = peers.dynamax_kalman(
        problem, lambda x: (x.filtered_means, x.filtered_covariances)
    )
    call, _ = common.compiled(function, *arguments)
    runs, scans, _ = problem.detections.shape
    return [Job("dynamax", call, runs * scans, error=check("dynamax", call()))]


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    exact = problems.linear(size.runs, size.scans)
    answer = problems.kalman(exact)
    made = []
    for kind in ("float32", "float64"):
        problem, tolerance = exact.to(kind), TOLERANCE[kind]

        def totals(name: str, result: Any, tolerance: float = tolerance) -> float:
            expected = answer.log_density[: len(result)]
            return common.check(name, result, expected, tolerance)

        def beliefs(name: str, result: Any, tolerance: float = tolerance) -> float:
            common.check(name, result[0], answer.mean, tolerance)
            return common.check(name, result[1], answer.cov, tolerance)

        with common.precision(kind):
            limit, rounds = loop(problem, totals), size.rounds
            own = common.library(log_likelihood, dense(problem), problem, totals)
            them = others(problem, totals)
            work = "Kalman filter, dense, log-likelihood"
            made += common.compare(work, kind, own, them, limit, rounds)

            own = common.library(model_log_likelihood, models(), problem, totals)
            work = "Kalman filter, models, log-likelihood"
            made += common.compare(work, kind, own, them[:1], limit, rounds)

            own = common.library(all_beliefs, dense(problem), problem, beliefs)
            work, limit = (
                "Kalman filter, dense, all beliefs",
                loop(problem, beliefs, keep=True),
            )
            them = keeping(problem, beliefs)
            made += common.compare(work, kind, own, them, limit, rounds)
    return made


if __name__ == "__main__":
    common.main(rows)
