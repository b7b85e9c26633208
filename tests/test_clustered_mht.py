"""Tests of `trackers.clustered_mht` against all hypotheses, and against one list."""

import functools

import jax
import numpy as np
import pytest
from cases import small_scenes as scenes

from jaxtrack.trackers import clustered_mht, enumeration, oracle

pytestmark = pytest.mark.usefixtures("whole_matrices")
SIZES = 1, 2, 1
NUM, MAX = 100, 20
ROOM = {
    "max_hypotheses": 48,
    "max_children": 200,
    "max_clusters": 2,
    "max_members": 6,
    "max_detections": 2,
    "max_tracks": 6,
    "max_leaves": 9,
    "max_undetected": 4,
    "gate_prob": 1.0,
    "prune_threshold": 0.0,
    "exist_threshold": 0.0,
    "split_threshold": 0.0,
}


def track(drawn, places, tracker):
    """Runs a tracker over scans of different sizes; returns the last estimate."""
    params = scenes.params_of(drawn)
    scans = scenes.stacked(scenes.padded(places))
    state = tracker.init(params, jax.random.key(0))
    step = functools.partial(tracker.step, params)
    _, estimates = jax.lax.scan(lambda state, scan: step(state, scan), state, scans)
    last = jax.tree.map(lambda x: x[-1], estimates)
    return last, estimates.log_evidence.sum()


def exact(drawn, places):
    key = jax.random.key(0)
    scans = scenes.scans_of(places)
    params = scenes.params_of(drawn)
    return oracle.posterior(scenes.target, params, scans, key, max_targets=MAX)


def drawn():
    problems = scenes.stacked([scenes.draw(seed) for seed in range(NUM)])
    return problems, scenes.stacked([scenes.detections(k, SIZES) for k in range(NUM)])


@functools.cache
def told(**less):
    tracker = clustered_mht.clustered_mht(scenes.target, **{**ROOM, **less})
    return jax.jit(jax.vmap(lambda d, p: track(d, p, tracker)))(*drawn())


@functools.cache
def truth():
    return jax.jit(jax.vmap(exact))(*drawn())


def test_with_room_for_all_it_is_the_posterior():
    (estimate, log_evidence), known = told(), truth()
    np.testing.assert_allclose(log_evidence, known.log_evidence, rtol=1e-10)
    number = enumeration.count(SIZES)
    expected = -np.sort(-np.asarray(known.log_prob), axis=1)
    prob = estimate.hypothesis_prob
    # What is nearly impossible says nothing of whether tracks are independent.
    np.testing.assert_allclose(
        prob[:, :number], np.exp(expected), rtol=1e-10, atol=1e-14
    )
    assert (estimate.dropped < 1e-12).all()  # roundings of sums of order one


def test_it_knows_how_many_targets_there_are():
    (estimate, _), known = told(), truth()
    count = np.arange(MAX + 1)
    mean = known.num_prob @ count
    np.testing.assert_allclose(estimate.num_mean, mean, rtol=1e-9)
    var = known.num_prob @ count**2 - mean**2
    np.testing.assert_allclose(estimate.num_var, var, rtol=1e-8)


def test_tracks_are_as_likely_as_all_hypotheses_say():
    (estimate, _), known = told(), truth()
    listed = enumeration.table(SIZES)
    begun = (listed.track >= 0).argmax(1)
    which = listed.track[np.arange(len(begun)), begun]
    share = known.track_prob * known.existence_prob
    for scan, size in enumerate(SIZES):
        for k in range(size):
            label = sum(SIZES[:scan]) + k
            mine = (begun == scan) & (which == k)
            found = estimate.existence_prob * (estimate.label == label)
            np.testing.assert_allclose(found.sum(1), share[:, mine].sum(1), rtol=1e-9)


def test_what_finds_no_room_costs_something_and_is_told():
    estimate, log_evidence = told(max_hypotheses=2)
    error = abs(truth().log_evidence - log_evidence)
    assert 0.01 < error.mean() < 1
    wrong = abs(estimate.num_mean - told()[0].num_mean)
    assert wrong.mean() < estimate.dropped.mean() < 20 * wrong.mean()
    assert (estimate.dropped > 0).mean() > 0.9
