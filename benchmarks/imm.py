"""How fast is the filter of interacting multiple models?

Five modes of constant velocity that differ in their noise, seen in position: through
`jaxtrack.imm`, with dense arrays for the motions, and as a target of the trackers
(`targets.imm`), through models. The loop in C is dense.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import climit, common, peers, problems
from benchmarks.common import Job, Row, Size
from benchmarks.problems import Answer, Problem
from jaxtrack import imm
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.targets import imm as target_of_modes
from jaxtrack.types import Affine, Array, Gaussian, Mixture

KIND = "float32"
TOLERANCE = 5e-4
MODES = len(problems.DENSITIES)


def log_likelihood(
    motions: Sequence[Affine],
    sensors: Sequence[Affine],
    log_transition: Array,
    prior: Gaussian,
    detections: Array,
) -> Array:
    """Returns the log-density of the detections [T, 2] of one run, by `jaxtrack.imm`.

    Args:
        motions: One for each mode.
        sensors: The same.
        log_transition: [M, M].
        prior: Of every mode.
        detections: [T, 2].
    """

    def step(bank: Mixture, detection: Array) -> tuple[Mixture, Array]:
        bank = imm.predict(imm.mix(bank, log_transition), motions)
        return imm.update(bank, sensors, detection)

    mean, cov = (jnp.stack([x] * MODES) for x in prior)
    bank = Mixture(jnp.full(MODES, -jnp.log(float(MODES))), mean, cov)
    return jax.lax.scan(step, bank, detections)[1].sum()


def target_log_likelihood(
    params: target_of_modes.Params, interval: Array, prior: Gaussian, detections: Array
) -> Array:
    """Returns the same with the verbs of a target, as a tracker uses them."""
    target = target_of_modes.imm()

    def step(bank: Mixture, detection: Array) -> tuple[Mixture, Array]:
        bank, _ = target.predict(params, bank, interval)
        view = target.look(params, bank)
        log_density = target.score(params, view, detection[None])[0]
        return target.correct(params, view, detection), log_density

    mode_prob = jnp.full(MODES, 1 / MODES)
    bank = target.begin(params, prior, mode_prob, jax.random.key(0))
    return jax.lax.scan(step, bank, detections)[1].sum()


def dense(
    problem: Problem,
) -> tuple[tuple[Affine, ...], tuple[Affine, ...], Array]:
    """Returns motions, sensors and the log of the switching as arrays."""
    pairs = zip(problem.transition, problem.noise, strict=True)
    motions = tuple(Affine(matrix, jnp.zeros(4), noise) for matrix, noise in pairs)
    sensor = Affine(problem.matrix, jnp.zeros(2), problem.sensor_noise)
    return motions, (sensor,) * MODES, jnp.log(problems.switching())


def models() -> tuple[target_of_modes.Params, Array]:
    """Returns the same as models, and the interval; always alive, always seen."""
    ones, one = jnp.ones(2), jnp.ones(())
    params = target_of_modes.Params(
        motions=tuple(ConstantVelocity(q * ones) for q in problems.DENSITIES),
        switching=MarkovSwitching(jnp.array(problems.switching())),
        sensor=Position(problems.SENSOR_STD * ones),
        survive=Constant(one),
        detect=Constant(one),
    )
    return params, problems.INTERVAL * one


def loop(problem: Problem, answer: Answer) -> Job | None:
    """Returns the loop in C, checked; None without a compiler."""
    runs, scans, _ = problem.detections.shape
    last = common.runs_last(problem.mean, problem.cov, problem.detections)
    change = problems.switching().astype(KIND)
    mean, cov, prob, total = (np.empty((n, runs), KIND) for n in (4, 16, MODES, 1))
    outputs = mean, cov, prob, total
    call = climit.call("imm", KIND, runs, scans, *problem[:4], change, *last, *outputs)
    if call is None:
        return None
    call()
    common.check("the loop in C", total[0], answer.log_density, TOLERANCE)
    common.check("its mean", mean.T, answer.mean[:, -1], TOLERANCE)
    return Job("C", call, runs * scans)


def filterpy(exact: Problem, answer: Answer) -> list[Job]:
    """Returns FilterPy's filter on a few runs, checked."""
    if not peers.installed("filterpy"):
        return []
    call = functools.partial(peers.filterpy_imm, exact)
    result = call()
    common.check("FilterPy", result, answer.mean[: len(result), -1], TOLERANCE)
    return [Job("FilterPy", call, len(result) * exact.detections.shape[1])]


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    exact = problems.linear(size.runs, size.scans, modes=True)
    answer, problem = problems.imm(exact), exact.to(KIND)

    def check(name: str, result: Any) -> float:
        return common.check(name, result, answer.log_density, TOLERANCE)

    with common.precision(KIND):
        limit, them = loop(problem, answer), filterpy(exact, answer)
        own = common.library(log_likelihood, dense(problem), problem, check)
        work = "IMM, five modes, dense"
        made = common.compare(work, KIND, own, them, limit, size.rounds)

        own = common.library(target_log_likelihood, models(), problem, check)
        work = "IMM, five modes, as a target"
        return made + common.compare(work, KIND, own, them, limit, size.rounds)


if __name__ == "__main__":
    common.main(rows)
