"""The contract that every tracker keeps, whatever is inside it.

The cases are in `cases.trackers`; what they are held to was run once, in `cases.runs`.
"""

import chex
import jax
import numpy as np
import optax
import pytest
from cases import slopes
from cases.runs import alone, batched, in_float32, roomy, runner, to_numpy
from cases.trackers import (
    CASES,
    HYPOTHESES,
    SAMPLED,
    SCANS,
    SECOND_VARIANTS,
    SLOTS,
    TRAJECTORIES,
    case_of,
    random_scans,
    tracker_of,
    variants,
)

COMMON = (
    "mean",
    "cov",
    "label",
    "exists",
    "existence_prob",
    "mode_prob",
    "log_evidence",
    "dropped",
)
NAMES = [
    pytest.param(name, marks=[pytest.mark.slow] if name in SECOND_VARIANTS else [])
    for name in CASES
]
# A roomy tracker that merges takes into its tracks what a tight one has dropped, and a
# CPHD filter's weights add up to its expected number, whatever was dropped. Hypotheses
# that go make others likelier.
ELASTIC = {"cbmember_merging", "cphd_imm", "cphd_detection_birth", *HYPOTHESES}
EQUAL_BIRTHS = {
    "cbmember_detection_birth",
    "cphd_detection_birth",
    "nearest",
    "gnn",
    "ipda",
    "jpda",
    "lmb",
    *HYPOTHESES,
}
every_tracker = pytest.mark.parametrize("name", NAMES)
every_trajectory_tracker = pytest.mark.parametrize(
    "name", [name for name in NAMES if name.values[0] in TRAJECTORIES]
)
every_certain_tracker = pytest.mark.parametrize(
    "name", [name for name in NAMES if name.values[0] not in SAMPLED]
)


def filled(estimates):
    """The common fields with nothing behind empty slots, which may hold anything."""
    there = estimates.existence_prob > 0
    return {name: getattr(estimates, name) for name in COMMON} | {
        "mean": np.where(there[..., None], estimates.mean, 0),
        "cov": np.where(there[..., None, None], estimates.cov, 0),
        "label": np.where(there, estimates.label, -1),
        "mode_prob": np.where(there[..., None], estimates.mode_prob, 0),
    }


def assert_same(one, other, rtol=1e-8, atol=1e-10):
    chex.assert_trees_all_close(filled(one), filled(other), rtol=rtol, atol=atol)


@every_tracker
def test_the_scene_is_worth_testing(name):
    """Tracks come to exist, slots run out, and some are left empty or fade."""
    estimates = alone(name)[0][1]
    assert estimates.exists.any()
    assert not estimates.exists.all()
    assert (estimates.dropped > 0).any()


@every_tracker
def test_padding_and_batching_change_nothing(name):
    base = batched(name).variant["base"]
    assert_same(base, alone(name)[0][1])
    assert_same(batched(name).variant["noisy padding"], base)


@every_tracker
def test_order_of_detections_changes_nothing(name):
    base, backwards = (batched(name).variant[key] for key in ("base", "backwards"))
    if name in EQUAL_BIRTHS:
        # Newborn tracks are equally likely, so that the order decides which one finds
        # no room; the number expected and the next evidence come before that.
        np.testing.assert_allclose(backwards.log_evidence[:2], base.log_evidence[:2])
    else:
        assert_same(backwards, base)


@every_tracker
def test_runs_are_independent(name):
    (_, expected), _ = runner(name)(case_of(name).params, random_scans(name, 1))
    assert_same(batched(name).variant["other run"], to_numpy(expected))


@every_tracker
def test_state_keeps_shape_dtype_and_structure(name):
    """Weak types too, so that a second call of `step` does not trace again."""
    tracker, params = tracker_of(name), case_of(name).params
    scan = jax.tree.map(lambda x: x[0], random_scans(name, 0))
    before = jax.eval_shape(tracker.init, params, jax.random.key(0))
    after, _ = jax.eval_shape(tracker.step, params, before, scan)
    chex.assert_trees_all_equal_structs(before, after)
    for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (old.shape, old.dtype, old.weak_type) == (
            new.shape,
            new.dtype,
            new.weak_type,
        )


@every_tracker
def test_equal_settings_are_the_same_tracker(name):
    assert tracker_of(name) is tracker_of(name)


@every_tracker
def test_estimate_has_the_common_fields(name):
    estimates = alone(name)[0][1]
    for field in COMMON:
        assert hasattr(estimates, field)
    size, dim = estimates.mean.shape[1:]
    chex.assert_shape(estimates.cov, (SCANS, size, dim, dim))
    chex.assert_shape(
        [estimates.label, estimates.exists, estimates.existence_prob], (SCANS, size)
    )
    chex.assert_shape([estimates.log_evidence, estimates.dropped], (SCANS,))
    assert estimates.mode_prob.shape[:2] == (SCANS, size)
    assert estimates.exists.dtype == bool
    assert np.issubdtype(estimates.label.dtype, np.integer)


@every_tracker
def test_probabilities_are_probabilities(name):
    for estimates in batched(name).variant.values():
        assert (estimates.existence_prob >= 0).all()
        assert (estimates.existence_prob <= 1 + 1e-12).all()
        np.testing.assert_allclose(
            filled(estimates)["mode_prob"].sum(-1).round(12) % 1, 0
        )
        assert (estimates.dropped >= -1e-12).all()


@every_tracker
def test_labels_of_reported_tracks_are_unique(name):
    for estimates in batched(name).variant.values():
        for exists, label in zip(estimates.exists, estimates.label, strict=True):
            reported = label[exists]
            assert len(set(reported)) == len(reported)
            assert (reported >= 0).all()


@every_certain_tracker
def test_gradients_are_right(name):
    """In every float of Params."""
    params, (_, slope), many = case_of(name).params, alone(name), batched(name)
    slopes.assert_right(params, slope, many.slopes, many.scale, rtol=1e-4, atol=1e-6)


@every_tracker
def test_parameters_can_be_learned(name):
    """Twenty steps of Adam on the sensor's noise, begun at three times its size."""
    case, scans = case_of(name), random_scans(name, 0)
    noise = case.params.target.sensor.noise_std
    optimizer = optax.adam(0.1)
    theta = np.full_like(noise, np.log(3.0))
    state, losses = optimizer.init(theta), []
    for _ in range(20):
        radar = case.params.target.sensor._replace(noise_std=noise * np.exp(theta))
        params = case.params._replace(target=case.params.target._replace(sensor=radar))
        (evidence, _), slope = runner(name)(params, scans)
        losses.append(-evidence)
        direction = -slope.target.sensor.noise_std * noise * np.exp(theta)
        updates, state = optimizer.update(direction, state)
        theta = theta + np.array(updates)
    assert losses[-1] < losses[0] - 1


@every_tracker
@pytest.mark.parametrize("variant", ["empty", "full"])
def test_empty_and_full_scans_are_finite(name, variant):
    chex.assert_tree_all_finite(batched(name).variant[variant])
    scans = variants(name)[variant]
    short = jax.tree.map(lambda x: x[:, :SLOTS] if x.ndim > 1 else x, scans)
    (evidence, _), slope = runner(name)(case_of(name).params, short)
    chex.assert_tree_all_finite((evidence, slope))


@every_tracker
def test_empty_scans_say_that_there_is_little(name):
    estimates = batched(name).variant["empty"]
    assert not estimates.exists.any()
    assert (estimates.log_evidence < 0).all()


@pytest.mark.parametrize(
    "name", [name for name in NAMES if name.values[0] not in ELASTIC]
)
def test_capacities_drop_the_least_likely_and_say_so(name):
    """Until slots first run out, a tracker with more of them is in the same state."""
    tight, large = alone(name)[0][1], roomy(name)
    size = tight.existence_prob.shape[1]
    overfull = (large.existence_prob[:, size:] > 0).any(1)
    assert overfull.any()
    t = int(np.argmax(overfull))
    kept = jax.tree.map(
        lambda x: x[: t + 1, :size] if x.ndim > 1 else x[: t + 1], large
    )
    until = jax.tree.map(lambda x: x[: t + 1], tight)
    assert_same(until._replace(dropped=kept.dropped), kept)
    # What mixtures lose inside a track is counted in both.
    lost = large.existence_prob[t, size:].sum()
    assert lost > 0
    assert lost - 1e-12 <= tight.dropped[t] <= lost + large.dropped[t] + 1e-12


@every_certain_tracker
def test_float32_is_near_float64(name):
    rough = in_float32(name)
    fine = alone(name)[0][1]
    assert rough.mean.dtype == np.float32
    np.testing.assert_allclose(rough.log_evidence, fine.log_evidence, atol=3e-3)
    np.testing.assert_allclose(rough.existence_prob, fine.existence_prob, atol=3e-3)
    np.testing.assert_array_equal(rough.exists, fine.exists)
    np.testing.assert_array_equal(rough.label[fine.exists], fine.label[fine.exists])
    std = np.sqrt(np.diagonal(fine.cov[fine.exists], axis1=1, axis2=2))
    gap = (rough.mean[fine.exists] - fine.mean[fine.exists]) / std
    np.testing.assert_allclose(gap, 0, atol=0.02)


def reported(paths):
    """What is said of the scans in which the targets were, and nothing of the rest."""
    there = paths.alive
    return paths._replace(
        mean=paths.mean[there],
        cov=paths.cov[there],
        filtered=paths.filtered[there],
        label=np.where(there.any(2), paths.label, -1),
    )


@every_trajectory_tracker
def test_paths_are_the_same_in_a_batch_with_padding(name):
    one, many = alone(name)[0][1].paths, batched(name).variant["base"].paths
    assert one.alive.any(2).sum() > SCANS
    # Where it is nearly sure that nobody was, of probabilities.
    chex.assert_trees_all_close(reported(one), reported(many), rtol=1e-8, atol=1e-10)


@every_trajectory_tracker
def test_paths_end_with_what_is_reported_of_the_scan(name):
    told = alone(name)[0][1]
    paths = told.paths
    np.testing.assert_array_equal(paths.label, told.label)
    now = paths.alive[:, :, -1]
    assert now.any()
    np.testing.assert_allclose(paths.mean[:, :, -1][now], told.mean[now], rtol=1e-12)
    np.testing.assert_allclose(paths.cov[:, :, -1][now], told.cov[now], rtol=1e-12)
    # Whoever was there in a scan was so in all since the beginning.
    begun = (paths.alive_prob > 0)[:, :, :-1]
    rise = np.diff(paths.alive_prob, axis=2)[begun]
    assert (rise < 1e-12).all()  # roundings of probabilities


@every_trajectory_tracker
def test_paths_in_float32_are_near_those_in_float64(name):
    rough, fine = in_float32(name).paths, alone(name)[0][1].paths
    assert rough.mean.dtype == np.float32
    np.testing.assert_array_equal(rough.alive, fine.alive)
    # Of probabilities, by some scans of rounding errors, as above.
    np.testing.assert_allclose(rough.alive_prob, fine.alive_prob, atol=3e-3)
    std = np.sqrt(np.diagonal(fine.cov[fine.alive], axis1=1, axis2=2))
    gap = (rough.mean[fine.alive] - fine.mean[fine.alive]) / std
    np.testing.assert_allclose(gap, 0, atol=0.02)  # standard deviations, as above
