"""Tests of `assign.marginals`, `exact` and `belief` against sums over all events.

Probabilities are between 0 and 1, and so are slopes, so bounds on them are absolute.
"""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import assign as reference

from jaxtrack.assign import belief, exact, marginals

INF = np.inf
SHAPES = [(1, 0), (2, 0), (1, 1), (2, 1), (4, 4), (3, 6), (6, 3), (5, 7)]


def draw(shape, count=40):
    """Matrices from empty to full; half of them also lack some misses."""
    rng = np.random.default_rng(sum(shape))
    drawn = [reference.scores(rng, *shape, gate) for gate in rng.random(count)]
    log_score = np.array(drawn).reshape(count, shape[0], shape[1] + 1)
    log_score[::2, :, -1][rng.random((len(log_score[::2]), shape[0])) < 0.5] = -INF
    return log_score


@functools.cache
def solver(**settings):
    return jax.jit(jax.vmap(lambda one: marginals.marginals(one, **settings)))


def solve(log_score, **settings):
    return jax.tree.map(np.asarray, solver(**settings)(log_score))


@pytest.mark.parametrize("shape", SHAPES)
def test_exact_equals_enumeration(shape):
    # So many of the small ones that they are sorted into blocks by their clusters.
    log_score = draw(shape, 150 if max(shape) < 5 else 40)
    found = solve(log_score)
    expected = [reference.marginals(one) for one in log_score]
    prob, log_norm = (np.array(x) for x in zip(*expected, strict=True))
    # Probabilities, so that an absolute error is one relative to 1.
    np.testing.assert_allclose(found.prob, prob, atol=1e-12, rtol=1e-9)
    fits = log_norm > -INF
    np.testing.assert_array_equal(found.feasible, fits)
    np.testing.assert_allclose(found.log_norm[fits], log_norm[fits], rtol=1e-12)
    assert (found.log_norm[~fits] == -INF).all()
    assert found.exact.all()
    assert found.converged.all()
    assert (found.num_iterations == 0).all()


def test_slopes_of_many_are_those_of_each():
    """Also of the sum over many, which a fit to many recordings takes."""
    log_score = draw((2, 2), 6)
    weight = np.random.default_rng(0).normal(size=(2, 3))

    def one(log_score):
        return (exact.exact(log_score).prob * weight).sum()

    def both(log_score):
        total = jax.grad(lambda x: jax.vmap(one)(x).sum())
        return total(log_score), jax.vmap(jax.grad(one))(log_score)

    found, expected = jax.jit(both)(log_score)
    assert np.abs(expected).max() > 0.1
    # Slopes that vanish are roundings of terms of order one.
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def blocks(rng, sizes, num_detections):
    """Tracks in clusters of these sizes, mixed up, each with detections of its own."""
    num = sum(sizes)
    log_score = np.full((num, num_detections * len(sizes) + 1), -INF)
    log_score[:, -1] = rng.normal(size=num)
    tracks = np.split(rng.permutation(num), np.cumsum(sizes)[:-1])
    columns = rng.permutation(log_score.shape[1] - 1).reshape(len(sizes), -1)
    for own, theirs in zip(tracks, columns, strict=True):
        log_score[np.ix_(own, theirs)] = 2 * rng.normal(size=(len(own), len(theirs)))
    return log_score, tracks


def test_clusters_are_summed_apart_and_what_is_too_large_is_told():
    log_score, tracks = blocks(np.random.default_rng(1), [2, 4, 1, 3], 3)
    alone = {len(own): reference.marginals(log_score[own]) for own in tracks}
    for size in 3, 4:
        found = solve(log_score[None], max_cluster=size, method="exact")
        for own in tracks:
            prob, _ = alone[len(own)]
            assert (found.exact[0, own] == (len(own) <= size)).all()
            # Probabilities, so that an absolute error is one relative to 1.
            right = prob if len(own) <= size else 0 * prob
            # Probabilities, between 0 and 1.
            np.testing.assert_allclose(found.prob[0, own], right, atol=1e-12)
        expected = sum(norm for key, (_, norm) in alone.items() if key <= size)
        np.testing.assert_allclose(found.log_norm[0], expected, rtol=1e-12)
        assert found.feasible[0] == (size == 4)


def test_auto_leaves_to_belief_what_is_too_large():
    log_score, tracks = blocks(np.random.default_rng(2), [2, 5, 1, 3, 4], 3)
    table = solve(log_score[None], max_cluster=4, method="exact")
    passed = solve(log_score[None], method="belief")
    both = solve(log_score[None], max_cluster=4)
    large = np.sort(tracks[1])
    np.testing.assert_array_equal(np.flatnonzero(~both.exact[0]), large)
    # Messages settle to 1e-12.
    np.testing.assert_allclose(both.prob[0, large], passed.prob[0, large], atol=1e-10)
    rest = both.exact[0]
    chex.assert_trees_all_equal(both.prob[0, rest], table.prob[0, rest])
    alone = solve(log_score[None, large], method="belief").log_norm
    np.testing.assert_allclose(both.log_norm, table.log_norm + alone, rtol=1e-10)
    assert both.feasible.all()
    assert both.converged.all()
    assert not passed.exact.any()


def test_belief_is_exact_on_trees():
    log_score = np.full((4, 5), -INF)
    log_score[:, -1] = [0.5, -1.0, 0.3, 2.0]
    chain = [(0, 0, 1.0), (1, 0, 2.0), (1, 1, 0.5), (2, 1, 3.0), (3, 3, 1.0)]
    for n, k, score in chain:
        log_score[n, k] = score
    found = solve(log_score[None], method="belief")
    prob, log_norm = reference.marginals(log_score)
    # Messages settle to 1e-12.
    np.testing.assert_allclose(found.prob[0], prob, atol=1e-10)
    np.testing.assert_allclose(found.log_norm[0], log_norm, rtol=1e-10)


def in_a_row(rng, gap, num=6, clutter=0.2, detect=0.9, capacity=18):
    """Scores of tracks in a row, in units of the standard deviation of a residual."""
    place = gap * np.arange(num)
    low, high = -5, place[-1] + 5
    seen = place[rng.random(num) < detect]
    false = rng.uniform(low, high, rng.poisson(clutter * (high - low)))
    z = np.concatenate([seen + rng.normal(size=seen.size), false])[:capacity]
    log_score = np.full((num, capacity + 1), -INF)
    surprise = (z[None] - place[:, None]) ** 2 / 2 + np.log(2 * np.pi) / 2
    log_score[:, : z.size] = np.log(detect / clutter) - surprise
    log_score[:, -1] = np.log(1 - detect)
    return log_score


@pytest.mark.parametrize(
    ("gap", "worst", "norm"),
    [(0.5, 0.03, 0.3), (2.0, 0.045, 0.11), (4.0, 0.002, 0.002)],
)
def test_belief_errs_as_its_table_says_and_never_overstates_the_norm(gap, worst, norm):
    rng = np.random.default_rng(0)
    log_score = np.array([in_a_row(rng, gap) for _ in range(200)])
    passed, table = solve(log_score, method="belief"), solve(log_score)
    assert passed.converged.all()
    np.testing.assert_allclose(passed.prob.sum(2), 1)
    assert np.abs(passed.prob - table.prob).max((1, 2)).mean() < worst
    short = table.log_norm - passed.log_norm
    assert short.mean() < norm
    assert (short > -1e-9).all()


def test_messages_survive_scores_that_outweigh_all_others():
    log_score = np.array([[60.0, 2.0, 0.0], [1.0, 1.0, -60.0], [-30.0, 3.0, -30.0]])
    expected, _ = reference.marginals(log_score[:2])
    found = solve(log_score[None, :2].astype(np.float32), method="belief")
    # One part in 1e5: float32, and a loop that hardly matters.
    np.testing.assert_allclose(found.prob[0], expected, atol=1e-4)
    assert np.isfinite(solve(log_score[None], method="belief").prob).all()


@pytest.mark.parametrize("method", marginals.METHODS)
def test_derivatives_of_all_orders_are_those_of_finite_differences(method):
    log_score = reference.scores(np.random.default_rng(3), 3, 4, 1.0)
    log_score[:2, 2:4] = log_score[2, :2] = -INF  # clusters of two and of one
    size = 2 if method == "exact" else 1

    def solved(score):
        found = marginals.marginals(score, method, max_cluster=size, max_iterations=99)
        told = found.log_norm, (found.prob**2).sum(1)
        return told, (told, found.prob)

    @jax.jit
    @jax.vmap
    def along(score, direction):
        """Values and slopes at a place, and how they change in a direction."""
        slopes = jax.jacrev(solved, has_aux=True)
        return jax.jvp(slopes, (score,), (direction,))

    # All entries at the place itself, ahead and back, in one program.
    every = np.eye(log_score.size).reshape(-1, *log_score.shape)
    places = log_score + 1e-5 * np.array([0, 1, -1])[:, None, None, None] * every[None]
    places = places.reshape(-1, *log_score.shape)
    found = jax.tree.map(np.asarray, along(places, np.tile(every, (3, 1, 1))))
    (slope, (value, prob)), (bend, (rise, _)) = found
    chex.assert_tree_all_finite((slope, bend))
    num, there = log_score.size, (log_score > -INF).ravel()
    for x, own in zip((*value, *slope), (*rise, *bend), strict=True):
        ahead, behind = x[num : 2 * num], x[2 * num :]
        # Differences of numbers of order one, over a step of 1e-5.
        np.testing.assert_allclose(
            own[:num][there], ((ahead - behind) / 2e-5)[there], atol=1e-6
        )
    # Either mode tells the same, but for messages that settle to 1e-12.
    for x, own in zip(slope, rise, strict=True):
        reverse = np.moveaxis(x[0].reshape(*own.shape[1:], num), -1, 0)
        np.testing.assert_allclose(own[:num], reverse, atol=1e-10)
        assert (reverse[~there] == 0).all()
    # Messages settle to 1e-12.
    np.testing.assert_allclose(slope[0][0], prob[0], atol=1e-10)


def test_what_is_infeasible_gives_zeros_and_finite_gradients():
    log_score = np.array([[1.0, -INF, -INF], [2.0, -INF, -INF], [0.0, 1.0, 0.0]])

    def loss(score, method, size):
        found = marginals.marginals(score, method, max_cluster=size)
        total = (found.prob**2).sum()
        return total + jnp.where(found.feasible, found.log_norm, 0.0), found

    @jax.jit
    def every(score):
        slope = jax.grad(loss, has_aux=True)
        choices = ("auto", 2), ("exact", 3), ("belief", 2)
        return [slope(score, *choice) for choice in choices]

    for slope, found in every(log_score):
        chex.assert_tree_all_finite(slope)
        assert not found.feasible
        assert (found.prob == 0).all()
        assert found.log_norm == -INF


def test_float32_is_near_float64():
    log_score = draw((5, 7))
    double = solve(log_score)
    single = solve(log_score.astype(np.float32))
    assert single.prob.dtype == np.float32
    # Sums of scores up to 30, so seven digits of a float32 leave five.
    np.testing.assert_allclose(single.prob, double.prob, atol=1e-4)


def test_large_scores_neither_overflow_nor_vanish():
    log_score = draw((5, 7))
    shift = np.random.default_rng(0).normal(size=(5, 1)) * 400
    found, moved = solve(log_score), solve(log_score + shift)
    # The shift is the same for all joint events; scores near 400 lose three digits.
    np.testing.assert_allclose(moved.prob, found.prob, atol=1e-10)


def test_settings_are_checked():
    log_score = jnp.zeros((2, 3))
    with pytest.raises(ValueError, match="method is 'best'; give one of auto"):
        marginals.marginals(log_score, "best")
    with pytest.raises(ValueError, match="max_cluster is 21; give 1 to 20"):
        exact.exact(log_score, 21)
    with pytest.raises(ValueError, match="max_iterations is 0; give at least 1"):
        belief.belief(log_score, 0)
