"""Tests of `trackers.pmbm` against the posterior of all hypotheses."""

import functools

import jax
import numpy as np
from cases import small_scenes as scenes
from reference import bernoullis

from jaxtrack.trackers import enumeration, oracle, pmbm

SIZES = 2, 1, 2
NUM, MAX = 60, 20
ROOM = {
    "max_hypotheses": 32,
    "max_tracks": 6,
    "max_leaves": 9,
    "max_undetected": 4,
    "gate_prob": 1.0,
    "prune_threshold": 0.0,
    "exist_threshold": 0.0,
}


def run(params, places, tracker):
    """Runs a tracker over scans of different sizes; returns its state and evidence."""
    scans = scenes.stacked(scenes.padded(places))
    state = tracker.init(params, jax.random.key(0))
    step = functools.partial(tracker.step, params)
    state, estimates = jax.lax.scan(step, state, scans)
    last = jax.tree.map(lambda x: x[-1], estimates)
    return state._replace(key=None), last, estimates.log_evidence.sum()


def exact(drawn, places):
    key = jax.random.key(0)
    params, scans = scenes.params_of(drawn), scenes.scans_of(places)
    return oracle.posterior(scenes.target, params, scans, key, max_targets=MAX)


@functools.cache
def drawn(lasting=False):
    fixed = {"births": 0.0, "survive": 1.0} if lasting else {}
    problems = scenes.stacked([{**scenes.draw(seed), **fixed} for seed in range(NUM)])
    return problems, scenes.stacked([scenes.detections(k, SIZES) for k in range(NUM)])


@functools.cache
def runner(settings):
    tracker = pmbm.pmbm(scenes.target, **dict(settings))
    return jax.jit(jax.vmap(lambda d, p: run(scenes.params_of(d), p, tracker)))


exactly = jax.jit(jax.vmap(exact))


@functools.cache
def both(lasting=False, **less):
    found = runner(tuple(sorted({**ROOM, **less}.items())))(*drawn(lasting))
    return jax.tree.map(np.asarray, (found, exactly(*drawn(lasting))))


def test_weights_are_those_of_all_hypotheses_with_the_same_pairs():
    """Whether a detection that is a track by itself is false, no hypothesis says."""
    (state, _, log_evidence), known = both()
    np.testing.assert_allclose(log_evidence, known.log_evidence, rtol=1e-10)
    listed = enumeration.table(SIZES)
    several = (listed.track >= 0).sum(1) > 1
    groups, where = np.unique(listed.member[:, several], axis=0, return_inverse=True)
    for weight, prob in zip(state.hypotheses.log_weight, known.log_prob, strict=True):
        expected = np.bincount(where.ravel(), np.exp(prob))
        found = np.exp(weight[: len(groups)])
        np.testing.assert_allclose(found, -np.sort(-expected), rtol=1e-10)
        assert (weight[len(groups) :] == -np.inf).all()


def test_it_knows_how_likely_every_number_of_targets_is():
    (state, estimate, _), known = both()
    hidden = np.exp(state.undetected.log_weight).sum(1)
    found = [
        bernoullis.numbers(*one, MAX)
        for one in zip(
            np.exp(state.hypotheses.log_weight),
            state.hypotheses.leaf,
            state.trees.existence_prob,
            hidden,
            strict=True,
        )
    ]
    # Of numbers that are all but impossible there is only the rounding of sums to one.
    np.testing.assert_allclose(found, known.num_prob, rtol=1e-10, atol=1e-14)
    mean = known.num_prob @ np.arange(MAX + 1)
    var = known.num_prob @ np.arange(MAX + 1) ** 2 - mean**2
    np.testing.assert_allclose(estimate.num_mean, mean, rtol=1e-10)
    np.testing.assert_allclose(estimate.num_var, var, rtol=1e-10)
    assert (estimate.dropped < 1e-12).all()  # roundings of sums of order one


def test_tracks_are_where_all_hypotheses_say():
    (state, estimate, _), known = both()
    listed = enumeration.table(SIZES)
    begun = (listed.track >= 0).argmax(1)
    which = listed.track[np.arange(len(begun)), begun]
    share = known.track_prob * known.existence_prob
    first = {}
    for label, (scan, k) in enumerate(
        (scan, k) for scan, size in enumerate(SIZES) for k in range(size)
    ):
        first[label] = (begun == scan) & (which == k)
    weight, mean = bernoullis.intensity(state)
    for label, mine in first.items():
        at = state.trees.label == label  # [R, N]
        found = (estimate.existence_prob * at).sum(1)
        np.testing.assert_allclose(found, share[:, mine].sum(1), rtol=1e-10)
        np.testing.assert_allclose((weight * at).sum(1), found, rtol=1e-12)
        place = (share[..., None] * known.belief.mean)[:, mine].sum(1)
        found = (weight[..., None] * mean * at[..., None]).sum(1)
        # A sum of terms of either sign.
        np.testing.assert_allclose(found, place, rtol=1e-10, atol=1e-10)


def test_targets_that_stay_have_the_weights_of_reid_and_mori():
    """If it says who is there, a hypothesis is one of theirs."""
    (state, _, _), known = both(lasting=True)
    for k in range(NUM):
        found = bernoullis.expanded(
            np.exp(state.hypotheses.log_weight[k]),
            state.hypotheses.leaf[k],
            state.trees.existence_prob[k],
        )
        found = sorted((prob for prob in found if prob > 0), reverse=True)
        expected = -np.sort(-np.exp(known.log_prob[k]))
        np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_what_finds_no_room_is_told():
    """Neither among the contested trees nor among the children."""
    _, known = both()
    for less in ({"max_contested": 2}, {"max_hypotheses": 4}):
        (_, estimate, log_evidence), _ = both(**less)
        assert (log_evidence < known.log_evidence + 1e-9).all()
        lost = known.log_evidence - log_evidence
        assert 0 < lost.mean() < 0.5
        assert (estimate.dropped > 0).mean() > 0.8
        assert estimate.dropped.mean() < 0.5


def test_gradient_of_the_evidence_is_that_of_finite_differences():
    problems, places = drawn()
    tracker = pmbm.pmbm(scenes.target, **ROOM)
    one = {key: value[0] for key, value in problems.items()}
    place = [x[0] for x in places]
    slope = jax.jit(jax.grad(lambda d: run(scenes.params_of(d), place, tracker)[2]))(
        one
    )
    names, step = ("detect", "clutter", "births", "survive", "sensor_var"), 1e-5
    near = {key: np.tile(value[0], NUM) for key, value in problems.items()}
    for k, name in enumerate(names):
        near[name][2 * k : 2 * k + 2] += np.array([step, -step])
    same = [np.tile(x, (NUM, *[1] * x.ndim)) for x in place]
    found = np.asarray(runner(tuple(sorted(ROOM.items())))(near, same)[2])
    for k, name in enumerate(names):
        expected = (found[2 * k] - found[2 * k + 1]) / step / 2
        np.testing.assert_allclose(slope[name], expected, rtol=1e-6)
