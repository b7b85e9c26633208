"""Tests of `trackers.clustered_mht`: clusters that stay apart, join, and part."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import models, targets
from jaxtrack.models.birth import MultiBernoulliBirth, PoissonBirth
from jaxtrack.trackers import clustered_mht, hypothesis_mht, undetected
from jaxtrack.types import Scan

pytestmark = pytest.mark.usefixtures("whole_matrices")
TARGET = targets.single.single()
SCANS, SLOTS, FAR = 3, 4, 1000.0
PAIRS = {
    "max_hypotheses": 24,
    "max_children": 96,
    "max_clusters": 2,
    "max_members": 8,
    "max_detections": 2,
    "max_tracks": 16,
    "max_leaves": 12,
    "prune_threshold": 0.0,
    "exist_threshold": 0.0,
    "split_threshold": 0.0,
}
# Known targets: a pair here and a pair far away.
TWO_PAIRS = [-3.0, 3.0, FAR - 3.0, FAR + 3.0]


def params_of(places, births=0.1, detect=0.8, clutter=20.0):
    num = len(places)
    mean = np.stack([places, np.zeros(num)], 1)
    cov = np.tile(np.diag([1.0, 0.5]), (num, 1, 1))
    modes = np.ones((num, 1))
    wide = np.tile(np.diag([25.0, 1.0]), (num, 1, 1))
    rate = np.full(num, births / num)
    return undetected.Params(
        target=targets.single.Params(
            motion=models.motion.ConstantVelocity(np.array([0.2])),
            sensor=models.sensor.Position(np.array([1.0])),
            survive=models.probability.Constant(np.array(0.97)),
            detect=models.probability.Constant(np.array(detect)),
        ),
        birth=PoissonBirth(rate, mean, wide, modes),
        clutter=models.clutter.UniformClutter(
            np.array(clutter), np.array([-200.0]), np.array([FAR + 200.0])
        ),
        start=MultiBernoulliBirth(np.full(num, 0.9), mean, cov, modes),
    )


def scans_of(rows, slots):
    points = np.zeros((len(rows), slots, 1))
    there = np.zeros((len(rows), slots), bool)
    for t, row in enumerate(rows):
        points[t, : len(row), 0] = row
        there[t, : len(row)] = True
    return Scan(points, there, np.ones(len(rows)))


def stacked(trees):
    return jax.tree.map(lambda *x: jnp.stack([jnp.asarray(y) for y in x]), *trees)


def run(tracker, params, scans):
    """Returns what was told, and the clusters."""
    step = functools.partial(tracker.step, params)

    def next_scan(state, scan):
        state, told = step(state, scan)
        return state, (told, state[1])

    state = tracker.init(params, jax.random.key(0))
    return jax.lax.scan(next_scan, state, scans)[1]


def of_pairs():
    """Detections of both pairs, of one, of the other, and none."""
    rng = np.random.default_rng(2)
    points = np.array(TWO_PAIRS)[None] + rng.normal(0, 2.0, (SCANS, SLOTS))
    there = rng.random((SCANS, SLOTS)) < 0.8
    here = np.array([True, True, False, False])
    return stacked(
        Scan(points[..., None], there & kept[None], np.ones(SCANS))
        for kept in (here | ~here, here, ~here, here & ~here)
    )


@functools.cache
def told_of_pairs():
    tracker = clustered_mht.clustered_mht(TARGET, **PAIRS)
    each = functools.partial(run, tracker, params_of(TWO_PAIRS))
    return jax.jit(jax.vmap(each))(of_pairs())


def test_pairs_far_apart_do_not_know_of_each_other():
    """Even pruned: one of them is what it is without the other's detections."""
    told, views = told_of_pairs()
    for values in (told.log_evidence, told.num_mean, told.num_var, told.entropy):
        both, here, there, none = np.asarray(values)
        np.testing.assert_allclose(both + none, here + there, rtol=1e-9, atol=1e-9)
    assert (told.entropy[0] > 1).any()
    there = jnp.where(told.label[0] >= 0, told.mean[0, ..., 0], 0.0) > FAR / 2
    label = views.label[0]
    with_other = (label[:, :, None] == label[:, None]) & (
        there[:, :, None] != there[:, None]
    )
    assert not with_other.any()


# Where the third scan has a detection that may be of either.
BETWEEN = [[-4.0, 4.0], [-4.1, 4.1], [0.2], [-4.0, 4.2], [-4.1, 4.0], [-3.9, 4.1]]
FEW = {"max_tracks": 2, "max_undetected": 4, "exist_threshold": 0.0, "gate_prob": 0.99}
LISTS = {"max_clusters": 2, "max_members": 2, "max_detections": 2}


def of_two(tracker):
    params = params_of([-4.0, 4.0], births=0.0, detect=0.9, clutter=5.0)
    return jax.jit(functools.partial(run, tracker, params))(scans_of(BETWEEN, 2))


def test_clusters_join_at_a_detection_of_either_and_part_again():
    merging = {"merge_threshold": 1.0, "split_threshold": 1e-4}
    told, views = of_two(clustered_mht.clustered_mht(TARGET, **LISTS, **FEW, **merging))
    together = views.label[:, 1] == views.label[:, 0]
    assert not together[:2].any()
    assert together[2:4].all()
    assert not together[-1]
    whole = hypothesis_mht.hypothesis_mht(
        TARGET, max_hypotheses=256, max_children=7, max_leaves=64, **FEW
    )
    exact, _ = of_two(whole)
    # What merging and parting cost, in nats and in targets.
    np.testing.assert_allclose(told.log_evidence, exact.log_evidence, atol=1e-2)
    np.testing.assert_allclose(told.num_mean, exact.num_mean, atol=5e-3)
    np.testing.assert_allclose(told.num_var, exact.num_var, atol=5e-3)
    np.testing.assert_array_equal(told.exists, exact.exists)
    np.testing.assert_array_equal(told.label, exact.label)
    np.testing.assert_allclose(told.mean[-1, :, 0], exact.mean[-1, :, 0], atol=0.1)
    # Where they have joined, nothing is lost yet but by merging.
    gap = abs(told.log_evidence - exact.log_evidence)
    assert gap[2] < 1e-3


def test_a_hypothesis_goes_with_any_of_its_leaves():
    """With one history of each track only the best hypothesis is left of a cluster."""
    tracker = clustered_mht.clustered_mht(
        TARGET, max_hypotheses=8, **LISTS, **{**FEW, "max_leaves": 1}
    )
    told, _ = of_two(tracker)
    # Roundings of a weight that is all there is.
    np.testing.assert_allclose(told.entropy, 0, atol=1e-12)
    assert (told.dropped[2] > 0.01).all()
    assert (told.existence_prob[-1] > 0.9).all()
