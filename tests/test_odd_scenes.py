"""The association family where something is missing, impossible or too much."""

import functools
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

from jaxtrack import engine, models, targets
from jaxtrack.trackers import (
    gnn,
    hypotheses,
    hypothesis_mht,
    jpda,
    jpda_star,
    management,
    mcmcda,
    mht,
    nearest,
    pda,
    pmht,
    pmht_batch,
    set_jpda,
    single_scan,
    undetected,
)
from jaxtrack.types import Scan

KEY = jax.random.key(0)
FAMILY = {
    "nearest": nearest.nearest,
    "gnn": gnn.gnn,
    "pda": pda.pda,
    "jipda": jpda.jipda,
    "set_jpda": functools.partial(set_jpda.set_jpda, max_events=6),
}

LINE = targets.single.single()
LATER = {
    "hypothesis_mht": functools.partial(hypothesis_mht.hypothesis_mht, LINE),
    "mht": functools.partial(mht.mht, LINE, delay=2),
    "mcmcda": functools.partial(mcmcda.mcmcda, LINE, num_scans=2),
    "pmht": functools.partial(pmht.pmht, 3),
}


def array(*values):
    return np.array(values, float)


def start(exists, spread=5.0):
    num = len(exists)
    mean = np.stack([spread * np.arange(num), np.zeros(num)], 1)
    cov = np.tile(np.eye(2), (num, 1, 1))
    return models.birth.MultiBernoulliBirth(
        np.array(exists, float), mean, cov, np.ones((num, 1))
    )


def line_params(birth=None, detect=0.9, survive=1.0, rate=2.0, known=None):
    return single_scan.Params(
        target=targets.single.Params(
            motion=models.motion.ConstantVelocity(array(0.5)),
            sensor=models.sensor.Position(array(1.0)),
            survive=models.probability.Constant(np.array(survive)),
            detect=models.probability.Constant(np.array(detect)),
        ),
        birth=birth,
        clutter=models.clutter.UniformClutter(np.array(rate), array(-30), array(30)),
        start=known,
    )


def births(kind):
    common = {"rate": np.array(0.5), "max_existence_prob": np.array(0.3)}
    rest = {"extra_std": np.zeros(0), "mode_prob": np.ones(1)}
    if kind == "one":
        return models.birth.DetectionBirth(**common, velocity_std=array(2.0), **rest)
    return models.pairs.PairBirth(**common, max_speed=np.array(5.0), **rest)


def scans_of(rows, slots, valid=None):
    points = np.zeros((len(rows), slots, 1))
    there = np.zeros((len(rows), slots), bool)
    for t, row in enumerate(rows):
        points[t, : len(row), 0] = row
        there[t, : len(row)] = True
    return Scan(points, there if valid is None else valid, np.ones(len(rows)))


@functools.cache
def runner(tracker):
    return jax.jit(functools.partial(engine.run, tracker))


def ran(tracker, params, scans):
    return jax.tree.map(np.array, runner(tracker)(params, scans, KEY))


def narrow(tree):
    return jax.tree.map(
        lambda x: np.array(x, np.float32) if x.dtype == float else x, tree
    )


def with_filler(scans):
    """The same with NaN where there is nothing."""
    filler = np.where(scans.valid[..., None], scans.detections, np.nan)
    return scans._replace(detections=filler.astype(scans.detections.dtype))


@pytest.mark.parametrize("name", FAMILY)
def test_float32_is_kept_and_what_stands_in_padding_changes_nothing(name):
    """Parameters in float32, where float64 is the default; two points make births."""
    params = narrow(line_params(births("two"), known=start([0.9, 0.8])))
    scans = narrow(scans_of([[0.1, 5.2], [0.0]], 3))
    tracker = FAMILY[name](targets.single.single(), max_tracks=4)
    one, other = (ran(tracker, params, x) for x in (scans, with_filler(scans)))
    assert one.mean.dtype == np.float32
    for left, right in zip(one, other, strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("name", LATER)
def test_float32_is_kept_by_those_that_look_back(name):
    """By the types alone: nothing is compiled."""
    line = line_params(births("one"), known=start([0.9, 0.8]))
    if name == "pmht":
        params = pmht_batch.Params(line.target, line.clutter, line.start)
    else:
        params = undetected.Params(*line[:3], start=line.start)
    scans = narrow(scans_of([[0.1, 5.2], [0.0]], 3))
    told = jax.eval_shape(
        functools.partial(engine.run, LATER[name]()), narrow(params), scans, KEY
    )
    floats = [x for x in told if hasattr(x, "dtype") and x.dtype.kind == "f"]
    assert floats
    assert all(x.dtype == np.float32 for x in floats)


def test_padding_changes_nothing_of_hypotheses():
    tracker = hypotheses.hypotheses(targets.single.single(), max_hypotheses=4)
    params = line_params(known=start([0.9, 0.8]))
    scans = scans_of([[0.1, 5.2], [0.0]], 3)
    one, other = (ran(tracker, params, x) for x in (scans, with_filler(scans)))
    for left, right in zip(one, other, strict=True):
        np.testing.assert_array_equal(left, right)


def test_leftovers_keep_the_precision_of_the_parameters():
    params = line_params(births("two"))
    scans = narrow(scans_of([[0.1, 5.2], [0.0, 4.9]], 3))
    ran(gnn.gnn(targets.single.single(), max_tracks=4), params, scans)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("nearest", "two"),
        ("gnn", "one"),
        ("pda", None),
        ("jipda", "two"),
        ("set_jpda", "one"),
        ("hypotheses", None),
    ],
)
def test_scans_without_slots_and_without_births(name, kind):
    if name == "hypotheses":
        tracker = hypotheses.hypotheses(targets.single.single(), max_hypotheses=2)
    else:
        room = {} if kind is None else {"max_births": 0}
        tracker = FAMILY[name](targets.single.single(), max_tracks=3, **room)
    births_or_none = births(kind) if kind else None
    params = line_params(births_or_none, known=start([0.9, 0.8]))
    estimates = ran(tracker, params, scans_of([[], []], 0))
    for leaf in jax.tree.leaves(estimates):
        assert np.isfinite(leaf).all()
    np.testing.assert_allclose(estimates.association_prob[..., -1][:, :2], 1.0)


def test_clutter_is_not_counted_without_gates():
    with pytest.raises(ValueError, match="gate_prob is 1 and counts_clutter is set"):
        pda.pda(targets.single.single(), counts_clutter=True, gate_prob=1.0)


def test_a_missed_bank_that_is_always_seen_keeps_its_modes():
    bank = targets.imm.Params(
        motions=tuple(models.motion.ConstantVelocity(array(q)) for q in (0.1, 5.0)),
        switching=models.switching.MarkovSwitching(np.eye(2)),
        sensor=models.sensor.Position(array(1.0)),
        survive=models.probability.Constant(np.array(1.0)),
        detect=models.probability.Constant(np.array(1.0)),
    )
    known = start([0.99])._replace(mode_prob=np.array([[0.1, 0.9]]))
    params = line_params(known=known)._replace(target=bank)
    estimates = ran(jpda.jpda(targets.imm.imm()), params, scans_of([[]], 1))
    np.testing.assert_allclose(estimates.mode_prob[0, 0], [0.1, 0.9])


def test_score_of_a_track_that_is_weighed_by_existence():
    """log(1 - P_D) a miss, in the integrated form as in the other."""
    never = management.ScoreTest(1e-9, 1e-9, 1e9)
    params, target = line_params(known=start([0.3])), targets.single.single()
    for maker in (jpda.jpda, jpda.jipda):
        tracker = maker(target, rule=never, max_tracks=2)

        @jax.jit
        def scores(params, tracker=tracker):
            state = tracker.init(params, KEY)
            step = functools.partial(tracker.step, params)
            return jax.lax.scan(step, state, scans_of([[]] * 5, 1))[0].record.score

        np.testing.assert_allclose(scores(params)[0], 5 * np.log(0.1), rtol=1e-9)


def test_nobody_is_immortal_in_float32():
    rows = [[0.0]] * 8 + [[]] * 30
    params = narrow(line_params(known=start([0.5]), rate=1e-3))
    tracker = jpda.jipda(targets.single.single(), max_tracks=2)
    estimates = ran(tracker, params, narrow(scans_of(rows, 1)))
    assert estimates.exists[7, 0]
    assert not estimates.exists[-1].any()


def test_a_track_taken_for_certain_goes_by_the_rule_alone():
    stay = management.MofN(1, 1, 32, 32)
    params = narrow(line_params(known=start([0.9]), detect=1.0, survive=0.999))
    tracker = gnn.gnn(targets.single.single(), max_tracks=2, rule=stay)
    estimates = ran(tracker, params, narrow(scans_of([[]] * 30, 1)))
    assert estimates.exists[:, 0].all()


def test_events_that_are_not_all_say_so():
    """Of four tracks and four detections there are 209."""
    rng = np.random.default_rng(0)
    log_score = np.concatenate([rng.normal(size=(4, 4)) + 2, np.zeros((4, 1))], 1)
    true = jax.jit(jpda.associate)(log_score)
    told = []
    for associate in (jpda.by_events, jpda_star.associate):
        few, every = (
            jax.jit(functools.partial(associate, max_events=n))(log_score)
            for n in (20, 230)
        )
        assert not few.exact.any()
        assert every.exact.all()
        assert np.isfinite(few.log_ratio).all()
        told.append(every)
    np.testing.assert_allclose(told[0].log_ratio, true.log_ratio, rtol=1e-9)


def test_first_points_without_room_are_counted():
    params = line_params(births("two"))
    tracker = gnn.gnn(targets.single.single(), max_tracks=8, max_births=2)
    estimates = ran(tracker, params, scans_of([[-15.0, -12.0, -9.0, 10.0], [11.0]], 4))
    np.testing.assert_allclose(estimates.dropped[0], 0.5 * 0.5)  # half of the births


def test_confirmed_tracks_stay_when_room_is_short():
    """Even before a likelier tentative one."""
    rule = management.MofN(2, 2, 3, 3)
    known = start([0.45, 0.45, 0.6])
    params = line_params(known=known, survive=0.9)
    tracker = gnn.gnn(targets.single.single(), max_tracks=3, rule=rule)
    estimates = ran(tracker, params, scans_of([[10.0]], 1))
    assert list(estimates.label[0, :1]) == [2]
    assert estimates.exists[0, 0]
    assert not estimates.exists[0, 1:].any()


def test_too_many_targets_for_exact_sums_are_said():
    params = line_params(known=start([1.0] * 11, spread=0.1))
    enough = hypotheses.hypotheses(targets.single.single(), 12, 12)
    estimates = ran(enough, params, scans_of([[0.2]], 1))
    np.testing.assert_array_equal(estimates.dropped, 0.0)  # no hypothesis is left out
    assert not estimates.exact.any()
    two = line_params(known=start([1.0, 1.0]))
    estimates = ran(enough, narrow(two), narrow(scans_of([[0.2, 4.6]], 2)))
    assert estimates.exact.all()
    np.testing.assert_array_equal(estimates.dropped, 0.0)


class Shifted(NamedTuple):
    """The parameters of a single model, and how far `adapt` moves the mean, [D]."""

    motion: Any
    sensor: Any
    survive: Any
    detect: Any
    shift: Any

    @property
    def layout(self):
        return self.motion


def test_every_track_adapts_once_a_scan():
    """What the verb gives back is what the next scan starts from."""

    def moved(params, belief, existence_prob):
        del existence_prob
        return belief._replace(mean=belief.mean + params.shift)

    target = targets.single.single()._replace(adapt=moved)
    params = line_params(known=start([0.9, 0.8]))
    both = [
        params._replace(target=Shifted(*params.target, array(x, 0))) for x in (0, 100)
    ]
    trackers = jpda.jpda(target, max_tracks=2), hypotheses.hypotheses(target, 2)
    for tracker in trackers:
        one, other = (ran(tracker, x, scans_of([[0.1, 5.1]], 2)) for x in both)
        np.testing.assert_allclose(other.mean, one.mean + array(100, 0), rtol=1e-9)


def test_two_points_are_two_hits():
    """With a third detection they make three in three scans."""
    rule = management.MofN(3, 3, 3, 3)
    rows = [[0.0], [1.0], [2.0], [3.0]]
    found = []
    for kind in ("two", "one"):
        params = line_params(births(kind), rate=0.5)
        tracker = gnn.gnn(targets.single.single(), max_tracks=3, rule=rule)
        estimates = ran(tracker, params, scans_of(rows, 1))
        found.append(int(np.argmax(estimates.exists.any(1))))
    assert found == [2, 2]


def test_the_least_explained_are_left_for_the_next_scan():
    """A detection that a track explains makes room for one that nobody explains."""
    params = line_params(births("two"), known=start([0.9]))
    tracker = pda.pda(
        targets.single.single(), max_tracks=4, max_births=1, start_threshold=0.0
    )
    rows = [[0.2, 12.0], [13.0]]
    estimates = ran(tracker, params, scans_of([*rows, [14.0]], 2))
    assert (np.abs(estimates.mean[-1, :, 0] - 14.0) < 1.0).any()
