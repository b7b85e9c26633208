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
SHAPES = (1, 1, 2, 1), (3, 4, 2, 3), (4, 5, 3, 4), (5, 6, 1, 4)
COMMON = 6, 7, 3, 5  # to which all are padded, so that solvers are compiled once
K = COMMON[-1]
SOLVERS = {
    "greedy": greedy.greedy,
    "lagrangian": lagrangian.lagrangian,
    "lagrangian, one scan kept": functools.partial(lagrangian.lagrangian, keep=-1),
    "decomposition": functools.partial(decomposition.decomposition, max_nodes=0),
}


bounds = jax.jit(jax.vmap(problem.bound))


@functools.cache
def drawn(shape, rounded=False, count=60):
    """Random problems, padded, and all their selections."""
    rng = np.random.default_rng(sum(shape))
    pairs = [reference.draw(rng, *shape, rounded=rounded) for _ in range(count)]
    more = [(0, common - own) for common, own in zip(COMMON[:3], shape, strict=False)]
    pairs = [
        (
            np.pad(log_score, more[:2], constant_values=-INF),
            # No leaf is there, so it does not matter what it uses; no scan, no use.
            np.pad(
                np.pad(detection, (*more[:2], (0, 0)), constant_values=1),
                ((0, 0), (0, 0), more[2]),
                constant_values=-1,
            ),
        )
        for log_score, detection in pairs
    ]
    listed = [dict(reference.selections(*pair)) for pair in pairs]
    whole = problem.Problem(*(np.array(x) for x in zip(*pairs, strict=True)))
    return whole, listed


def one(whole, k):
    return jax.tree.map(lambda x: x[k], whole)


@functools.cache
def many(name):
    solve = functools.partial(SOLVERS[name], num_detections=K)
    return jax.jit(jax.vmap(solve))


@pytest.mark.parametrize("rounded", [False, True], ids=["distinct", "tied"])
@pytest.mark.parametrize("shape", SHAPES)
def test_host_finds_the_m_best_selections_in_order_and_each_once(shape, rounded):
    whole, listed = drawn(shape, rounded)
    for k, known in enumerate(listed[:12]):
        expected = sorted(known.values(), reverse=True)[:4]
        found = host.m_best(one(whole, k), K, m=4)
        assert len(found) == len(expected)
        leaves = [tuple(x.leaf.tolist()) for x in found]
        assert len(set(leaves)) == len(leaves)
        totals = [float(x.log_score) for x in found]
        np.testing.assert_allclose(totals, expected, atol=1e-9)
        np.testing.assert_allclose([known[x] for x in leaves], expected, atol=1e-9)
        best = host.exact(one(whole, k), K)
        assert best.feasible == bool(expected)
        np.testing.assert_allclose(best.log_score, max(expected, default=-INF))


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("shape", SHAPES)
def test_selections_are_possible_and_bounds_hold(shape, name):
    for rounded in False, True:
        whole, listed = drawn(shape, rounded)
        found = jax.tree.map(np.asarray, many(name)(whole))
        at_prices = np.asarray(bounds(whole, found.price))
        for k, known in enumerate(listed):
            best = max(known.values(), default=-INF)
            possible, total = reference.feasible(found.leaf[k], *one(whole, k))
            assert found.feasible[k] == possible
            assert found.log_score[k] == pytest.approx(total, abs=1e-12)
            assert found.log_score[k] <= best + 1e-12
            assert found.log_bound[k] >= best - 1e-12
            limit = max(at_prices[k], found.log_score[k])
            np.testing.assert_allclose(found.log_bound[k], limit)
            assert (found.price[k] >= 0).all()


@pytest.mark.parametrize("name", list(SOLVERS)[1:])
def test_prices_come_near_the_linear_relaxation(name):
    shape = SHAPES[2]
    whole, listed = drawn(shape)
    found = many(name)(whole)
    relaxed = [host.relax_exact(one(whole, k), K) for k in range(len(listed))]
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
        found = host.relax_exact(one(whole, k), K)
        if found.feasible:
            limit = problem.bound(one(whole, k), jnp.asarray(found.price))
            np.testing.assert_allclose(limit, found.log_score, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", list(SOLVERS)[1:])
def test_order_does_not_matter(name):
    whole, listed = drawn(SHAPES[2])
    rng = np.random.default_rng(1)
    trees, leaves = rng.permutation(COMMON[0]), rng.permutation(COMMON[1])
    names, scans = np.append(rng.permutation(K), -1), rng.permutation(COMMON[2])
    log_score = whole.log_score[:, trees][:, :, leaves]
    detection = names[whole.detection][:, trees][:, :, leaves]
    if "kept" not in name:
        detection = detection[..., scans]
    found = many(name)(whole)
    other = many(name)(problem.Problem(log_score, detection))
    exact = np.array([max(x.values(), default=-INF) for x in listed])
    # Ties apart, rounds are the same but for rounding, which a search may amplify.
    near = np.asarray(other.log_bound - found.log_bound)
    assert (np.abs(near) < 1e-6).mean() > 0.8
    sure = (found.log_bound - found.log_score < 1e-6) & (exact > -INF)
    also = (other.log_bound - other.log_score < 1e-6) & (exact > -INF)
    assert np.mean(sure[exact > -INF]) > 0.5
    assert np.mean(sure == also) > 0.8
    both = np.asarray(sure & also)
    chosen = np.asarray(other.leaf)[both][:, np.argsort(trees)]
    back = np.where(chosen >= 0, leaves[chosen], -1)
    np.testing.assert_array_equal(back, np.asarray(found.leaf)[both])


@pytest.mark.parametrize("name", SOLVERS)
def test_empty_impossible_and_spoilt_leaves(name):
    score = np.array([[1.0, np.nan, INF], [-INF] * 3, [2.0, 5.0, 0.5]])
    detection = np.array([[[0], [-1], [-1]], [[0], [1], [-1]], [[0], [7], [-1]]])
    nothing = np.full((3, 3), -INF)
    fight = np.array([[1.0, -INF, -INF], [-INF] * 3, [2.0, -INF, -INF]])
    log_score = np.full((3, *COMMON[:2]), -INF)
    log_score[:, :3, :3] = [score, nothing, fight]
    detections = np.full((3, *COMMON[:3]), -1)
    detections[:, :3, :3, :1] = detection
    whole = problem.Problem(log_score, detections)
    found = jax.tree.map(np.asarray, many(name)(whole))
    np.testing.assert_array_equal(found.leaf[:2, :3], [[0, -1, 2], [-1] * 3])
    np.testing.assert_array_equal(found.leaf[:, 3:], -1)
    np.testing.assert_array_equal(found.feasible, [True, True, False])
    np.testing.assert_allclose(found.log_score, [1.5, 0.0, -INF])
    assert np.isfinite(found.price).all()
    for k in range(3):
        best = host.exact(one(whole, k), K)
        assert best.log_score == pytest.approx(found.log_score[k])
        assert bool(best.feasible) == found.feasible[k]
        if best.feasible:
            np.testing.assert_array_equal(best.leaf, found.leaf[k])


@pytest.mark.parametrize("name", ["greedy", "lagrangian"])
def test_gradient_is_that_of_the_chosen_scores(name):
    whole, listed = drawn(SHAPES[2])
    k = next(k for k, known in enumerate(listed) if len(known) > 5)
    given = jax.tree.map(jnp.asarray, one(whole, k))

    def total(log_score):
        alone = jax.tree.map(lambda x: x[None], given._replace(log_score=log_score))
        found = many(name)(alone)  # all end in the same function
        return found.log_score[0], found.leaf[0]

    slope, leaf = jax.grad(total, has_aux=True)(given.log_score)
    expected = jax.nn.one_hot(leaf, COMMON[1], dtype=slope.dtype)
    np.testing.assert_array_equal(slope, expected)


def test_float32_bounds_hold_up_to_rounding():
    whole, listed = drawn(SHAPES[2])
    cast = whole._replace(log_score=whole.log_score.astype(np.float32))
    exact = np.array([max(x.values(), default=-INF) for x in listed])
    found = jax.tree.map(np.asarray, many("lagrangian, one scan kept")(cast))
    assert found.log_score.dtype == np.float32
    assert (found.log_bound >= exact - 1e-4).all()
    assert (found.log_score <= exact + 1e-4).all()


def test_settings_are_checked():
    given = problem.Problem(jnp.zeros((1, 1)), jnp.full((1, 1, 2), -1))
    with pytest.raises(ValueError, match="max_rounds is 0; give at least 1"):
        lagrangian.lagrangian(given, 1, max_rounds=0)
    with pytest.raises(ValueError, match="max_rounds is 0; give at least 1"):
        decomposition.decomposition(given, 1, max_rounds=0)
    with pytest.raises(ValueError, match="keep is 2; there are 2 scans"):
        lagrangian.lagrangian(given, 1, keep=2)


@pytest.mark.parametrize(
    ("leaf", "total"), [([0, 1], 7.0), ([0, 0], -INF), ([1, -1], -INF), ([1, 1], 4.0)]
)
def test_answer_says_whether_leaves_are_feasible(leaf, total):
    log_score = jnp.array([[3.0, 0.0], [5.0, 4.0]])
    detection = jnp.array([[[0], [-1]], [[0], [-1]]])
    given = problem.Problem(log_score, detection)
    found = problem.answer(given, jnp.array(leaf), jnp.array([[1.0]]))
    assert float(found.log_score) == total
    assert bool(found.feasible) == (total > -INF)
    assert float(found.log_bound) == 7.0  # 2 and 4 after paying, and the price


@pytest.mark.parametrize("name", ["lagrangian", "decomposition"])
def test_what_was_found_is_a_good_beginning(name):
    """One round from there has the same bound, or nearly, and no less a score."""
    whole, _ = drawn(SHAPES[2])
    found = many(name)(whole)

    def begin(given, price, leaf):
        again = SOLVERS[name](given, K, max_rounds=1, price=price, leaf=leaf)
        return again, SOLVERS[name](given, K, max_rounds=1)

    again, anew = jax.jit(jax.vmap(begin))(whole, found.price, found.leaf)
    assert (again.log_score >= found.log_score - 1e-9).all()
    lost, new_lost = again.log_bound - found.log_bound, anew.log_bound - found.log_bound
    assert new_lost.mean() > 0.05
    assert lost.mean() < 0.1 * new_lost.mean()
