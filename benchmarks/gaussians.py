"""How fast is the update of a Gaussian mixture?

Every component with every detection: log-densities of all pairs, means of all
posteriors, and the posterior covariances, which no detection changes.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import climit, common, problems
from benchmarks.common import Job, Row, Size
from benchmarks.problems import Problem
from jaxtrack import kalman
from jaxtrack.types import Affine, Array, Gaussian

KIND = "float32"
TOLERANCE = 1e-4
COMPONENTS, DETECTIONS = 400, 30
Result = tuple[np.ndarray, np.ndarray, np.ndarray]


def update(
    sensor: Affine, beliefs: Gaussian, detections: Array
) -> tuple[Gaussian, Array]:
    """Updates N beliefs with K detections.

    Returns:
        Posteriors, mean [K, N, 4] and cov [N, 4, 4], and log-densities [K, N].
    """

    def one(belief: Gaussian, detection: Array) -> tuple[Gaussian, Array]:
        return kalman.update(belief, sensor, detection)

    axes: Any = 0, None  # no covariance depends on the detection
    return jax.vmap(jax.vmap(one, (0, None)), (None, 0), (Gaussian(*axes), 0))(
        beliefs, detections
    )


def problem_of(components: int, detections: int) -> Problem:
    """Draws a mixture, its means in place of the runs', and one scan."""
    rng = np.random.default_rng(0)
    spread = problems.linear(components, 1)._replace(
        mean=10 * rng.normal(size=(components, 4)),
        detections=10 * rng.normal(size=(1, detections, 2)),
    )
    return spread.to(KIND)


def reference(problem: Problem) -> Result:
    """Computes the same with NumPy; log-densities [K, N], means and covariances."""
    done = []
    for z in problem.detections[0]:
        surprise = z - problem.mean @ problem.matrix.T
        sensor = problem.matrix, problem.sensor_noise
        done.append(problems.update(problem.mean, problem.cov, *sensor, surprise))
    means, covs, densities = zip(*done, strict=True)
    return np.stack(densities), np.stack(means), covs[0]


def check(name: str, result: Result, answer: Result) -> float:
    """Returns the largest error of the three parts."""
    pairs = zip(result, answer, strict=True)
    return max(common.check(name, *pair, TOLERANCE) for pair in pairs)


def library(problem: Problem, answer: Result) -> Job:
    """Returns the library's update, checked."""
    sensor = Affine(problem.matrix, jnp.zeros(2), problem.sensor_noise)
    beliefs, detections = Gaussian(problem.mean, problem.cov), problem.detections[0]
    call, seconds = common.compiled(update, sensor, beliefs, detections)
    posterior, density = call()
    error = check("jaxtrack", (density, *posterior), answer)
    return Job("jaxtrack", call, density.size, seconds, error)


def loop(problem: Problem, answer: Result) -> Job | None:
    """Returns the loop in C, checked; None without a compiler."""
    size, num = len(problem.mean), len(problem.detections[0])
    mean, cov = common.runs_last(problem.mean, problem.cov)
    detections = problem.detections[0]
    density = np.empty((num, size), KIND)
    means, covs = np.empty((num, 4, size), KIND), np.empty((4, 4, size), KIND)
    given = problem.matrix, problem.sensor_noise, mean, cov, detections
    call = climit.call("gaussians", KIND, size, num, *given, density, means, covs)
    if call is None:
        return None
    call()
    result = density, means.transpose(0, 2, 1), covs.transpose(2, 0, 1)
    return Job("C", call, size * num, error=check("the loop in C", result, answer))


def rows_of(components: int, detections: int, rounds: int) -> list[Row]:
    """Times a mixture of one size."""
    problem = problem_of(components, detections)
    answer = reference(problem.to("float64"))
    with common.precision(KIND):
        own, limit = library(problem, answer), loop(problem, answer)
        them = [Job("NumPy", lambda: reference(problem), components * detections)]
        work = f"mixture update, {components} components, {detections} detections"
        return common.compare(work, KIND, own, them, limit, rounds, "pairs/s")


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    if size == common.QUICK:
        return rows_of(16, 3, size.rounds)
    return rows_of(COMPONENTS, DETECTIONS, size.rounds)


if __name__ == "__main__":
    common.main(rows)
