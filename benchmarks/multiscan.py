"""How fast are tracks assigned to the detections of several scans, and how well?

Problems of two kinds, some at once, side by side with a loop over SciPy's HiGHS. In
scenes, targets in a crowd have a prior position and leave detections among clutter; a
tree's leaves are its best explanations of the scans. In random problems scores and
detections are drawn at random, which is much harder. The error of a selection is the
mean of what it lacks to the best, that of a relaxation the largest difference, both
relative to the exact value. `python -m benchmarks.multiscan` prints, too, how large
gaps are and how often the linear relaxation is integral.
"""

import functools
import itertools
import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack.assign.multiscan import (
    beam,
    decomposition,
    greedy,
    host,
    lagrangian,
    relax,
)
from jaxtrack.assign.multiscan.problem import Answer, Problem

KIND = "float32"
DETECT_PROB, CLUTTER_DENSITY, PRIOR_STD, SPACING = 0.9, 0.05, 2.0, 4.0
INTEGRAL = 1e-4  # shares nearer than this to 0 or 1 count as such
ROUNDS = 3


class Shape(NamedTuple):
    """Trees, leaves, scans, detections, and how many problems."""

    trees: int
    leaves: int
    scans: int
    detections: int
    problems: int


SHAPES = (
    Shape(5, 6, 3, 8, 64),
    Shape(20, 20, 3, 30, 32),
    Shape(50, 40, 4, 60, 8),
    Shape(100, 40, 4, 120, 4),
)
STATISTICS = 200  # problems at least for the share of integral ones, if they are small


def scene(rng: np.random.Generator, shape: Shape) -> Problem:
    """Draws targets, detections and clutter, and the best explanations of each target.

    The deviation of detections from their target is the unit of length.
    """
    side = SPACING * np.sqrt(shape.trees)
    prior = side * rng.random((shape.trees, 2))
    true = prior + PRIOR_STD * rng.normal(size=prior.shape)
    detections = side * rng.random((shape.scans, shape.detections, 2))
    for scan in detections:
        seen = np.flatnonzero(rng.random(shape.trees) < DETECT_PROB)
        seen = seen[: shape.detections]
        scan[: len(seen)] = true[seen] + rng.normal(size=(len(seen), 2))
    leaves = [explanations(mean, detections, shape.leaves) for mean in prior]
    return Problem(*(np.array(x) for x in zip(*leaves, strict=True)))


def explanations(
    mean: np.ndarray, detections: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Returns a target's best leaves, of detections near to it: scores and detections.

    The last one is that of no detection at all.
    """
    num_scans = len(detections)
    near = int(np.ceil((count + 1) ** (1 / num_scans)))
    order = np.argsort(((detections - mean) ** 2).sum(-1), axis=1)[:, :near]
    options = [[-1, *row] for row in order.tolist()]
    chosen = np.array(list(itertools.product(*options)))  # all -1 comes first
    scans = np.arange(num_scans)[None]
    there = chosen >= 0
    away = np.where(there[..., None], detections[scans, chosen] - mean, 0.0)
    number = there.sum(1)
    # Detections of one target share the error of its prior mean.
    common_part = PRIOR_STD**2 / (1 + number * PRIOR_STD**2)
    square = (away**2).sum((1, 2)) - common_part * (away.sum(1) ** 2).sum(1)
    log_det = 2 * np.log1p(number * PRIOR_STD**2)
    score = -0.5 * (square + log_det) - number * np.log(2 * np.pi)
    score += number * np.log(DETECT_PROB / CLUTTER_DENSITY)
    score += (num_scans - number) * np.log(1 - DETECT_PROB)
    best = 1 + np.argsort(-score[1:])[: count - 1]
    kept = np.concatenate([best, [0]])
    return score[kept], chosen[kept]


def random(rng: np.random.Generator, shape: Shape) -> Problem:
    """Draws scores and detections that have nothing to do with each other."""
    size = shape.trees, shape.leaves, shape.scans
    detection = rng.integers(0, shape.detections, size)
    detection[rng.random(size) < 0.2] = -1
    detection[:, -1] = -1
    score = (detection >= 0).sum(-1) + 2 * rng.normal(size=size[:2])
    score[:, -1] = 0
    return Problem(score, detection)


def drawn(kind: Callable, shape: Shape) -> list[Problem]:
    """Returns the problems of a kind."""
    rng = np.random.default_rng(0)
    made = [kind(rng, shape) for _ in range(shape.problems)]
    return [x._replace(log_score=x.log_score.astype(KIND)) for x in made]


def selections(num_detections: int) -> dict[str, Callable]:
    """Returns the solvers that select leaves."""
    found = {
        "greedy": greedy.greedy,
        "Lagrangian": lagrangian.lagrangian,
        "Lagrangian, a scan kept": functools.partial(lagrangian.lagrangian, keep=-1),
        "dual decomposition": functools.partial(
            decomposition.decomposition, max_nodes=0
        ),
    }
    made = {
        name: functools.partial(solve, num_detections=num_detections)
        for name, solve in found.items()
    }

    def best_of_beam(one: Problem) -> beam.Together:
        return beam.together(beam.beam(one, num_detections, width=32))

    return {**made, "beam of 32": best_of_beam}


def relaxations(num_detections: int) -> dict[str, Callable]:
    """Returns the solvers of the linear relaxation."""
    ways = {
        "interior point": {},
        "primal-dual": {"method": "primal-dual"},
        "entropy, temperature 0.1": {"temperature": 0.1},
    }
    return {
        name: functools.partial(relax.relax, num_detections=num_detections, **options)
        for name, options in ways.items()
    }


def job(name: str, solve: Callable, problems: list[Problem]) -> tuple[Job, Callable]:
    """Returns a solver's work on all problems, and how to see its results."""
    stacked = Problem(*(np.stack(x) for x in zip(*problems, strict=True)))
    call, seconds = common.compiled(common.many(solve, 0), stacked)
    return Job(name, call, len(problems), seconds), call


def exact_values(
    problems: list[Problem], num_detections: int
) -> tuple[Job, np.ndarray]:
    """Returns the work of HiGHS on all problems, and the best scores."""

    def call() -> list[Answer]:
        return [host.exact(one, num_detections, time_limit=5.0) for one in problems]

    return Job("HiGHS", call, len(problems)), np.array([x.log_score for x in call()])


def relaxed_values(
    problems: list[Problem], num_detections: int
) -> tuple[Job, list[host.Relaxation]]:
    """Returns the work of HiGHS on all linear relaxations, and what it found."""

    def call() -> list[host.Relaxation]:
        return [host.relax_exact(one, num_detections) for one in problems]

    return Job("HiGHS", call, len(problems)), call()


def note(text: str) -> None:
    """Prints a line of the table of gaps."""
    print(text, file=sys.stderr, flush=True)


def shape_rows(kind: Callable, shape: Shape, rounds: int, hard: bool) -> list[Row]:
    """Times all solvers on problems of one kind and size."""
    problems, size = drawn(kind, shape), "x".join(map(str, shape[:4]))
    about = f"{kind.__name__} {size}"
    peer, exact = exact_values(problems, shape.detections)
    lp_peer, relaxed = relaxed_values(problems, shape.detections)
    value = np.array([x.log_score for x in relaxed])
    made, scale = [], np.abs(exact)
    for name, solve in selections(shape.detections).items():
        own, call = job(name, solve, problems)
        score = np.asarray(call().log_score).reshape(len(problems), -1)[:, 0]
        lost = ((exact - score) / scale).mean()
        own = own._replace(error=float(lost))
        if hasattr(call(), "log_bound"):
            gap = (np.asarray(call().log_bound) - value) / np.abs(value)
            note(f"{about}, {name}: lost {lost:.2e}, bound above LP {gap.mean():.1e}")
        peers = [] if hard else [peer]
        work = f"{name}, {about}"
        made += common.compare(work, KIND, own, peers, None, rounds, "problems/s")
    for name, solve in relaxations(shape.detections).items():
        own, call = job(name, solve, problems)
        error = np.abs(np.asarray(call().log_score) - value) / np.abs(value)
        own = own._replace(error=float(error.max()))
        share = np.asarray(call().converged).mean()
        note(f"{about}, {name}: {share:.0%} converged")
        work = f"linear relaxation, {name}, {about}"
        made += common.compare(work, KIND, own, [lp_peer], None, rounds, "problems/s")
    return made


def integrality(kind: Callable, shape: Shape) -> str:
    """Says how often the linear relaxation is integral, and how large its gap is."""
    count = max(shape.problems, STATISTICS if shape.trees <= 5 else shape.problems)
    problems = drawn(kind, shape._replace(problems=count))
    _, exact = exact_values(problems, shape.detections)
    _, relaxed = relaxed_values(problems, shape.detections)
    value = np.array([x.log_score for x in relaxed])
    whole = [np.abs(x.share - np.round(x.share)).max() < INTEGRAL for x in relaxed]
    gap = ((value - exact) / np.abs(exact)).mean()
    size = "x".join(map(str, shape[:4]))
    return (
        f"{kind.__name__} {size}: integral in {np.mean(whole):.0%} of {count}, "
        f"mean relative gap {gap:.1e}"
    )


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    with common.precision(KIND):
        if size == common.QUICK:
            return shape_rows(scene, Shape(2, 3, 2, 3, 2), 1, False)
        made = []
        for kind, shapes in (scene, SHAPES), (random, SHAPES[:2]):
            for shape in shapes:
                note(integrality(kind, shape))
                rounds = min(size.rounds, ROUNDS)
                # Branch and bound takes too long there to be timed again and again.
                made += shape_rows(kind, shape, rounds, kind is random)
        return made


if __name__ == "__main__":
    common.main(rows)
