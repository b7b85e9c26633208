"""What does a gradient cost, and is it right?

The log-likelihood of all runs is differentiated by the noises of motion and sensor, two
numbers each, where a fit would begin: a fifth above the truth. (At the truth the slopes
of the runs cancel, and rounding is compared with next to nothing.) The reference is a
central difference of the NumPy filter in float64.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import common, kalman, peers, problems
from benchmarks.common import Job, Row, Size
from benchmarks.problems import Problem
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.sensor import Position
from jaxtrack.types import Array, Gaussian

TOLERANCE = {"float32": 1e-4, "float64": 1e-8}
BEGIN = 1.2  # times the true noises
STEP = 1e-3  # of the central difference, relative


def value(noises: Array, interval: Array, prior: Gaussian, detections: Array) -> Array:
    """Returns the log-density of all runs.

    Args:
        noises: Noise densities of the two axes, and the two standard deviations, [4].
        interval: Seconds.
        prior: mean [R, 4], cov [R, 4, 4].
        detections: [R, T, 2].
    """
    models = ConstantVelocity(noises[:2]), Position(noises[2:])
    each = common.many(kalman.model_log_likelihood, 3)
    return each(*models, interval, prior, detections).sum()


def dynamax_value(noises: Array, problem: Problem) -> Array:
    """Returns the same by dynamax."""
    unit = problems.velocity_noise(1.0).astype(noises.dtype)
    motion = jnp.repeat(noises[:2], 2)[:, None] * unit
    changed = problem._replace(noise=motion, sensor_noise=jnp.diag(noises[2:] ** 2))
    function, arguments = peers.dynamax_kalman(changed, lambda x: x.marginal_loglik)
    return function(*arguments).sum()


def numpy_value(noises: np.ndarray, problem: Problem) -> float:
    """Returns the same by NumPy."""
    motion = np.repeat(noises[:2], 2)[:, None] * problems.velocity_noise(1.0)
    changed = problem._replace(noise=motion, sensor_noise=np.diag(noises[2:] ** 2))
    return float(problems.kalman(changed).log_density.sum())


def difference(noises: np.ndarray, problem: Problem) -> np.ndarray:
    """Returns the central differences, of fourth order, [4]."""
    slopes = []
    for unit in np.eye(4) * STEP * noises:
        ahead = [numpy_value(noises + k * unit, problem) for k in (-2, -1, 1, 2)]
        weighted = np.dot([1 / 12, -2 / 3, 2 / 3, -1 / 12], ahead)
        slopes.append(weighted / unit.sum())
    return np.array(slopes)


def job(name: str, function: Any, arguments: tuple, items: int, answer: Any) -> Job:
    """Returns a call, checked against (value or gradient, tolerance)."""
    call, seconds = common.compiled(function, *arguments)
    return Job(name, call, items, seconds, common.check(name, call(), *answer))


def rows_of(size: Size, kind: str) -> list[Row]:
    """Times value and gradient in one precision."""
    exact = problems.linear(size.runs, size.scans)
    noises = BEGIN * np.repeat([problems.DENSITY, problems.SENSOR_STD], 2)
    total = numpy_value(noises, exact), TOLERANCE[kind]
    slopes = difference(noises, exact), TOLERANCE[kind]
    problem, items = exact.to(kind), size.runs * size.scans
    noises, interval = noises.astype(kind), np.ones((), kind) * problems.INTERVAL
    prior = Gaussian(problem.mean, problem.cov)
    arguments = noises, interval, prior, problem.detections

    own = job("jaxtrack", jax.grad(value), arguments, items, slopes)
    alone = job("its value", value, arguments, items, total)
    them = [alone]
    if peers.installed("dynamax"):
        arguments = noises, problem
        gradient = jax.grad(dynamax_value)
        them.append(job("dynamax", gradient, arguments, items, (slopes[0], 0.1)))
    work = "gradient of the Kalman log-likelihood"
    made = common.compare(work, kind, own, them, rounds=size.rounds)
    times = 1 / (made[0].ratio_to_peer or np.nan)
    multiple = made[0]._replace(
        rate=times, unit="x the time of the value", peer=None, ratio_to_peer=None
    )
    return [multiple, *made[1:]]


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    made = []
    for kind in ("float32", "float64"):
        with common.precision(kind):
            made += rows_of(size, kind)
    return made


if __name__ == "__main__":
    common.main(rows)
