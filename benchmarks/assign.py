"""How fast are tracks and detections associated?

A thousand problems at once, side by side with a loop over SciPy's solver, optax's
under `vmap`, and NumPy: the best assignment, belief propagation until all messages of
the batch settle, the exact probabilities of scenes with and without gates, and the OSPA
distance of two sets of ten points.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import optax
from scipy.optimize import linear_sum_assignment

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack.assign import belief, best, exact
from jaxtrack.metrics import ospa
from jaxtrack.types import Array

KIND = "float32"
TOLERANCE = 1e-3
PROBLEMS = 1000
SIZES = 5, 10, 20  # of square problems
TRACKS, DETECTIONS, POINTS = 10, 20, 10
SETTLED = belief.TOLERANCE[KIND]
CUTOFF, ORDER = 100.0, 2.0


def many(name: str, function: Callable, *arguments: np.ndarray, of: Any = None) -> Job:
    """Returns a function of one problem, called for all of them, and its error."""
    call, seconds = common.compiled(common.many(function, 0), *arguments)
    error = None if of is None else common.check(name, call(), of, TOLERANCE)
    return Job(name, call, len(arguments[0]), seconds, error)


def scipy_cost(cost: np.ndarray) -> np.ndarray:
    """Solves one problem after the other."""
    return np.array([one[linear_sum_assignment(one)].sum() for one in cost])


def optax_cost(cost: Array) -> Array:
    """Solves one problem."""
    return cost[optax.assignment.hungarian_algorithm(cost)].sum()


def best_rows(size: int, problems: int, rounds: int) -> list[Row]:
    """Times square problems of uniform costs."""
    cost = np.random.default_rng(0).random((problems, size, size)).astype(KIND)
    least = scipy_cost(cost)
    own = many("jaxtrack", lambda one: best.least(one).cost, cost, of=least)
    them = [
        Job("SciPy in a loop", lambda: [*map(linear_sum_assignment, cost)], problems),
        many("optax under vmap", optax_cost, cost, of=least),
    ]
    work = f"best assignment, {size} x {size}"
    return common.compare(work, KIND, own, them, None, rounds, "problems/s")


def scores(problems: int, gate: float) -> np.ndarray:
    """Draws log-scores of scenes, each detection in a gate with a probability."""
    rng = np.random.default_rng(0)
    drawn = 2 * rng.normal(size=(problems, TRACKS, DETECTIONS + 1))
    drawn[..., :-1][rng.random((problems, TRACKS, DETECTIONS)) > gate] = -np.inf
    return drawn.astype(KIND)


def numpy_belief(log_score: np.ndarray) -> np.ndarray:
    """Passes messages until all of the batch settle; returns probabilities."""
    weight = np.exp(log_score[..., :-1] - log_score[..., -1:])
    heard, settled = np.ones_like(weight), False
    while not settled:
        share = weight * heard
        told = weight / (1 + share.sum(2, keepdims=True) - share)
        new = 1 / (1 + told.sum(1, keepdims=True) - told)
        settled = (np.abs(new - heard) <= SETTLED * new).all()
        heard = new
    share = np.concatenate([weight * heard, np.ones_like(weight[..., :1])], 2)
    return share / share.sum(2, keepdims=True)


def belief_rows(problems: int, rounds: int) -> list[Row]:
    """Times belief propagation in scenes without gates."""
    log_score = scores(problems, 1.0)
    prob = numpy_belief(log_score)
    own = many("jaxtrack", lambda one: belief.belief(one).prob, log_score, of=prob)
    them = [Job("NumPy", lambda: numpy_belief(log_score), problems)]
    work = f"belief propagation, {TRACKS} tracks, {DETECTIONS} detections"
    return common.compare(work, KIND, own, them, None, rounds, "scenes/s")


def exact_rows(gate: float, problems: int, rounds: int) -> list[Row]:
    """Times the exact probabilities."""
    log_score = scores(problems, gate)
    own = many("jaxtrack", lambda one: exact.exact(one).prob, log_score)
    within = "no gates" if gate == 1 else f"{gate:.0%} in the gates"
    work = f"exact marginals, {TRACKS} tracks, {DETECTIONS} detections, {within}"
    return common.compare(work, KIND, own, [], None, rounds, "scenes/s")


def numpy_ospa(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Measures one pair of full sets after the other."""
    distances = []
    for one, other in zip(left, right, strict=True):
        gap = np.linalg.norm(one[:, None] - other[None], axis=2)
        cost = np.minimum(gap, CUTOFF) ** ORDER
        total = cost[linear_sum_assignment(cost)].mean()
        distances.append(total ** (1 / ORDER))
    return np.array(distances)


def ospa_rows(problems: int, rounds: int) -> list[Row]:
    """Times the OSPA distance of points and the same points with noise."""
    rng = np.random.default_rng(0)
    left = (1000 * rng.random((problems, POINTS, 2))).astype(KIND)
    right = (left + 50 * rng.normal(size=left.shape)).astype(KIND)
    right = right[:, rng.permutation(POINTS)]
    distance = numpy_ospa(left, right)

    def one(left: Array, right: Array) -> Array:
        there = jax.numpy.ones(POINTS, bool)
        return ospa.ospa(left, there, right, there, CUTOFF, ORDER).distance

    own = many("jaxtrack", one, left, right, of=distance)
    peer = functools.partial(numpy_ospa, left, right)
    them = [Job("NumPy with SciPy", peer, problems)]
    work = f"OSPA, {POINTS} against {POINTS} points"
    return common.compare(work, KIND, own, them, None, rounds, "distances/s")


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    if size == common.QUICK:
        with common.precision(KIND):
            return best_rows(3, 2, 1) + belief_rows(2, 1) + ospa_rows(2, 1)
    made = []
    with common.precision(KIND):
        for each in SIZES:
            made += best_rows(each, PROBLEMS, size.rounds)
        made += belief_rows(PROBLEMS, size.rounds)
        for gate in 0.1, 0.2, 1.0:
            made += exact_rows(gate, PROBLEMS, size.rounds)
        return made + ospa_rows(PROBLEMS, size.rounds)


if __name__ == "__main__":
    common.main(rows)
