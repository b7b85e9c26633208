"""The contract that every tracker keeps, whatever is inside it.

Each case is compiled four times: alone with gradients, over a batch of variants (with
more padding), with large capacities, and in float32. All tests share these results.
"""

import functools
from typing import Any, NamedTuple

import chex
import jax
import numpy as np
import optax
import pytest

from jaxtrack import engine, linearize
from jaxtrack.models import birth, clutter, motion, probability, sensor, switching, turn
from jaxtrack.targets import imm, mixture, single
from jaxtrack.trackers import cbmember
from jaxtrack.types import Scan

SCANS, SLOTS, PADDED = 6, 5, 7
KEY = np.array(jax.random.key_data(jax.random.key(0)))
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


class Case(NamedTuple):
    """A maker that takes capacities, parameters, and where detections may fall."""

    make: Any
    params: Any
    low: Any
    high: Any
    paths: Any
    capacities: Any
    large: Any


# Compiling takes longer than running, and so do eager operations of JAX: everything
# here is NumPy until it enters a compiled function.
QUICK = {"xla_backend_optimization_level": 0}


def array(*values):
    return np.array(values, float)


def value(number):
    return np.array(number, float)


def to_numpy(tree):
    return jax.tree.map(np.array, tree)


def stack(trees):
    return jax.tree.map(lambda *x: np.stack(x), *trees)


# Two targets on a line, seen with noise 1 among clutter in [-50, 50].
PATHS = np.stack([-20 + 3.0 * np.arange(SCANS), 15 - 2.0 * np.arange(SCANS)], 1)[
    ..., None
]
SMALL = {"max_tracks": 4, "max_parents": 3, "prune_threshold": 1e-4}
LARGE = {"max_tracks": 48, "max_parents": 3, "prune_threshold": 1e-4}


def line_births(num_modes):
    modes = np.array([[0.7, 0.3], [0.4, 0.6]])[:, :num_modes]
    return birth.MultiBernoulliBirth(
        existence_prob=array(0.2, 0.1),
        mean=np.array([[-20.0, 2.0], [15.0, -1.0]]),
        cov=np.array([[[9.0, 1.0], [1.0, 4.0]], [[16.0, -1.0], [-1.0, 5.0]]]),
        mode_prob=np.array(modes / modes.sum(1, keepdims=True)),
    )


def line_clutter():
    return clutter.UniformClutter(value(1.5), array(-50.0), array(50.0))


def single_params():
    return single.Params(
        motion=motion.ConstantVelocity(array(0.5)),
        sensor=sensor.Position(array(1.2)),
        survive=probability.Lifetime(value(40.0)),
        detect=probability.Constant(value(0.9)),
    )


def two_mode_params():
    return imm.Params(
        motions=(
            motion.ConstantVelocity(array(0.2)),
            motion.OrnsteinUhlenbeck(array(20.0), array(6.0)),
        ),
        switching=switching.MarkovSwitching(np.array([[0.85, 0.15], [0.3, 0.7]])),
        sensor=sensor.Position(array(1.2)),
        survive=probability.PerMode(array(0.98, 0.9)),
        detect=probability.PerMode(array(0.92, 0.75)),
    )


def line_case(target, params, num_modes):
    return Case(
        make=functools.partial(cbmember.cbmember, target),
        params=cbmember.Params(params, line_births(num_modes), line_clutter()),
        low=np.array([-50.0]),
        high=np.array([50.0]),
        paths=PATHS,
        capacities=SMALL,
        large=LARGE,
    )


def ekf_case():
    params = single.Params(
        motion=motion.ConstantVelocity(array(0.5, 0.8)),
        sensor=sensor.RangeBearing(array(2.0, 0.01), array(5.0, -4.0), value(0.3)),
        survive=probability.Constant(value(0.97)),
        detect=probability.InsideDisc(
            value(0.95), array(0.0, 0.0), value(300.0), value(30.0)
        ),
    )
    places = np.array([[100.0, 3.0, 80.0, -2.0], [-60.0, 1.0, 120.0, 2.0]])
    births = birth.MultiBernoulliBirth(
        existence_prob=array(0.2, 0.1),
        mean=np.array(places),
        cov=np.tile(np.diag(array(25.0, 4.0, 36.0, 9.0)), (2, 1, 1)),
        mode_prob=np.ones((2, 1)),
    )
    falls = clutter.PolarClutter(
        value(1.5),
        array(-200.0, -200.0),
        array(200.0, 200.0),
        array(5.0, -4.0),
        value(0.3),
    )
    times = np.arange(SCANS)[:, None, None]
    offset = (
        places[None, :, ::2] + times * places[None, :, 1::2] - np.array([5.0, -4.0])
    )
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - 0.3
    return Case(
        make=functools.partial(cbmember.cbmember, single.single()),
        params=cbmember.Params(params, births, falls),
        low=np.array([20.0, -3.0]),
        high=np.array([180.0, 3.0]),
        paths=np.stack([np.linalg.norm(offset, axis=-1), bearing], -1),
        capacities=SMALL,
        large=LARGE,
    )


def detection_birth_case():
    births = birth.DetectionBirth(
        rate=value(0.4),
        max_existence_prob=value(0.3),
        velocity_std=array(3.0),
        extra_std=np.zeros(0),
        mode_prob=np.ones(1),
    )
    return line_case(single.single(), single_params(), 1)._replace(
        params=cbmember.Params(single_params(), births, line_clutter()),
        capacities={**SMALL, "max_births": PADDED},
        large={**LARGE, "max_births": PADDED},
    )


def merging_case():
    maker = functools.partial(cbmember.cbmember, merge_threshold=4.0)
    plain = line_case(single.single(), single_params(), 1)
    return plain._replace(make=functools.partial(maker, single.single()))


def unscented_case():
    """The UK form of the mixture: unknown turn rate, range and bearing."""
    plain = ekf_case()
    places = np.array([[100.0, 3.0, 80.0, -2.0, 0.1], [-60.0, 1.0, 120.0, 2.0, -0.1]])
    births = plain.params.birth._replace(
        mean=places, cov=np.tile(np.diag(array(25.0, 4.0, 36.0, 9.0, 0.02)), (2, 1, 1))
    )
    target = imm.Params(
        motions=(
            turn.ForgottenTurn(
                turn.CoordinatedTurn(value(0.05), value(0.4)), value(0.15)
            ),
            turn.TurnRate(value(0.6), value(1e-3)),
        ),
        switching=switching.SojournSwitching(
            array(9.0, 6.0), np.array([[0.0, 1.0], [1.0, 0.0]])
        ),
        sensor=plain.params.target.sensor,
        survive=plain.params.target.survive,
        detect=plain.params.target.detect,
    )
    births = births._replace(mode_prob=np.array([[0.7, 0.3], [0.4, 0.6]]))
    maker = mixture.mixture(max_components=1, method=linearize.unscented)
    return plain._replace(
        make=functools.partial(cbmember.cbmember, maker),
        params=cbmember.Params(target, births, plain.params.clutter),
    )


def far_field_case():
    """A field of view far from the origin, where the beliefs of empty slots are."""
    offset = array(9e3, 0.0, 0.0, 0.0)
    births = birth.MultiBernoulliBirth(
        existence_prob=array(0.2, 0.1),
        mean=np.array([[-20.0, 2.0, 4.0, 1.0], [15.0, -1.0, -6.0, 0.5]]) + offset,
        cov=np.tile(np.diag(array(9.0, 4.0, 16.0, 5.0)), (2, 1, 1)),
        mode_prob=np.array([[0.7, 0.3], [0.4, 0.6]]),
    )
    low, high = array(9e3 - 60, -60.0), array(9e3 + 60, 60.0)
    target = two_mode_params()._replace(
        motions=tuple(motion.ConstantVelocity(array(q, q)) for q in (0.2, 4.0)),
        sensor=sensor.Position(array(1.2, 0.8)),
        detect=probability.InsideDisc(
            value(0.95), array(9e3, 0.0), value(500.0), value(10.0)
        ),
    )
    paths = np.stack([PATHS[..., 0] + 9e3, 0.3 * PATHS[..., 0]], -1)
    return Case(
        make=functools.partial(cbmember.cbmember, imm.imm()),
        params=cbmember.Params(
            target, births, clutter.UniformClutter(value(1.5), low, high)
        ),
        low=low,
        high=high,
        paths=paths,
        capacities=SMALL,
        large=LARGE,
    )


CASES = {
    "cbmember_single": lambda: line_case(single.single(), single_params(), 1),
    "cbmember_imm": lambda: line_case(imm.imm(), two_mode_params(), 2),
    "cbmember_mixture": lambda: line_case(
        mixture.mixture(max_components=2), two_mode_params(), 2
    ),
    "cbmember_ekf": ekf_case,
    "cbmember_detection_birth": detection_birth_case,
    "cbmember_merging": merging_case,
    "cbmember_unscented": unscented_case,
    "cbmember_far_field": far_field_case,
}
# The UK form compiles for a minute; it is tested with the slow ones.
NAMES = [
    pytest.param(name, marks=[pytest.mark.slow] if "unscented" in name else [])
    for name in CASES
]
every_tracker = pytest.mark.parametrize("name", NAMES)


@functools.cache
def case_of(name):
    return CASES[name]()


def tracker_of(name, large=False):
    case = case_of(name)
    return case.make(**(case.large if large else case.capacities))


def random_scans(name, seed, full=False):
    """The two targets, mostly detected, and clutter; irregular intervals."""
    case = case_of(name)
    rng = np.random.default_rng(seed)
    num_outputs = case.low.size
    points = rng.uniform(case.low, case.high, (SCANS, SLOTS, num_outputs))
    noise = np.array(case.params.target.sensor.noise_std)
    points[:, 1:3] = case.paths + rng.normal(size=case.paths.shape) * noise
    valid = rng.random((SCANS, SLOTS)) < np.array([0.4, 0.95, 0.95, 0.4, 0.4])
    return Scan(
        detections=np.array(points),
        valid=np.array(valid | full),
        interval=np.array(rng.uniform(0.7, 1.3, SCANS)),
    )


def padded(scans, filler=0.0):
    extra = PADDED - SLOTS
    return scans._replace(
        detections=np.pad(
            scans.detections, ((0, 0), (0, extra), (0, 0)), constant_values=filler
        ),
        valid=np.pad(scans.valid, ((0, 0), (0, extra))),
    )


def evidence_and_estimates(tracker, params, scans):
    estimates = engine.run(tracker, params, scans, jax.random.wrap_key_data(KEY))
    return estimates.log_evidence.sum(), estimates


@functools.cache
def runner(name):
    """(params, scans) -> ((evidence, estimates), slope in params), without a batch."""
    function = functools.partial(evidence_and_estimates, tracker_of(name))
    return jax.jit(jax.value_and_grad(function, has_aux=True), compiler_options=QUICK)


@functools.cache
def alone(name):
    return to_numpy(runner(name)(case_of(name).params, random_scans(name, 0)))


STEP = 1e-6


def directions(params):
    """For each float leaf, a random step in proportion to its values."""
    leaves, tree = jax.tree.flatten(params)
    rng = np.random.default_rng(2)
    for i, leaf in enumerate(leaves):
        size = np.abs(np.array(leaf))
        scale = np.maximum(size, 0.1 * size.max(initial=0.1))
        # Probabilities stay below one, corners of the clutter box away from the data.
        step = np.array(-np.abs(rng.normal(size=leaf.shape)) * scale)
        yield jax.tree.unflatten(
            tree, [step if j == i else np.zeros_like(x) for j, x in enumerate(leaves)]
        )


def variants(name):
    scans = random_scans(name, 0)
    wide = padded(scans)
    kept = wide.valid[..., None]
    far = case_of(name).paths.mean((0, 1))
    return {
        "base": wide,
        "backwards": jax.tree.map(lambda x: x[:, ::-1] if x.ndim > 1 else x, wide),
        "noisy padding": wide._replace(detections=np.where(kept, wide.detections, far)),
        "other run": padded(random_scans(name, 1)),
        "empty": wide._replace(valid=np.zeros_like(wide.valid)),
        "full": padded(random_scans(name, 2, full=True))._replace(
            valid=np.ones_like(wide.valid)
        ),
    }


@functools.cache
def batched(name):
    """{variant: estimates} of one compiled batch, and the finite differences."""
    params, named = case_of(name).params, variants(name)
    steps = list(directions(params))
    walks = [
        jax.tree.map(lambda x, d, s=s: x + s * STEP * d, params, step)
        for step in steps
        for s in (1, -1)
    ]
    function = functools.partial(evidence_and_estimates, tracker_of(name))
    run = jax.jit(jax.vmap(function), compiler_options=QUICK)
    all_params = stack([*[params] * len(named), *walks])
    all_scans = stack([*named.values(), *[named["base"]] * len(walks)])
    _, estimates = to_numpy(run(all_params, all_scans))
    pick = {
        key: jax.tree.map(lambda x, i=i: x[i], estimates) for i, key in enumerate(named)
    }
    evidence = estimates.log_evidence[len(named) :].sum(1).reshape(-1, 2)
    return pick, steps, (evidence[:, 0] - evidence[:, 1]) / (2 * STEP)


def filled(estimates):
    """The estimates with nothing behind empty slots, which may hold anything."""
    there = estimates.existence_prob > 0
    return estimates._replace(
        mean=np.where(there[..., None], estimates.mean, 0),
        cov=np.where(there[..., None, None], estimates.cov, 0),
        label=np.where(there, estimates.label, -1),
        mode_prob=np.where(there[..., None], estimates.mode_prob, 0),
    )


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
    base = batched(name)[0]["base"]
    assert_same(base, alone(name)[0][1])
    assert_same(batched(name)[0]["noisy padding"], base)


@every_tracker
def test_order_of_detections_changes_nothing(name):
    base, backwards = (batched(name)[0][key] for key in ("base", "backwards"))
    if name == "cbmember_detection_birth":
        # Newborn tracks are equally likely, so that the order decides which one finds
        # no room; the number expected and the next evidence come before that.
        np.testing.assert_allclose(backwards.log_evidence[:2], base.log_evidence[:2])
    else:
        assert_same(backwards, base)


@every_tracker
def test_runs_are_independent(name):
    (_, expected), _ = runner(name)(case_of(name).params, random_scans(name, 1))
    assert_same(batched(name)[0]["other run"], to_numpy(expected))


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
    for estimates in batched(name)[0].values():
        assert (estimates.existence_prob >= 0).all()
        assert (estimates.existence_prob <= 1 + 1e-12).all()
        np.testing.assert_allclose(filled(estimates).mode_prob.sum(-1).round(12) % 1, 0)
        assert (estimates.dropped >= -1e-12).all()


@every_tracker
def test_labels_of_reported_tracks_are_unique(name):
    for estimates in batched(name)[0].values():
        for exists, label in zip(estimates.exists, estimates.label, strict=True):
            reported = label[exists]
            assert len(set(reported)) == len(reported)
            assert (reported >= 0).all()


@every_tracker
def test_gradients_are_right(name):
    """In every float leaf of Params, along a random direction."""
    slope = alone(name)[1]
    _, steps, expected = batched(name)
    leaves = len(jax.tree.leaves(slope))
    assert len(steps) == leaves
    for step, difference in zip(steps, expected, strict=True):
        along = sum(
            (np.array(g) * np.array(d)).sum()
            for g, d in zip(jax.tree.leaves(slope), jax.tree.leaves(step), strict=True)
        )
        np.testing.assert_allclose(along, difference, rtol=1e-4, atol=1e-6)


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
    chex.assert_tree_all_finite(batched(name)[0][variant])
    scans = variants(name)[variant]
    short = jax.tree.map(lambda x: x[:, :SLOTS] if x.ndim > 1 else x, scans)
    (evidence, _), slope = runner(name)(case_of(name).params, short)
    chex.assert_tree_all_finite((evidence, slope))


@every_tracker
def test_empty_scans_say_that_there_is_little(name):
    estimates = batched(name)[0]["empty"]
    assert not estimates.exists.any()
    assert (estimates.log_evidence < 0).all()


@functools.cache
def roomy(name):
    function = functools.partial(evidence_and_estimates, tracker_of(name, large=True))
    run = jax.jit(function, compiler_options=QUICK)
    return to_numpy(run(case_of(name).params, random_scans(name, 0)))[1]


# A roomy tracker that merges takes into its tracks what a tight one has dropped.
@pytest.mark.parametrize(
    "name", [name for name in NAMES if name.values != ("cbmember_merging",)]
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


@every_tracker
def test_float32_is_near_float64(name):
    params, scans = case_of(name).params, random_scans(name, 0)

    def narrow(x):
        return np.array(x, np.float32) if x.dtype == np.float64 else np.array(x)

    with jax.enable_x64(False):
        function = functools.partial(evidence_and_estimates, tracker_of(name))
        args = jax.tree.map(narrow, (params, scans))
        _, rough = to_numpy(jax.jit(function, compiler_options=QUICK)(*args))
    fine = alone(name)[0][1]
    assert rough.mean.dtype == np.float32
    np.testing.assert_allclose(rough.log_evidence, fine.log_evidence, atol=3e-3)
    np.testing.assert_allclose(rough.existence_prob, fine.existence_prob, atol=3e-3)
    np.testing.assert_array_equal(rough.exists, fine.exists)
    np.testing.assert_array_equal(rough.label[fine.exists], fine.label[fine.exists])
    std = np.sqrt(np.diagonal(fine.cov[fine.exists], axis1=1, axis2=2))
    gap = (rough.mean[fine.exists] - fine.mean[fine.exists]) / std
    np.testing.assert_allclose(gap, 0, atol=0.02)
