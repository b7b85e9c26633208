"""Tests of hypothesis trackers where models say that what happens cannot be."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes

from jaxtrack.models.birth import DetectionBirth
from jaxtrack.trackers import (
    global_hypotheses,
    hypothesis_mht,
    mht,
    multiscan_choice,
    oracle,
    thinning,
)
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.global_hypotheses import Hypotheses
from jaxtrack.types import Gaussian, Scan

SCANS = 12
SMALL = {"max_tracks": 6, "max_leaves": 4, "max_undetected": 4}


def problem(**changes):
    calm = {**scenes.draw(4), "births": 0.02, "undetected": 0.5, "detect": 0.95}
    calm |= {"clutter": 0.5, "sensor_var": 0.3, "survive": 0.98, "position_std": 4.0}
    return {**calm, **changes}


@functools.cache
def runner(**settings):
    tracker = mht.mht(scenes.target, **{**SMALL, "max_hypotheses": 4, **settings})

    @jax.jit
    def run(params, scans):
        step = functools.partial(tracker.step, params)
        state = tracker.init(params, jax.random.key(0))
        return jax.lax.scan(lambda state, scan: step(state, scan), state, scans)

    return run


def two_places(first=-3.0, second=3.0):
    rng = np.random.default_rng(5)
    places = np.array([first, second]) + rng.normal(0, 0.3, (SCANS, 2))
    return Scan(
        jnp.asarray(places)[..., None],
        jnp.ones((SCANS, 2), bool),
        jnp.full(SCANS, scenes.INTERVAL),
    )


def reported(estimates):
    return [
        sorted(label[there].tolist())
        for label, there in zip(estimates.label, estimates.exists, strict=True)
    ]


@pytest.mark.parametrize(
    ("rate", "half"), [(0.0, 20.0), (0.5, 1.0)], ids=["no clutter", "outside the box"]
)
def test_targets_keep_their_labels_where_nothing_can_be_false(rate, half):
    params = scenes.params_of(problem())
    box = params.clutter._replace(
        rate=jnp.asarray(rate), low=-half * jnp.ones(1), high=half * jnp.ones(1)
    )
    _, usual = runner(num_scans=1)(params, two_places())
    _, odd = runner(num_scans=1)(params._replace(clutter=box), two_places())
    assert reported(odd)[-1] == reported(usual)[-1]
    assert len(reported(odd)[-1]) == 2
    assert reported(odd)[3] == reported(odd)[-1]
    # The same tracks explain the scans; only what might be false differs.
    assert odd.log_evidence.sum() < usual.log_evidence.sum() + 5 * SCANS


def test_a_rare_target_is_found_without_clutter():
    params = scenes.params_of(problem(clutter=0.0))
    births = DetectionBirth(
        rate=jnp.asarray(0.01),
        max_existence_prob=jnp.asarray(1.0),
        velocity_std=jnp.ones(1),
        extra_std=jnp.zeros(0),
        mode_prob=jnp.ones(1),
    )
    params = params._replace(birth=births, undetected=None)
    _, estimates = runner(num_scans=1)(params, two_places())
    assert len(reported(estimates)[-1]) == 2


def test_a_track_long_dead_makes_room():
    params = scenes.params_of(problem(survive=0.6, births=0.01, undetected=0.01))
    scans = two_places()
    late = np.zeros((SCANS, 2), bool)
    late[0, 0] = True
    late[6:, 1] = True
    scans = scans._replace(valid=jnp.asarray(late))
    run = runner(num_scans=1, max_tracks=1)
    _, alone = run(params, scans._replace(valid=scans.valid.at[0].set(False)))
    _, after = run(params, scans)
    assert alone.exists[-1].any()
    np.testing.assert_array_equal(after.exists[-1], alone.exists[-1])


def test_leaves_merge_by_how_likely_their_targets_still_exist():
    belief = Gaussian(jnp.array([[[0.0, 0.0], [1.0, 0.0]]]), jnp.ones((1, 2, 2, 2)))
    belief = belief._replace(cov=jnp.tile(9 * jnp.eye(2), (1, 2, 1, 1)))
    trees = Forest(
        log_score=jnp.zeros((1, 2)),
        existence_prob=jnp.array([[1.0, 0.01]]),
        belief=belief,
        past=jnp.zeros((1, 2, 1), jnp.int32),
        label=jnp.zeros(1, int),
        age=jnp.ones(1, jnp.int32),
    )
    equal = Hypotheses(jnp.log(jnp.array([0.5, 0.5])), jnp.array([[0], [1]]))
    merge = jax.jit(functools.partial(thinning.merge_leaves, scenes.target))
    merged, rows = merge(4.0, trees, equal)
    np.testing.assert_array_equal(rows.leaf, 0)
    np.testing.assert_allclose(merged.existence_prob[0, 0], 0.505, rtol=1e-12)
    mean = merged.belief.mean[0, 0, 0]
    np.testing.assert_allclose(mean, 0.01 / 1.01, rtol=1e-12)


def test_merging_changes_little_where_histories_are_alike():
    drawn = problem(clutter=2.0)
    params, scans = scenes.params_of(drawn), two_places()
    room = {**SMALL, "max_hypotheses": 12, "max_children": 4}

    def evidence(threshold):
        tracker = hypothesis_mht.hypothesis_mht(
            scenes.target, merge_threshold=threshold, **room
        )
        state = tracker.init(params, jax.random.key(0))
        step = functools.partial(tracker.step, params)
        run = jax.jit(lambda s: jax.lax.scan(lambda a, b: step(a, b), s, scans)[1])
        return run(state)

    apart, together = evidence(0.0), evidence(0.1)
    assert reported(apart)[-1] == reported(together)[-1]
    gap = abs(apart.log_evidence.sum() - together.log_evidence.sum())
    assert 0 < gap < 1


def test_the_heaviest_hypothesis_always_has_its_leaves():
    code = jnp.array([[1, 1, 1], [2, 2, 1], [2, 1, 3]])
    rows = Hypotheses(jnp.log(jnp.array([0.4, 0.3, 0.3])), code)
    found = jax.jit(global_hypotheses.distinct, static_argnums=(1, 2))(rows, 1, 4)
    assert found.hypotheses.log_weight[0] == rows.log_weight[0]
    np.testing.assert_array_equal(found.hypotheses.leaf[0], 0)
    assert (found.hypotheses.log_weight[1:] == -jnp.inf).all()


def test_numbers_of_false_detections_count_those_that_are_there():
    drawn, places = scenes.draw(5), scenes.detections(5, (1, 2))
    scans, key = scenes.scans_of(places), jax.random.key(0)
    scans = [
        scans[0],
        scans[1]._replace(valid=jnp.array([True, False])),
    ]
    short = [scans[0], jax.tree.map(lambda x: x[:1] if x.ndim else x, scans[1])]
    params = scenes.params_of({**drawn, "births": 0.0})
    counts = oracle.Counts(false=jnp.log(jnp.array([0.5, 0.3, 0.15, 0.05])))

    @jax.jit
    def evidence(scans):
        found = oracle.posterior(scenes.target, params, scans, key, counts)
        return found.log_evidence

    np.testing.assert_allclose(evidence(scans), evidence(short), rtol=1e-12)
    few = oracle.Counts(false=jnp.log(jnp.array([0.5, 0.5])))
    with pytest.raises(ValueError, match="counts.false has 2 numbers and a scan has 2"):
        oracle.posterior(scenes.target, params, scans, key, few)


def test_what_remains_is_what_can_still_be_said():
    """Of two trees in one cluster the second goes, which the best does not have."""
    log_score = jnp.array([[1.0, 2.0], [3.0, -jnp.inf]])
    past = jnp.zeros((2, 2, 1), jnp.int32)
    trees = Forest(log_score, jnp.ones((2, 2)), None, past, jnp.arange(2), jnp.ones(2))
    leaf = jnp.array([[1, -1], [0, -1], [0, 0], [1, 0]])
    weight = jnp.array([2.0, 1.0, 4.0, -jnp.inf])
    choice = multiscan_choice.Choice(
        leaf=leaf,
        log_weight=jnp.tile(weight[:, None], (1, 2)),
        label=jnp.zeros(2, int),
        best=jnp.array([1, -1]),
        log_joint=weight,
        log_loss=jnp.zeros(()),
        claimed=jnp.zeros(2, bool),
    )
    kept, sure = jnp.array([True, False]), jnp.zeros(2, bool)
    remaining = jax.jit(multiscan_choice.remaining)
    found = remaining(choice, trees, kept, sure)
    np.testing.assert_allclose(found, np.logaddexp(2.0, 1.0), rtol=1e-12)
    fewer = trees._replace(log_score=log_score.at[0, 0].set(-jnp.inf))
    found = remaining(choice, fewer, kept, sure)
    np.testing.assert_allclose(found, 2.0, rtol=1e-12)


def test_scores_of_sure_trees_do_not_grow_without_end():
    params, scans = scenes.params_of(problem()), two_places()
    state, _ = runner(num_scans=1)(params, scans)
    assert state.sure.sum() == 2
    np.testing.assert_array_equal(state.trees.log_score[state.sure].max(1), 0)
