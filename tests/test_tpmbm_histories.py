"""Tests of `tpmbm` and `tmbm` against all hypotheses, with all their trajectories."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes
from reference import histories
from test_tpmbm import ALL, FEW, POISSON, ROOM, run

from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.models.probability import PerMode
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.targets import imm
from jaxtrack.trackers import mbm, pmbm, tmbm, tpmbm

pytestmark = pytest.mark.usefixtures("whole_matrices")

KINDS = "poisson", "multi-Bernoulli", "certain"
THRESHOLD, MOST = 0.5, 20
SIZES, NUM = (2, 1, 2), 30  # FEW where hypotheses say more
TIMES = 3  # of birth that are told apart
BIRTH = 0.3  # probability, where births are multi-Bernoulli
PROB = 1e-10  # what float64 leaves of probabilities, sums over all hypotheses
STATE = 1e-10  # m, m/s and their squares
BORN = {"max_tracks": 3, "max_leaves": 20}
CERTAIN = {"max_tracks": 3, "max_leaves": 12}
SMALL = {"max_tracks": 3, "max_leaves": 4, "max_undetected": 3, "max_hypotheses": 8}


def poisson(**more):
    settings = {"max_hypotheses": 128, **ALL, **POISSON}
    return tpmbm.tpmbm(scenes.target, **settings, **more)


def born(**more):
    settings = {"max_hypotheses": 150, **ALL, **BORN}
    return tmbm.tmbm(scenes.target, **settings, **more)


def certain(**more):
    settings = {"max_hypotheses": 200, "certain": True, **ALL, **CERTAIN}
    return tmbm.tmbm(scenes.target, **settings, **more)


# Each tracker, that of single scans, and the first with alive trajectories only.
TRACKERS = {
    "poisson": (
        poisson(num_birth_times=TIMES),
        pmbm.pmbm(
            scenes.target, max_hypotheses=32, exist_threshold=0.0, **ROOM, **POISSON
        ),
        poisson(trajectories="alive"),
    ),
    "multi-Bernoulli": (
        born(),
        mbm.mbm(scenes.target, max_hypotheses=150, exist_threshold=0.0, **ROOM, **BORN),
        born(trajectories="alive"),
    ),
    "certain": (
        certain(),
        mbm.mbm01(scenes.target, max_hypotheses=200, **ROOM, **CERTAIN),
        certain(trajectories="alive"),
    ),
    "poisson, two modes": (
        tpmbm.tpmbm(imm.imm(), **ALL, **SMALL),
        pmbm.pmbm(imm.imm(), exist_threshold=0.0, **ROOM, **SMALL),
    ),
}
every_kind = pytest.mark.parametrize("kind", KINDS)
EVERY = [(kind, alive_only) for kind in KINDS for alive_only in (False, True)]


def params_of(drawn, kind):
    params = scenes.params_of(drawn)
    if kind == "poisson":
        return params
    if kind == "poisson, two modes":
        return two_modes(params)
    births = MultiBernoulliBirth(jnp.array([BIRTH]), *params.birth[1:])
    return params._replace(birth=births, undetected=None)


def two_modes(params):
    """Targets are fast or slow, and the slow ones are seen and survive less often."""
    own, share = params.target, jnp.array([[0.7, 0.3]])
    slow = own.motion._replace(time_constant=2.5 * own.motion.time_constant)
    survive, detect = own.survive.value, own.detect.value
    factor = jnp.array([1.0, 0.8])
    bank = imm.Params(
        (own.motion, slow),
        MarkovSwitching(jnp.array([[0.8, 0.2], [0.35, 0.65]])),
        own.sensor,
        PerMode(survive * factor),
        PerMode(detect * factor),
    )
    births, hidden = (x._replace(mode_prob=share) for x in (params.birth, params[3]))
    return params._replace(target=bank, birth=births, undetected=hidden)


@functools.cache
def drawn(sizes):
    problems = scenes.stacked([scenes.draw(seed) for seed in range(NUM)])
    return problems, scenes.stacked([scenes.detections(k, sizes) for k in range(NUM)])


def sizes_of(kind):
    return FEW if kind in ("certain", "poisson, two modes") else SIZES


@functools.cache
def found(kind):
    """What these trackers report, of all problems."""

    def every(drawn, places):
        params = params_of(drawn, kind)
        scans = scenes.stacked(scenes.padded(places))
        return [run(tracker, params, scans) for tracker in TRACKERS[kind]]

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(every))(*drawn(sizes_of(kind))))


@pytest.mark.parametrize("kind", TRACKERS)
def test_with_room_for_all_it_is_the_filter_of_single_scans(kind):
    """Which is compared with all hypotheses, or sets, in tests of its own."""
    several, single = found(kind)[:2]
    for field in ("log_evidence", "num_mean", "num_var"):
        given = getattr(several, field), getattr(single, field)
        np.testing.assert_allclose(*given, rtol=1e-10)
    # Roundings of sums of order one.
    assert (abs(several.dropped) < 1e-12).all()
    if kind != "certain":  # it says when targets ended, which mbm01 forgets
        most = min(several.hypothesis_prob.shape[2], single.hypothesis_prob.shape[2], 8)
        given = (x.hypothesis_prob[..., :most] for x in (several, single))
        np.testing.assert_allclose(*given, rtol=0, atol=PROB)
    for label in range(sum(SIZES)):
        there = (
            np.where(x.label == label, x.existence_prob, 0.0).sum(2)
            for x in (several, single)
        )
        np.testing.assert_allclose(*there, rtol=0, atol=PROB)


@functools.cache
def known(kind, alive_only=False):
    """What there is to know after each scan, of all problems."""
    answers = []
    for seed in range(NUM):
        drawn = scenes.draw(seed)
        model = scenes.model_of(drawn, prob=BIRTH)
        scans = scenes.detections(seed, sizes_of(kind))
        for t in range(len(scans)):
            past = scans[: t + 1]
            one = histories.posterior(past, model, kind, MOST, alive_only)
            answers.append((seed, t, past, model, one))
    return answers


def labelled(label, values, num):
    """Values of the tracks of labels 0, 1, ..., and 0 where there is no such track."""
    rows = np.zeros((num, *values.shape[1:]), values.dtype)
    for here, value in zip(label, values, strict=True):
        if 0 <= here < num:
            rows[here] = value
    return rows


@pytest.mark.parametrize(("kind", "alive_only"), EVERY)
def test_hypotheses_weigh_what_all_of_them_do(kind, alive_only):
    told = found(kind)[2 * alive_only]
    evidence = told.log_evidence.cumsum(1)
    for seed, t, _, _, expected in known(kind, alive_only):
        np.testing.assert_allclose(evidence[seed, t], expected.log_evidence, rtol=1e-10)
        prob = told.hypothesis_prob[seed, t]
        most = min(len(prob), len(expected.prob))
        np.testing.assert_allclose(prob[:most], expected.prob[:most], rtol=0, atol=PROB)
        assert (prob[most:] < 1e-10).all()


@pytest.mark.parametrize(("kind", "alive_only"), EVERY)
def test_targets_are_as_likely_as_all_hypotheses_say(kind, alive_only):
    told = found(kind)[2 * alive_only]
    for seed, t, _, _, expected in known(kind, alive_only):
        number = np.arange(MOST)
        mean = expected.num_prob @ number
        var = expected.num_prob @ number**2 - mean**2
        np.testing.assert_allclose(told.num_mean[seed, t], mean, rtol=1e-10)
        np.testing.assert_allclose(told.num_var[seed, t], var, rtol=1e-10)
        there = labelled(
            told.label[seed, t], told.existence_prob[seed, t], len(expected.best)
        )
        np.testing.assert_allclose(there, expected.existence_prob, rtol=0, atol=PROB)


@every_kind
def test_paths_are_those_of_the_best_hypothesis(kind):
    """Where each target was, how likely in each scan, and when it most likely ended."""
    paths, shown = found(kind)[0].paths, 0
    for seed, t, scans, model, expected in known(kind):
        window = slice(-t - 1, None)
        label, num = paths.label[seed, t], len(expected.best)
        one = [getattr(paths, name)[seed, t][:, window] for name in paths._fields[:5]]
        mean, cov, _, prob, alive = (labelled(label, x, num) for x in one)
        for track, history in enumerate(expected.best):
            if history is None:
                assert not alive[track].any()
                continue
            # Of probabilities.
            np.testing.assert_allclose(
                prob[track], history.alive_prob, rtol=0, atol=PROB
            )
            reported = history.alive_prob.max() > THRESHOLD
            last = np.argmax(history.ends) if reported else -1
            scan = np.arange(t + 1)
            there = (scan >= history.since) & (scan <= last)
            np.testing.assert_array_equal(alive[track], there)
            means, covs = histories.path(history, scans, model)
            # Of some metres, by some inverses of matrices.
            np.testing.assert_allclose(
                mean[track][there], means[there], rtol=0, atol=STATE
            )
            np.testing.assert_allclose(
                cov[track][there], covs[there], rtol=0, atol=STATE
            )
            shown += there.any()
    assert shown > NUM


@every_kind
def test_alive_paths_are_those_of_targets_that_are_there_now(kind):
    """From the beginning until now, in the best hypothesis, or not at all."""
    paths, shown, hidden = found(kind)[2].paths, 0, 0
    for seed, t, scans, model, expected in known(kind, True):
        window = slice(-t - 1, None)
        label, num = paths.label[seed, t], len(expected.best)
        one = [getattr(paths, name)[seed, t][:, window] for name in paths._fields[:5]]
        mean, cov, _, prob, alive = (labelled(label, x, num) for x in one)
        for track, history in enumerate(expected.best):
            now = 0.0 if history is None else history.alive_prob[-1]
            if now <= THRESHOLD:
                assert not alive[track].any()
                hidden += history is not None and history.alive_prob.max() > THRESHOLD
                continue
            there = np.arange(t + 1) >= history.since
            np.testing.assert_array_equal(alive[track], there)
            # Of probabilities.
            np.testing.assert_allclose(prob[track], now * there, rtol=0, atol=PROB)
            means, covs = histories.smoothed(
                history.track, history.since, t, scans, model
            )
            # Of some metres, by some inverses of matrices.
            np.testing.assert_allclose(mean[track][there], means, rtol=0, atol=STATE)
            np.testing.assert_allclose(cov[track][there], covs, rtol=0, atol=STATE)
            shown += 1
    assert shown > NUM
    assert hidden > 0 or kind == "certain"


def test_births_before_the_first_detection_are_as_likely_as_all_lives_say():
    paths = found("poisson")[0].paths
    for seed, t, _, _, expected in known("poisson"):
        label, num = paths.label[seed, t], len(expected.best)
        told = labelled(label, paths.birth_prob[seed, t], num)
        for track, history in enumerate(expected.best):
            if history is None:
                continue
            births = np.zeros(TIMES)
            for scan, weight in enumerate(history.begun, start=-1):
                if weight > 0:
                    births[min(history.since - scan, TIMES - 1)] += weight
            # Of probabilities.
            np.testing.assert_allclose(
                told[track], births / births.sum(), rtol=0, atol=PROB
            )
