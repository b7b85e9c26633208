"""Tests of `assign.multiscan.branching` against enumeration of all selections.

Sums of scores of order ten may be zero, so bounds on them are absolute.
"""

import functools

import jax
import numpy as np
import pytest
from reference import multiscan as reference

from jaxtrack.assign.multiscan import branching, decomposition, greedy, problem

NUM, TREES, LEAVES, SCANS, K = 80, 5, 5, 3, 4
EXACT = 1e-10  # of sums of order ten
TOLERANCE = 1e-6  # the default of the solvers


@functools.cache
def drawn():
    """Random problems, half of them with ties, and the best of all selections."""
    rng = np.random.default_rng(5)
    pairs = [
        reference.draw(rng, TREES, LEAVES, SCANS, K, rounded=k % 2 == 0)
        for k in range(NUM)
    ]
    every = (dict(reference.selections(*x)).values() for x in pairs)
    best = [max(x, default=-np.inf) for x in every]
    given = problem.Problem(*(np.array(x) for x in zip(*pairs, strict=True)))
    return given, np.array(best)


def without_prices(given, max_nodes):
    known = greedy.greedy(given, K)
    return known, branching.branch(given, K, known, max_nodes)


def with_prices(given, max_nodes):
    known = decomposition.decomposition(given, K, max_rounds=2, max_nodes=0)
    return known, branching.branch(given, K, known, max_nodes)


@functools.cache
def found(how, max_nodes):
    solve = jax.jit(jax.vmap(functools.partial(how, max_nodes=max_nodes)))
    return jax.tree.map(np.asarray, solve(drawn()[0]))


@pytest.mark.parametrize("how", [without_prices, with_prices])
def test_a_search_that_ends_finds_the_best(how):
    given, best = drawn()
    known, after = found(how, 1000)
    np.testing.assert_array_equal(after.feasible, known.feasible)
    begun = known.feasible
    assert begun.mean() > 0.8
    assert (known.log_score < best - EXACT)[begun].mean() > 0.1
    np.testing.assert_allclose(after.log_score[begun], best[begun], rtol=0, atol=EXACT)
    # What is below TOLERANCE is not looked at, in at most as many clusters as trees.
    room = (TREES + 1) * TOLERANCE
    np.testing.assert_allclose(after.log_bound[begun], best[begun], rtol=0, atol=room)
    assert (after.log_bound >= best - EXACT).all()
    for k in np.nonzero(begun)[0]:
        one = jax.tree.map(lambda x, k=k: x[k], given)
        possible, total = reference.feasible(after.leaf[k], *one)
        assert possible
        np.testing.assert_allclose(total, after.log_score[k], rtol=0, atol=EXACT)
    # Without a selection to begin with nothing changes.
    for field in ("leaf", "log_score", "log_bound", "price"):
        pair = getattr(known, field), getattr(after, field)
        np.testing.assert_array_equal(*(x[~begun] for x in pair))


@pytest.mark.parametrize("how", [without_prices, with_prices])
def test_one_that_runs_out_of_nodes_says_what_it_may_have_lost(how):
    _, best = drawn()
    known, after = found(how, 8)
    assert (after.log_bound >= best - EXACT).all()
    assert (after.log_bound <= known.log_bound + EXACT).all()
    assert (after.log_score >= known.log_score - EXACT).all()
    open_gap = after.log_bound > after.log_score + 1e-5
    assert open_gap[known.feasible].any()


def test_dual_decomposition_finds_the_best():
    given, best = drawn()
    solve = functools.partial(decomposition.decomposition, num_detections=K)
    after = jax.jit(jax.vmap(solve))(given)
    there = np.asarray(after.feasible)
    assert there.mean() > 0.9
    # It is content with a gap of TOLERANCE, or with that in each cluster.
    room = TREES * TOLERANCE
    np.testing.assert_allclose(after.log_score[there], best[there], rtol=0, atol=room)


def apart(rng):
    """Two groups of trees that share nothing, some leaves spoilt, of any size."""
    halves = [reference.draw(rng, 3, 4, SCANS, K) for _ in range(2)]
    score = np.concatenate([half[0] for half in halves])
    detection = np.concatenate(
        [np.where(half[1] >= 0, half[1] + K * k, -1) for k, half in enumerate(halves)]
    )
    spoilt = rng.random(score.shape) < 0.1
    score = np.where(spoilt, rng.choice([np.nan, np.inf, -np.inf], score.shape), score)
    return problem.Problem(score * rng.choice([1.0, 1e4]), detection)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_clusters_are_searched_each_for_itself(kind):
    rng = np.random.default_rng(9)
    every = [apart(rng) for _ in range(NUM)]
    given = problem.Problem(
        np.array([x.log_score for x in every], kind),
        np.array([x.detection for x in every]),
    )

    def solve(given):
        known = greedy.greedy(given, 2 * K)
        return known, branching.branch(given, 2 * K, known, 3000)

    known, after = jax.tree.map(np.asarray, jax.jit(jax.vmap(solve))(given))
    gaps = 0
    for k in np.nonzero(known.feasible)[0]:
        own = [np.where(np.isfinite(x), x, -np.inf) for x in (given.log_score[k],)]
        listed = dict(reference.selections(*own, given.detection[k]))
        best = max(listed.values())
        # Sums of six scores, and the tolerance.
        room = 50 * np.finfo(kind).eps * abs(own[0][np.isfinite(own[0])]).sum() + 3e-6
        assert abs(after.log_score[k] - best) <= room
        assert -room <= after.log_bound[k] - best <= room
        gaps += known.log_score[k] < best - room
    assert gaps > 10


def test_what_is_left_below_the_tolerance_counts_for_the_bound():
    """Three pairs that want one detection each; a swap would be worth 0.4 of one."""
    score = np.tile([[1.0, 0.0], [0.9, 0.5]], (3, 1))
    detection = np.array([[[k // 2], [-1]] for k in range(6)])
    given = problem.Problem(score, detection)
    leaf, price = np.tile([1, 0], 3), np.full((1, 3), 0.45)
    known = jax.jit(problem.answer)(given, leaf, price)
    search = functools.partial(branching.branch, num_detections=3, tolerance=0.7)
    after = jax.jit(lambda known: search(given, known=known))(known)
    assert known.log_score == pytest.approx(2.7)
    assert after.log_bound >= 3 * (1.0 + 0.5) - EXACT


def test_settings_that_make_no_sense_are_refused():
    given = jax.tree.map(lambda x: x[0], drawn()[0])
    known = greedy.greedy(given, K)
    with pytest.raises(ValueError, match="max_nodes is 0; give at least 1"):
        branching.branch(given, K, known, max_nodes=0)
    for solve in (
        functools.partial(branching.branch, given, K, known),
        functools.partial(decomposition.decomposition, given, K),
    ):
        with pytest.raises(ValueError, match="tolerance is -1; give 0 or more"):
            solve(tolerance=-1)
    with pytest.raises(ValueError, match="max_nodes is -1; give 0 or more"):
        decomposition.decomposition(given, K, max_nodes=-1)
