"""Tests of `assign.multiscan` against enumeration of all selections.

Sums of scores of order ten may be zero, so bounds on them are absolute.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import multiscan as reference

from jaxtrack.assign.multiscan import decomposition, greedy, host, lagrangian, problem

INF = np.inf
SHAPES = (1, 1, 1, 1), (3, 4, 2, 3), (4, 5, 3, 4), (5, 6, 1, 4)
SOLVERS = {
    "greedy": greedy.greedy,
    "lagrangian": lagrangian.lagrangian,
    "lagrangian, one scan kept": functools.partial(lagrangian.lagrangian, keep=-1),
    "decomposition": decomposition.decomposition,
}


@functools.cache
def drawn(shape, rounded=False, count=100):
    """Random problems, and all their selections, best first."""
    rng = np.random.default_rng(sum(shape))
    pairs = [reference.draw(rng, *shape, rounded=rounded) for _ in range(count)]
    listed = [dict(reference.selections(*pair)) for pair in pairs]
    whole = problem.Problem(*(np.array(x) for x in zip(*pairs, strict=True)))
    return whole, listed


def one(whole, k):
    return jax.tree.map(lambda x: x[k], whole)


@functools.cache
def many(name, num_detections):
    solve = functools.partial(SOLVERS[name], num_detections=num_detections)
    return jax.jit(jax.vmap(solve))


@pytest.mark.parametrize("rounded", [False, True], ids=["distinct", "tied"])
@pytest.mark.parametrize("shape", SHAPES)
def test_host_finds_the_m_best_selections_in_order_and_each_once(shape, rounded):
    whole, listed = drawn(shape, rounded)
    for k, known in enumerate(listed[:30]):
        expected = sorted(known.values(), reverse=True)[:6]
        found = host.m_best(one(whole, k), shape[-1], m=6)
        assert len(found) == len(expected)
        leaves = [tuple(x.leaf.tolist()) for x in found]
        assert len(set(leaves)) == len(leaves)
        totals = [float(x.log_score) for x in found]
        np.testing.assert_allclose(totals, expected, atol=1e-9)
        np.testing.assert_allclose([known[x] for x in leaves], expected, atol=1e-9)
        best = host.exact(one(whole, k), shape[-1])
        assert best.feasible == bool(expected)
        np.testing.assert_allclose(best.log_score, max(expected, default=-INF))


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("shape", SHAPES)
def test_selections_are_possible_and_bounds_hold(shape, name):
    for rounded in False, True:
        whole, listed = drawn(shape, rounded)
        found = jax.tree.map(np.asarray, many(name, shape[-1])(whole))
        for k, known in enumerate(listed):
            best = max(known.values(), default=-INF)
            possible, total = reference.feasible(found.leaf[k], *one(whole, k))
            assert found.feasible[k] == possible
            assert found.log_score[k] == pytest.approx(total, abs=1e-12)
            assert found.log_score[k] <= best + 1e-12
            assert found.log_bound[k] >= best - 1e-12
            at_prices = problem.bound(one(whole, k), found.price[k])
            limit = max(float(at_prices), found.log_score[k])
            np.testing.assert_allclose(found.log_bound[k], limit)
            assert (found.price[k] >= 0).all()


@pytest.mark.parametrize("name", list(SOLVERS)[1:])
def test_prices_come_near_the_linear_relaxation(name):
    shape = SHAPES[2]
    whole, listed = drawn(shape)
    found = many(name, shape[-1])(whole)
    relaxed = [host.relax_exact(one(whole, k), shape[-1]) for k in range(len(listed))]
    value = np.array([x.log_score for x in relaxed])
    exact = np.array([max(x.values(), default=-INF) for x in listed])
    known = exact > -INF
    assert (value[known] >= exact[known] - 1e-9).all()
    excess = np.asarray(found.log_bound)[known] - value[known]
    assert (excess > -1e-9).all()
    assert excess.mean() < 0.1
    lost = exact[known] - np.asarray(found.log_score)[known]
    assert (lost < 1e-9).mean() > 0.85


def test_prices_of_the_host_attain_the_relaxed_value():
    whole, _ = drawn(SHAPES[2])
    for k in range(50):
        found = host.relax_exact(one(whole, k), 4)
        if found.feasible:
            limit = problem.bound(one(whole, k), jnp.asarray(found.price))
            np.testing.assert_allclose(limit, found.log_score, rtol=1e-9, atol=1e-9)
