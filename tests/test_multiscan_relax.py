"""Tests of `assign.multiscan.relax` against HiGHS, and of its form with an entropy.

Values are sums of scores of order ten, shares are of order one: bounds are absolute.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import multiscan as reference

from jaxtrack.assign.multiscan import host, problem, relax

SHAPE = 4, 5, 3, 4  # trees, leaves, scans, detections
K = SHAPE[-1]


@functools.cache
def drawn(shape=SHAPE, count=60):
    """Random problems, and their linear relaxations by HiGHS."""
    rng = np.random.default_rng(sum(shape))
    pairs = [reference.draw(rng, *shape) for _ in range(count)]
    exact = [host.relax_exact(problem.Problem(*pair), shape[-1]) for pair in pairs]
    whole = problem.Problem(*(np.array(x) for x in zip(*pairs, strict=True)))
    return whole, jax.tree.map(lambda *x: np.array(x), *exact)


@functools.cache
def many(shape=SHAPE, **options):
    solve = functools.partial(relax.relax, num_detections=shape[-1], **options)
    return jax.jit(jax.vmap(solve))


def violation(share, log_score, detection, num_detections):
    """By how much shares add up to more or less than they should, by loops."""
    there = np.isfinite(log_score).any(1)
    worst = np.abs(share.sum(1) - there).max()
    assert (share >= 0).all()
    assert (share[~np.isfinite(log_score)] == 0).all()
    for s in range(detection.shape[2]):
        for k in range(num_detections):
            worst = max(worst, share[detection[..., s] == k].sum() - 1)
    return worst


@pytest.mark.parametrize(
    ("method", "kind", "near"),
    [
        ("interior", "float64", 1e-7),
        ("interior", "float32", 5e-3),
        ("primal-dual", "float64", 1e-7),
        ("primal-dual", "float32", 5e-3),
    ],
)
def test_value_shares_and_prices_are_those_of_the_linear_programme(method, kind, near):
    whole, exact = drawn()
    cast = whole._replace(log_score=whole.log_score.astype(kind))
    rounds = 20_000 if method == "primal-dual" else None
    found = many(method=method, max_iterations=rounds)(cast)
    found = jax.tree.map(np.asarray, found)
    fits = exact.feasible
    assert found.log_score.dtype == kind
    np.testing.assert_array_equal(found.converged, fits)
    np.testing.assert_allclose(found.log_score[fits], exact.log_score[fits], atol=near)
    assert (found.residual[fits] <= relax.TOLERANCE[kind]).all()
    assert (found.log_bound >= np.where(fits, exact.log_score, -np.inf) - near).all()
    np.testing.assert_allclose(found.log_bound[fits], exact.log_score[fits], atol=near)
    for k in np.flatnonzero(fits):
        one = whole.log_score[k], whole.detection[k]
        assert violation(found.share[k], *one, K) <= relax.TOLERANCE[kind]
    for x in found:
        assert np.isfinite(x).all()


def test_one_scan_is_integral():
    shape = 5, 6, 1, 4
    whole, exact = drawn(shape)
    found = many(shape)(whole)
    best = np.array(
        [
            max(dict(reference.selections(*x)).values(), default=-np.inf)
            for x in zip(*whole, strict=True)
        ]
    )
    np.testing.assert_allclose(exact.log_score, best, atol=1e-9)
    fits = exact.feasible
    share = np.asarray(found.share)[fits]
    np.testing.assert_allclose(share, np.round(share), atol=1e-5)
    np.testing.assert_allclose(found.log_score[fits], best[fits], atol=1e-6)


def test_where_every_tree_may_have_its_best_leaf_it_has():
    whole, _ = drawn()
    first = whole.detection[:, :, 0]
    apart = np.arange(4)[None, :, None]  # Proposition 3: best leaves share nothing
    detection = whole.detection.copy()
    detection[:, :, 0] = np.broadcast_to(apart, first.shape)
    log_score = np.where(np.isfinite(whole.log_score), whole.log_score, -9.0)
    log_score[:, :, 0] = log_score.max(2) + 1.0
    found = many()(problem.Problem(log_score, detection))
    np.testing.assert_allclose(found.share[:, :, 0], 1.0, atol=1e-6)
    np.testing.assert_allclose(found.log_score, log_score[:, :, 0].sum(1), atol=1e-5)
    np.testing.assert_allclose(found.log_bound, log_score[:, :, 0].sum(1), atol=1e-5)


def test_half_of_each_where_three_trees_want_two_of_three():
    detection = np.full((3, 2, 3), -1)  # any two first leaves share a detection
    detection[0, 0, :2] = 0
    detection[1, 0, 1:] = 0
    detection[2, 0, ::2] = 0
    log_score = np.tile([2.0, 0.0], (3, 1))
    found = relax.relax(problem.Problem(jnp.array(log_score), jnp.array(detection)), 1)
    np.testing.assert_allclose(found.share, 0.5, atol=1e-6)
    assert float(found.log_score) == pytest.approx(3.0, abs=1e-6)
    best = host.exact(problem.Problem(log_score, detection), 1)
    assert best.log_score == pytest.approx(2.0)


@pytest.mark.parametrize("temperature", [2.0, 0.1, 1e-3])
def test_shares_with_an_entropy_meet_the_conditions_of_the_optimum(temperature):
    whole, exact = drawn()
    heat = jnp.full(len(exact.feasible), temperature)
    solve = jax.jit(jax.vmap(lambda p, t: relax.relax(p, K, t)))
    found = jax.tree.map(np.asarray, solve(whole, heat))
    fits = exact.feasible
    np.testing.assert_array_equal(found.converged, fits)
    for k in np.flatnonzero(fits):
        log_score, detection = whole.log_score[k], whole.detection[k]
        share, price = found.share[k], found.price[k]
        assert violation(share, log_score, detection, K) <= 1e-8
        for n, row in enumerate(log_score):
            leaves = np.flatnonzero(np.isfinite(row))
            paid = [
                row[i]
                - sum(price[s, j] for s, j in enumerate(detection[n, i]) if j >= 0)
                for i in leaves
            ]
            if len(leaves):
                weight = np.exp((np.array(paid) - max(paid)) / temperature)
                # Prices at which a detection is nearly free are known to 1e-8.
                near = 1e-7 / temperature
                np.testing.assert_allclose(
                    share[n, leaves], weight / weight.sum(), atol=max(near, 1e-7)
                )
        for s, j in np.argwhere(price > 1e-4):
            assert share[detection[..., s] == j].sum() == pytest.approx(1, abs=1e-4)
    assert (found.log_bound[fits] >= exact.log_score[fits] - 1e-9).all()
    lost = exact.log_score[fits] - found.log_score[fits]
    assert (lost >= -1e-6).all()
    assert (lost <= temperature * found.entropy[fits] + 1e-6).all()


def test_shares_become_those_of_the_linear_programme():
    whole, exact = drawn()
    fits = exact.feasible
    gap = [
        np.abs(many(temperature=t)(whole).share - exact.share)[fits].max((1, 2))
        for t in (0.3, 0.003)
    ]
    # Where several shares are optimal, HiGHS may have found others.
    assert np.median(gap[0]) > 0.01
    assert np.median(gap[1]) < 1e-6


def numeric(function, at, direction, step=1e-5):
    return (
        (function(at + step * direction) - function(at - step * direction)) / 2 / step
    )


@pytest.mark.parametrize("temperature", [1.0, 0.2])
def test_derivatives_with_an_entropy_are_those_of_differences(temperature):
    whole, exact = drawn()
    rng = np.random.default_rng(0)
    one = problem.Problem(*(x[np.flatnonzero(exact.feasible)[0]] for x in whole))
    weight = rng.normal(size=one.log_score.shape)
    finite = np.isfinite(one.log_score)
    given = np.where(finite, one.log_score, 0.0)

    def shares(score, heat):
        score = jnp.where(finite, score, -jnp.inf)
        found = relax.relax(one._replace(log_score=score), K, heat, tolerance=1e-11)
        value = found.log_score + heat * found.entropy
        return (found.share * weight).sum(), value, found.share

    call = jax.jit(shares)
    direction = rng.normal(size=given.shape)
    ahead = jax.jit(lambda x, h, dx, dh: jax.jvp(shares, (x, h), (dx, dh)))
    backward = jax.jit(jax.grad(lambda x, h: shares(x, h)[0], argnums=(0, 1)))
    heat = jnp.asarray(temperature)
    slope = ahead(given, heat, direction, jnp.zeros(()))[1]
    by_score, by_heat = backward(given, heat)
    expected = numeric(lambda x: call(x, heat)[0], given, direction)
    assert float(slope[0]) == pytest.approx(float(expected), rel=1e-5)
    assert float((by_score * direction).sum()) == pytest.approx(float(slope[0]))
    expected = numeric(lambda h: call(given, h)[0], heat, 1.0)
    assert float(by_heat) == pytest.approx(float(expected), rel=1e-5)
    share = call(given, heat)[2]
    rise = float((share * direction).sum())
    assert float(slope[1]) == pytest.approx(rise, rel=1e-7)
    expected = numeric(lambda x: call(x, heat)[1], given, direction)
    assert rise == pytest.approx(float(expected), rel=1e-6)


def test_gradient_of_the_linear_programme_is_its_shares():
    whole, _ = drawn()
    one = problem.Problem(*(x[0] for x in whole))
    solve = jax.jit(
        jax.value_and_grad(
            lambda s: relax.relax(one._replace(log_score=s), K).log_score
        )
    )
    value, slope = solve(one.log_score)
    found = relax.relax(one, K)
    assert float(value) == pytest.approx(float(found.log_score))
    np.testing.assert_allclose(slope, found.share, atol=1e-12)


@pytest.mark.parametrize("temperature", [None, 0.5])
def test_order_and_padding_do_not_matter(temperature):
    whole, exact = drawn()
    rng = np.random.default_rng(1)
    count, num_trees, num_leaves, num_scans = whole.detection.shape
    trees, leaves = rng.permutation(num_trees), rng.permutation(num_leaves)
    names, scans = rng.permutation(K), rng.permutation(num_scans)
    renamed = np.concatenate([names, [-1]])[whole.detection]
    mixed = problem.Problem(
        whole.log_score[:, trees][:, :, leaves],
        renamed[:, trees][:, :, leaves][..., scans],
    )
    score = np.pad(mixed.log_score, ((0, 0), (0, 1), (0, 2)), constant_values=-np.inf)
    padding = (0, 0), (0, 1), (0, 2), (0, 0)
    padded = problem.Problem(score, np.pad(mixed.detection, padding, constant_values=1))
    found = many(temperature=temperature)(whole)
    other = many((*SHAPE[:3], K + 1), temperature=temperature)(padded)
    fits = exact.feasible
    np.testing.assert_array_equal(other.converged, fits)
    back = other.share[:, :-1, :-2][:, np.argsort(trees)][:, :, np.argsort(leaves)]
    np.testing.assert_allclose(back[fits], found.share[fits], atol=1e-4)
    np.testing.assert_allclose(other.log_score[fits], found.log_score[fits], atol=1e-6)


@pytest.mark.parametrize(
    "options", [{}, {"method": "primal-dual"}, {"temperature": 0.5}], ids=str
)
def test_what_has_no_solution_never_converges_and_stays_finite(options):
    log_score = np.array([[1.0, -np.inf], [2.0, -np.inf], [-np.inf, -np.inf]])
    detection = np.array([[[0], [1]], [[0], [-1]], [[1], [-1]]])
    given = problem.Problem(jnp.array(log_score), jnp.array(detection))
    found = relax.relax(given, 2, **options)
    assert not found.converged
    assert all(np.isfinite(x).all() for x in found)
    assert not host.relax_exact(given, 2).feasible
    alone = given._replace(log_score=given.log_score.at[0].set(-jnp.inf))
    found = relax.relax(alone, 2, **options)
    assert found.converged
    np.testing.assert_allclose(found.share, [[0, 0], [1, 0], [0, 0]], atol=1e-6)
    empty = given._replace(log_score=jnp.full((3, 2), -jnp.inf))
    found = relax.relax(empty, 2, **options)
    assert found.converged
    assert float(found.log_score) == 0
    assert 0 <= float(found.log_bound) < 1e-6


def test_settings_are_checked():
    one = problem.Problem(jnp.zeros((1, 1)), jnp.full((1, 1, 1), -1))
    with pytest.raises(ValueError, match="temperature is 0; it must be positive"):
        relax.relax(one, 1, temperature=0)
    with pytest.raises(ValueError, match='method is "simplex"'):
        relax.relax(one, 1, method="simplex")
    with pytest.raises(ValueError, match="max_iterations is 0"):
        relax.relax(one, 1, max_iterations=0)
