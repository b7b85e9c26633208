"""How fast is a particle filter?

A bootstrap filter of a thousand particles, many runs at once: constant velocity with
the position seen, where the Kalman filter says what should come out, and a turning
target seen by a radar. Beside it is cuthbert with the same models, the same resampling
where the effective size falls below half, and NumPy with one run after the other. An
item is one particle in one scan.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import common, peers, problems
from benchmarks.common import Job, Row, Size
from benchmarks.problems import Problem
from jaxtrack import linalg
from jaxtrack.models import motion, probability, sensor, switching, turn
from jaxtrack.targets import particles
from jaxtrack.types import Array, Gaussian

KIND = "float32"
PARTICLES, RUNS, SCANS = 1000, 32, 50
TOLERANCE = 0.05  # of the mean log-density: the noise of the particles, with a margin


def target_params(moves: Any, sees: Any) -> particles.Params:
    """Returns one mode, always there and always detected."""
    sure = probability.Constant(jnp.ones(()))
    stay = switching.MarkovSwitching(jnp.ones((1, 1)))
    return particles.Params((moves,), stay, sees, sure, sure)


def log_likelihood(
    size: int,
    params: particles.Params,
    interval: Array,
    prior: Gaussian,
    detections: Array,
    key: Array,
) -> Array:
    """Returns the log-density of the detections [T, 2] of one run."""
    target = particles.particles(max_particles=size)

    def step(belief: Any, detection: Array) -> tuple[Any, Array]:
        belief, _ = target.predict(params, belief, interval)
        view = target.look(params, belief)
        log_density = target.score(params, view, detection[None])[0]
        return target.correct(params, view, detection), log_density

    first = target.begin(params, prior, jnp.ones(1), jax.random.wrap_key_data(key))
    return jax.lax.scan(step, first, detections)[1].sum()


def position() -> particles.Params:
    """Returns constant velocity in the plane, the position seen."""
    moves = motion.ConstantVelocity(jnp.full(2, problems.DENSITY))
    return target_params(moves, sensor.Position(jnp.full(2, problems.SENSOR_STD)))


def radar() -> particles.Params:
    """Returns a turn at an unknown rate, seen in range and bearing."""
    moves = turn.TurnRate(
        jnp.asarray(problems.DENSITY), jnp.asarray(problems.TURN_DENSITY)
    )
    sees = sensor.RangeBearing(
        jnp.array(problems.RADAR_STD), jnp.zeros(2), jnp.zeros(())
    )
    return target_params(moves, sees)


def cuthbert_log_likelihood(
    size: int,
    params: particles.Params,
    interval: Array,
    prior: Gaussian,
    detections: Array,
    key: Array,
) -> Array:
    """Returns the same by cuthbert, with the models of the library."""
    from cuthbert.smc import particle_filter
    from cuthbertlib.resampling import adaptive, systematic

    (moves,), sees, layout = params.motions, params.sensor, params.layout
    root, start = linalg.root(moves.noise(interval)), linalg.root(prior.cov)

    def drawn(key: Array, factor: Any) -> Array:
        noise = jax.random.normal(key, prior.mean.shape)
        return linalg.product(factor, noise[:, None])[:, 0]

    def log_potential(before: Array, state: Array, detection: Array) -> Array:
        place, speed = (
            jnp.stack([state[i] for i in index])
            for index in (layout.position_index, layout.velocity_index)
        )
        surprise = sees.residual(detection, sees.measure(place, speed))
        return linalg.log_normal(surprise, linalg.cholesky(sees.cov()))

    made = particle_filter.build_filter(
        lambda key: prior.mean + drawn(key, start),
        lambda key, state, _: moves.move(state, interval) + drawn(key, root),
        log_potential,
        size,
        adaptive.ess_decorator(systematic.resampling, 0.5),
    )

    def step(state: Any, seen: tuple[Array, Array]) -> tuple[Any, None]:
        detection, key = seen
        prepared = made.filter_prepare(detection, key=key)
        return made.filter_combine(state, prepared), None

    # Without keeping the particles of all scans, as its own loop does.
    first, *keys = jax.random.split(jax.random.wrap_key_data(key), 1 + len(detections))
    begun = made.init_prepare(key=first)._replace(model_inputs=detections[0])
    last, _ = jax.lax.scan(step, begun, (detections, jnp.stack(keys)))
    return last.log_normalizing_constant


def numpy_log_likelihood(size: int, problem: Problem) -> np.ndarray:
    """Returns that of constant velocity, run by run."""
    rng, total = np.random.default_rng(0), np.zeros(len(problem.mean))
    root = np.linalg.cholesky(problem.noise).astype(KIND).T
    for run, (mean, cov, seen) in enumerate(
        zip(problem.mean, problem.cov, problem.detections, strict=True)
    ):
        lower = np.linalg.cholesky(cov).astype(KIND).T
        state = mean + rng.standard_normal((size, 4), KIND) @ lower
        weight = np.full(size, 1 / size, KIND)
        for z in seen:
            if weight.sum() ** 2 < 0.5 * size * (weight * weight).sum():
                points = (rng.random() + np.arange(size)) / size
                index = np.searchsorted(np.cumsum(weight), points)
                state = state[np.minimum(index, size - 1)]
                weight = np.full(size, 1 / size, KIND)
            state = state @ problem.transition.T
            state = state + rng.standard_normal((size, 4), KIND) @ root
            gap = (z - state[:, [0, 2]]) / problems.SENSOR_STD
            weight = weight * np.exp(-(gap * gap).sum(1) / 2)
            density = weight.sum()
            weight = weight / density
            total[run] += np.log(density / (2 * np.pi * problems.SENSOR_STD**2))
    return total


def check(name: str, result: Any, reference: Any) -> float:
    """Returns the error of the mean log-density over all runs."""
    return common.check(name, np.mean(result), np.mean(reference), TOLERANCE)


def compared(
    work: str,
    size: Size,
    params: particles.Params,
    problem: Problem,
    reference: np.ndarray | None,
    peers_too: list[Job],
) -> list[Row]:
    """Times the library and cuthbert on all runs at once."""
    count = 20 if size == common.QUICK else PARTICLES
    keys = jax.random.key_data(jax.random.split(jax.random.key(0), len(problem.mean)))
    prior = Gaussian(problem.mean, problem.cov)
    arguments = params, jnp.asarray(problems.INTERVAL), prior, problem.detections, keys
    items, quick = problem.detections[..., 0].size * count, size == common.QUICK

    def job(name: str, function: Callable) -> Job:
        one = functools.partial(function, count)
        call, seconds = common.compiled(common.many(one, 2), *arguments)
        right = call() if quick or reference is None else reference
        return Job(name, call, items, seconds, check(name, call(), right))

    own = job("jaxtrack", log_likelihood)
    them = list(peers_too)
    if peers.installed("cuthbert"):
        them.append(job("cuthbert", cuthbert_log_likelihood))
    return common.compare(work, KIND, own, them, None, size.rounds, "particles/s")


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    quick = size == common.QUICK
    runs, scans = (2, 3) if quick else (RUNS, SCANS)
    exact = problems.linear(runs, scans)
    problem = exact.to(KIND)
    count, few = (20, 1) if quick else (PARTICLES, 4)
    some = problems.first(problem, few)
    items = some.detections[..., 0].size * count
    numpy = Job("NumPy", lambda: numpy_log_likelihood(count, some), items)
    with common.precision(KIND):
        answer = problems.kalman(exact).log_density
        work = "bootstrap filter, position seen"
        made = compared(work, size, position(), problem, answer, [numpy])
        problem = problems.turning(runs, scans).to(KIND)
        work = "bootstrap filter, turning target and radar"
        return made + compared(work, size, radar(), problem, None, [])


if __name__ == "__main__":
    common.main(rows)
