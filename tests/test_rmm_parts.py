"""Tests of what RMM-MHT is made of, against enumeration and HiGHS."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.randomized import DETECT, RATE, SIDE, SURVIVE, H, R, matrices, params
from reference import kalman as book
from reference import shared_models

from jaxtrack import linearize
from jaxtrack.assign.multiscan import host
from jaxtrack.assign.multiscan.problem import Problem
from jaxtrack.entries import dense
from jaxtrack.models import motion, probability
from jaxtrack.trackers import rmm_association, rmm_leaves, rmm_stack
from jaxtrack.types import Gaussian

TAYLOR = linearize.taylor


def random_stack(rng, num):
    mean = rng.normal(size=(num, 4)) * 3
    cov = book.random_cov(rng, 4 * num)
    state_mean = mean + rng.normal(size=(num, 4))
    state_cov = cov + book.random_cov(rng, 4 * num)
    shape = num, 4, num, 4
    return rmm_stack.Stack(
        mean, cov.reshape(shape), state_mean, state_cov.reshape(shape)
    )


@functools.partial(jax.jit, static_argnums=3)
def updated(stack, prob, detections, gate_prob=0.99):
    target = params().target
    return rmm_stack.update(TAYLOR, target, stack, prob, detections, gate_prob)


UNLIKE = (
    motion.ConstantVelocity(np.array([0.3, 0.5])),
    motion.OrnsteinUhlenbeck(np.array([4.0, 5.0]), np.array([2.0, 3.0])),
)


@functools.partial(jax.jit, static_argnums=2)
def predicted(stack, mode_prob, interval):
    target = params().target._replace(motions=UNLIKE)
    return rmm_stack.predict(TAYLOR, target, stack, mode_prob, interval)


def flat(cov):
    size = cov.shape[0] * cov.shape[1]
    return np.asarray(cov).reshape(size, size)


def choices(stack, prob):
    """What a detection may be, with its probability, in plain NumPy."""
    num = len(stack.mean)
    listed = []
    for p in prob.T:
        weight = p / p.sum()
        centre = weight @ (stack.mean @ H.T)
        own = [
            flat(stack.cov)[4 * n : 4 * n + 4, 4 * n : 4 * n + 4] for n in range(num)
        ]
        gates = sum(w * (H @ P @ H.T + R) for w, P in zip(weight, own, strict=True))
        limit = -2 * np.log(1 - 0.99)  # chi-square with two degrees of freedom
        rows = [np.kron(np.eye(num)[n], H) for n in range(num)]
        mine = [(q, h, np.zeros(2), R) for q, h in zip(p, rows, strict=True)]
        false = (1 - p.sum(), np.zeros((2, 4 * num)), centre, gates * limit / 4)
        listed.append([*mine, false])
    return listed


@pytest.mark.parametrize("seed", range(4))
def test_update_is_the_best_linear_estimate(seed):
    """Two detections that two targets share, one of which may be false."""
    rng = np.random.default_rng(seed)
    stack = rmm_stack.begun_again(random_stack(rng, 2))
    prob = np.array([[0.6, 0.2], [0.4, 0.5]])
    detections = rng.normal(size=(2, 2)) * 4
    found = updated(stack, prob, detections, 0.99)
    mean, cov = shared_models.lmmse(
        stack.mean.reshape(-1), flat(stack.cov), choices(stack, prob), detections
    )
    np.testing.assert_allclose(found.mean.reshape(-1), mean, rtol=1e-10)
    # Cross-covariances may be nearly zero; variances are of order one.
    np.testing.assert_allclose(flat(found.cov), cov, rtol=1e-10, atol=1e-10)


def test_two_scans_are_the_best_linear_estimate_from_both():
    """The moments of the state are those before any detection, eq. 44."""
    rng = np.random.default_rng(5)
    stack = rmm_stack.begun_again(random_stack(rng, 2))
    prob = np.array([[0.7, 0.3], [0.3, 0.7]])
    first, second = rng.normal(size=(2, 2, 2)) * 4
    now = updated(stack, prob, first, 0.99)
    now = updated(now, prob, second, 0.99)
    both = choices(stack, prob) * 2
    mean, cov = shared_models.lmmse(
        stack.mean.reshape(-1), flat(stack.cov), both, [*first, *second]
    )
    np.testing.assert_allclose(now.mean.reshape(-1), mean, rtol=1e-10)
    # Cross-covariances may be nearly zero; variances are of order one.
    np.testing.assert_allclose(flat(now.cov), cov, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_prediction_has_the_moments_of_all_realisations(seed):
    rng = np.random.default_rng(seed)
    stack = rmm_stack.begun_again(random_stack(rng, 2))
    prob = np.array([[0.6, 0.4], [0.1, 0.9]])
    now = predicted(stack, prob, 0.7)
    each = [(dense(x.transition(0.7)), dense(x.noise(0.7))) for x in UNLIKE]
    maps = [
        [(p, F, np.zeros(4), Q) for p, (F, Q) in zip(row, each, strict=True)]
        for row in prob
    ]
    mean, cov = shared_models.moved(stack.mean, flat(stack.cov), maps)
    np.testing.assert_allclose(now.mean, mean, rtol=1e-10)
    np.testing.assert_allclose(flat(now.cov), cov, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(flat(now.state_cov), cov, rtol=1e-10, atol=1e-12)


def test_certain_association_is_a_kalman_filter_each():
    rng = np.random.default_rng(1)
    single = Gaussian(
        rng.normal(size=(3, 4)), np.array([book.random_cov(rng, 4) for _ in range(3)])
    )
    stack = rmm_stack.stack(single)
    detections = rng.normal(size=(4, 2))
    prob = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]])
    found = updated(stack, prob, detections, 0.99)
    each = rmm_stack.each(found)
    for n, k in ((0, 1), (1, 0)):
        mean, cov, _ = book.update(
            single.mean[n], single.cov[n], H, np.zeros(2), R, detections[k]
        )
        np.testing.assert_allclose(each.mean[n], mean, rtol=1e-10)
        np.testing.assert_allclose(each.cov[n], cov, rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(each.mean[2], single.mean[2])
    for n in range(3):
        cross = np.delete(np.asarray(found.cov)[n], n, axis=1)
        np.testing.assert_array_equal(cross, 0)  # Corollary 1


def window_of(rng, sizes, given=None, room=4):
    detections, valid = np.zeros((len(sizes), room, 2)), np.zeros((len(sizes), room))
    for n, size in enumerate(sizes):
        detections[n, :size] = rng.normal(size=(size, 2)) * 2
        valid[n, :size] = 1
    ones = np.ones(len(sizes))
    look = rmm_leaves.look_of(given or params())
    look = jax.tree.map(lambda x: np.stack([x] * len(sizes)), look)
    return rmm_leaves.Window(detections, valid > 0, 0.7 * ones, ones > 0, look)


@functools.cache
def grower(max_leaves, num_scans):
    rules = rmm_leaves.Rules(TAYLOR, 1.0, max_leaves)
    del num_scans
    return jax.jit(lambda b, w: rmm_leaves.grow(rules, params(), b, w))


@pytest.mark.parametrize("sizes", [(2, 1), (1, 0), (2, 2)])
def test_leaves_have_the_best_of_all_models(sizes):
    rng = np.random.default_rng(sum(sizes))
    belief = Gaussian(rng.normal(size=4), book.random_cov(rng, 4))
    window = window_of(rng, sizes)
    found = grower(30, 2)(belief, window)
    density = RATE / SIDE**2
    ratios = [
        (np.log(s), np.log(1 - d), np.log(d / density))
        for s, d in zip(SURVIVE, DETECT, strict=True)
    ]
    scans = [x[v] for x, v in zip(window.detections, window.valid, strict=True)]
    expected = shared_models.leaves(*belief, [matrices(0.7)] * 2, (H, R), ratios, scans)
    seen = {}
    for score, first, mode_prob, past in zip(*found, strict=True):
        if score > -np.inf:
            seen[tuple(int(k) for k in past)] = (score, first, mode_prob)
    assert seen.keys() == expected.keys()
    for past, (score, models, first) in expected.items():
        np.testing.assert_allclose(seen[past][0], score, rtol=1e-10)
        np.testing.assert_allclose(seen[past][1], first, rtol=1e-10)
        np.testing.assert_array_equal(seen[past][2], np.eye(2)[list(models)])
    assert tuple(found.past[0]) == (-1, -1)


def test_models_that_are_level_share_equally():
    """Alike in survival and detection, and nothing seen."""
    same = params().target._replace(
        survive=probability.Constant(0.9), detect=probability.Constant(0.8)
    )
    given = params()._replace(target=same)
    rules = rmm_leaves.Rules(TAYLOR, 1.0, 1)
    window = window_of(np.random.default_rng(0), (1, 1), given)
    belief = Gaussian(jnp.zeros(4), jnp.eye(4))
    grow = jax.jit(lambda b, w: rmm_leaves.grow(rules, given, b, w))
    found = grow(belief, window)
    np.testing.assert_allclose(found.mode_prob, 0.5)


@functools.cache
def sharer(num):
    def share(log_score, past):
        return rmm_association.share(log_score, past, num, max_contested=num)

    return jax.jit(jax.vmap(share))


def random_leaves(seed):
    rng = np.random.default_rng(seed)
    past = rng.integers(-1, 4, (5, 6, 2))
    past[:, 0] = -1
    score = rng.normal(size=(5, 6)) * 3
    score[rng.random((5, 6)) < 0.2] = -np.inf
    score[:, 0] = -rng.random(5)
    return score, past


def test_the_programme_has_the_value_of_highs():
    problems = [random_leaves(seed) for seed in range(60)]
    found = sharer(4)(*(jnp.array(x) for x in zip(*problems, strict=True)))
    fractional = 0
    for k, (score, past) in enumerate(problems):
        expected = host.relax_exact(Problem(score, past), 4)
        np.testing.assert_allclose(found.log_value[k], expected.log_score, rtol=1e-6)
        used = rmm_association.hits(found.leaf[k], past, 4).sum(0)
        assert (used <= 1 + 1e-6).all()
        np.testing.assert_allclose(found.leaf[k].sum(1), 1)
        fractional += not found.integral[k]
    assert 0 < fractional < 30


def test_what_finds_no_slot_goes_to_the_best():
    score = jnp.array([[0.0, 3.0, 2.0], [0.0, 2.0, 2.5]])
    past = jnp.array([[[-1], [0], [1]], [[-1], [0], [1]]])
    share = jax.jit(lambda s, p: rmm_association.share(s, p, 4, max_contested=1))
    np.testing.assert_allclose(
        share(score, past).leaf, [[0, 1, 0], [0, 0, 1]], atol=1e-6
    )
