"""Tests of `trackers.mht` against the posterior of all hypotheses."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes

from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.trackers import enumeration, mht, oracle

SIZES = 1, 2, 1
NUM, MAX = 100, 20
ROOM = {
    "solver": "lagrangian",
    "num_scans": 3,
    "max_hypotheses": 48,
    "max_tracks": 6,
    "max_leaves": 12,
    "max_undetected": 4,
    "gate_prob": 1.0,
    "prune_threshold": 0.0,
    "exist_threshold": 0.0,
}


def drawn():
    problems = scenes.stacked([scenes.draw(seed) for seed in range(NUM)])
    return problems, scenes.stacked([scenes.detections(k, SIZES) for k in range(NUM)])


def track(problem, places, tracker):
    """All estimates of a tracker."""
    params = scenes.params_of(problem)
    scans = scenes.stacked(scenes.padded(places))
    state = tracker.init(params, jax.random.key(0))
    step = functools.partial(tracker.step, params)
    return jax.lax.scan(lambda state, scan: step(state, scan), state, scans)[1]


def exact(problem, places):
    key = jax.random.key(0)
    scans, params = scenes.scans_of(places), scenes.params_of(problem)
    return oracle.posterior(scenes.target, params, scans, key, max_targets=MAX)


def found(**less):
    return told(tuple(sorted({**ROOM, **less}.items())))


@functools.cache
def told(settings):
    tracker = mht.mht(scenes.target, **dict(settings))
    return jax.jit(jax.vmap(lambda d, p: track(d, p, tracker)))(*drawn())


@functools.cache
def truth():
    return jax.jit(jax.vmap(exact))(*drawn())


@pytest.mark.parametrize("solver", ["lagrangian", "decomposition", "greedy", "exact"])
def test_with_room_for_all_it_is_the_posterior(solver):
    estimates, expected = found(solver=solver), truth()
    log_evidence = estimates.log_evidence.sum(1)
    np.testing.assert_allclose(log_evidence, expected.log_evidence, rtol=1e-10)
    number = enumeration.count(SIZES)
    prob = -np.sort(-np.exp(expected.log_prob), axis=1)
    kept = estimates.hypothesis_prob[:, -1]
    np.testing.assert_allclose(kept[:, :number], prob, rtol=1e-10)
    assert (kept[:, number:] == 0).all()
    count = np.arange(MAX + 1)
    mean = expected.num_prob @ count
    np.testing.assert_allclose(estimates.num_mean[:, -1], mean, rtol=1e-9)
    var = expected.num_prob @ count**2 - mean**2
    np.testing.assert_allclose(estimates.num_var[:, -1], var, rtol=1e-8)
    # Roundings of sums of order one.
    assert (estimates.dropped < 1e-12).all()


def test_entropy_and_runner_up_are_those_of_all_hypotheses():
    estimates, expected = found(), truth()
    prob = np.exp(expected.log_prob)
    entropy = -(prob * np.asarray(expected.log_prob)).sum(1)
    np.testing.assert_allclose(estimates.entropy[:, -1], entropy, rtol=1e-9)
    first, second = np.sort(prob, axis=1)[:, [-1, -2]].T
    np.testing.assert_allclose(estimates.runner_up[:, -1], second / first, rtol=1e-9)


def test_the_best_alone_has_the_score_of_the_best():
    estimates, expected = found(max_hypotheses=1), truth()
    best = np.asarray(expected.log_prob).max(1) + expected.log_evidence
    # Sums of logarithms of order ten.
    np.testing.assert_allclose(estimates.log_evidence.sum(1), best, atol=1e-9)
    assert (estimates.log_loss < 1e-6).mean() > 0.9  # what Lagrangians prove


def test_tracks_are_as_likely_as_all_hypotheses_say():
    estimates, expected = found(), truth()
    listed = enumeration.table(SIZES)
    begun = (listed.track >= 0).argmax(1)
    which = listed.track[np.arange(len(begun)), begun]
    for scan, size in enumerate(SIZES):
        for k in range(size):
            label = sum(SIZES[:scan]) + k
            mine = (begun == scan) & (which == k)
            share = expected.track_prob * expected.existence_prob
            here = estimates.label[:, -1] == label
            there = np.where(here, estimates.existence_prob[:, -1], 0).sum(1)
            np.testing.assert_allclose(there, share[:, mine].sum(1), rtol=1e-9)


def test_less_room_loses_more_and_says_so():
    errors, lost = [], []
    for leaves in (2, 12):
        estimates = found(max_leaves=leaves)
        gap = estimates.log_evidence.sum(1) - truth().log_evidence
        errors.append(abs(gap).mean())
        lost.append(estimates.dropped.sum(1).mean())
    assert errors[0] > errors[1]
    assert lost[0] > lost[1]


def test_decisions_that_come_later_lose_less():
    by_window = [
        abs(found(num_scans=k).log_evidence.sum(1) - truth().log_evidence).mean()
        for k in (0, 3)
    ]
    assert by_window[0] > by_window[1]


def test_gradients_of_the_evidence_are_right():
    tracker = mht.mht(scenes.target, **ROOM)
    problem, places = scenes.draw(3), scenes.detections(3, SIZES)

    @jax.jit
    def log_evidence(problem):
        return track(problem, places, tracker).log_evidence.sum()

    slope = jax.jit(jax.grad(log_evidence))(jax.tree.map(jnp.asarray, problem))
    for name in ("sensor_var", "births", "detect", "clutter", "survive", "undetected"):
        step = 1e-5 * problem[name]
        ahead, behind = (
            log_evidence({**problem, name: problem[name] + sign * step})
            for sign in (1, -1)
        )
        expected = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(slope[name], expected, rtol=1e-6, err_msg=name)


def test_a_track_that_is_doubtful_at_first_is_not_forgotten():
    """One detection a scan, each too little to believe in a rare target by itself."""
    problem = {**scenes.draw(4), "births": 0.002, "undetected": 0.0, "detect": 0.9}
    problem |= {"clutter": 0.5, "sensor_var": 0.3, "survive": 0.99}
    rng = np.random.default_rng(3)
    places = [rng.normal(2.0, 0.3, 1) for _ in range(8)]
    tracker = mht.mht(scenes.target, **{**ROOM, "num_scans": 1})
    estimates = jax.jit(lambda p, z: track(p, z, tracker))(problem, places)
    reported = np.asarray(estimates.exists.sum(1))
    assert reported[0] == 0
    np.testing.assert_array_equal(reported[-3:], 1)
    first = estimates.label[-1][estimates.exists[-1]]
    assert (first < 2).all()  # begun by the first or the second scan


def test_known_targets_are_there_from_the_start():
    problem = scenes.draw(2)
    params = scenes.params_of(problem)
    start = MultiBernoulliBirth(
        jnp.array([1.0, 0.7]),
        jnp.array([[4.0, 0.0], [-4.0, 0.0]]),
        jnp.tile(jnp.eye(2), (2, 1, 1)),
        jnp.ones((2, 1)),
    )
    tracker = mht.mht(scenes.target, **ROOM)
    state = tracker.init(params._replace(start=start), jax.random.key(0))
    scan = scenes.padded([np.array([3.8]), np.zeros(2)])[0]
    _, estimate = jax.jit(tracker.step)(params, state, scan)
    assert estimate.exists[estimate.label == 0].all()
    other = estimate.existence_prob[estimate.label == 1]
    missed = 0.7 * problem["survive"]
    hidden = missed * (1 - problem["detect"])
    # Nobody else is near enough to have caused the detection.
    np.testing.assert_allclose(other, hidden / (1 - missed + hidden), rtol=1e-2)


@pytest.mark.parametrize(
    ("setting", "value", "told"),
    [
        ("max_tracks", 0, "max_tracks is 0; give at least 1"),
        ("max_leaves", 0, "max_leaves is 0; give at least 1"),
        ("max_leaves", 1, "max_leaves is 1; give at least 2"),
        ("num_scans", -1, "num_scans is -1; give 0 or more"),
        ("solver", "simplex", "solver is 'simplex'; give one of lagrangian"),
        ("prune_threshold", 2.0, "prune_threshold is 2.0; give a probability"),
        ("gate_prob", 0.0, "gate_prob is 0.0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting, value, told):
    with pytest.raises(ValueError, match=told):
        mht.mht(scenes.target, **{setting: value})
