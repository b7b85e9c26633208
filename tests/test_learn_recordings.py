"""Recordings of unequal length, against what is known of them one by one."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from cases import learning
from cases.learning import follower, moving, start, watched, watcher
from cases.trackers import case_of, random_scans, tracker_of

from jaxtrack import engine, learn
from jaxtrack.learn import loss, recordings, slopes
from jaxtrack.models import motion, sensor
from jaxtrack.types import Scan, Scans, Tracker

pytestmark = pytest.mark.usefixtures("whole_matrices")

LENGTHS = 40, 7, 1
NEWTON = optax.lbfgs()


class Truth(NamedTuple):
    state: np.ndarray
    exists: np.ndarray


def both(p):
    return p.std, p.mean


def mean_alone(p):
    return p.mean


def cut(scans, lengths=LENGTHS):
    """The first scans of each recording."""
    return [
        jax.tree.map(lambda x, r=r, t=t: x[r, :t], scans) for r, t in enumerate(lengths)
    ]


def numbers(recordings, share=1.0):
    """What was seen in the last scans of all, in one row."""
    last = [np.ravel(each.detections) for each in recordings]
    return np.concatenate([x[-int(np.ceil(share * len(x))) :] for x in last])


@pytest.mark.parametrize(
    ("made", "share"), [(loss.evidence, 1.0), (loss.held_out(0.5), 0.5)]
)
def test_every_scan_counts_the_same(made, share):
    given = cut(watched())
    fit = learn.fit(
        watcher, start(), given, NEWTON, where=both, loss=made, num_steps=40, patience=5
    )
    z = numbers(given, share)
    assert z.size == (48 if share == 1 else 25)
    # The loss is flat at its least: steps that lower it by 1e-16 are seen no more.
    np.testing.assert_allclose(fit.params.mean, z.mean(), rtol=1e-6)
    np.testing.assert_allclose(fit.params.std, z.std(), rtol=1e-6)
    error = fit.information.std_error["mean"]
    np.testing.assert_allclose(error, z.std() / np.sqrt(z.size), rtol=1e-5)


def test_a_prior_counts_once_for_all_scans():
    given, z = cut(watched()), numbers(cut(watched()))

    def prior(p):
        return -((p.mean - 3.0) ** 2) / 2 / 0.01

    where = {"where": lambda p: p.mean, "prior": prior, "num_steps": 40}
    fit = learn.fit(watcher, start(std=0.7), given, NEWTON, **where)
    precision = z.size / 0.49
    expected = (precision * z.mean() + 3.0 / 0.01) / (precision + 1 / 0.01)
    np.testing.assert_allclose(fit.params.mean, expected, rtol=1e-6)
    error = fit.information.std_error["mean"]
    np.testing.assert_allclose(error, (precision + 1 / 0.01) ** -0.5, rtol=1e-5)


def test_a_filter_with_a_memory_tells_the_evidence_of_each():
    given = cut(moving(1))
    first = learning.Line(
        motion.ConstantVelocity(np.array([2.0])), sensor.Position(np.array([1.0]))
    )
    fit = learn.fit(follower, first, given, NEWTON, num_steps=1, errors=False)
    total = sum(
        learning.log_evidence(jax.tree.map(lambda x: x[None], each), 2.0, 1.0)
        for each in given
    )
    np.testing.assert_allclose(fit.history.loss[0], -total / sum(LENGTHS), rtol=1e-12)


@pytest.mark.parametrize("made", [loss.gospa, loss.ospa])
def test_a_metric_is_a_mean_over_the_scans_there_are(made):
    given = cut(watched())
    rng = np.random.default_rng(0)
    truth = [
        Truth(rng.normal(size=(t, 2, 1)), rng.random((t, 2)) < 0.7) for t in LENGTHS
    ]
    few = {"loss": made((0,), 5.0), "num_steps": 1}
    listed = learn.fit(watcher, start(), given, truth=truth, **few)
    alone = [
        learn.fit(watcher, start(), one, truth=told, **few).history.loss[0]
        for one, told in zip(given, truth, strict=True)
    ]
    expected = np.average(alone, weights=LENGTHS)
    np.testing.assert_allclose(listed.history.loss[0], expected, rtol=1e-12)


def test_a_loss_of_ones_own_is_told_which_scans_count():
    def own(estimates, scans, *, counts):
        assert counts.shape == scans.interval.shape
        return jnp.where(counts, estimates.log_evidence**2, 0.0).sum() / counts.sum()

    def plain(estimates, scans):
        return (estimates.log_evidence**2).mean()

    fit = learn.fit(watcher, start(), cut(watched()), loss=own, num_steps=1)
    alone = [
        learn.fit(watcher, start(), each, loss=plain, num_steps=1).history.loss[0]
        for each in cut(watched())
    ]
    expected = np.average(alone, weights=LENGTHS)
    np.testing.assert_allclose(fit.history.loss[0], expected, rtol=1e-12)
    equal = learn.fit(watcher, start(), watched(), loss=own, num_steps=1)
    usual = learn.fit(watcher, start(), watched(), loss=plain, num_steps=1)
    np.testing.assert_allclose(equal.history.loss, usual.history.loss, rtol=1e-12)
    learn.fit(watcher, start(), cut(watched()), loss=own, window=1, num_steps=1)
    with pytest.raises(ValueError, match="of unequal length, and the loss takes no co"):
        learn.fit(watcher, start(), cut(watched()), loss=plain)
    learn.fit(watcher, start(), cut(watched()), loss=plain, window=1, num_steps=1)


def test_windows_lie_where_there_are_scans():
    times = [Scan(*[np.arange(float(t))[:, None]] * 2, np.ones(t)) for t in (8, 3)]
    scans, _, length = recordings.stack(times, None)
    data = slopes.gather(scans, None, 0, length=length)
    draw = jax.jit(jax.vmap(lambda key: slopes.pick(key, data, None, 3).scans))
    found = np.array(draw(jax.random.split(jax.random.key(0), 300)).detections)
    assert found.shape == (300, 2, 3, 1)
    assert (np.diff(found, axis=2) == 1).all()
    assert set(found[:, 0, 0, 0]) == {0, 1, 2, 3, 4, 5}
    assert set(found[:, 1, 0, 0]) == {0}


def test_of_windows_long_recordings_count_more():
    given = cut(watched(), (40, 4))
    fit = learn.fit(watcher, start(), given, where=both, window=4, num_steps=1)
    data = slopes.gather(
        recordings.stack(given, None)[0], None, 0, length=np.array([40, 4])
    )
    key = jax.random.fold_in(jax.random.key(0), 0)
    drawn = slopes.pick(key, data, None, 4).scans.detections[..., 0, 0]
    each = -density_of(drawn, 0.5, 1.0).mean(1)
    expected = np.average(each, weights=(40, 4))
    np.testing.assert_allclose(fit.history.loss[0], expected, rtol=1e-12)
    known = fit.information.hessian[0, 0]
    np.testing.assert_allclose(known, 44 * 0.25 / fit.params.std**2, rtol=1e-6)


def density_of(z, mean, std):
    return -np.log(2 * np.pi) / 2 - np.log(std) - (z - mean) ** 2 / 2 / std**2


def test_the_mean_over_batches_is_the_loss_of_all():
    """Each pair of the three is a batch in some step, and tells its part of it."""
    given, pairs = cut(watched()), [(0, 1), (0, 2), (1, 2)]
    still = optax.sgd(0.0)
    fit = learn.fit(
        watcher, start(), given, still, batch=2, num_steps=24, patience=None
    )
    alone = [-density_of(numbers([each]), 0.5, 1.0).sum() for each in given]
    expected = [(alone[i] + alone[j]) / 2 / (48 / 3) for i, j in pairs]
    found = np.unique(fit.history.loss.round(12))
    np.testing.assert_allclose(found, np.sort(expected), rtol=1e-11)
    whole = learn.fit(watcher, start(), given, still, num_steps=1).history.loss[0]
    np.testing.assert_allclose(np.mean(expected), whole, rtol=1e-12)


def test_slopes_are_finite_where_a_scan_again_would_be_impossible():
    """A tracker that moves on, and whose density is 0 a metre away."""

    def step(params, place, scan):
        off = (scan.detections[0, 0] - place) / params.std / 1e-2
        density = jnp.exp(-(off**2) / 2) / params.std
        told = learning.Told(jnp.log(density), params.mean[None, None], jnp.ones(1))
        return place + 1.0, told

    walker = Tracker(lambda params, key: jnp.zeros(()), step)
    noise = np.random.default_rng(0).normal(size=(2, 40)) * 1e-2
    z = (np.arange(40.0) + noise)[..., None, None]
    given = cut(Scan(z, np.ones((2, 40, 1), bool), np.ones((2, 40))), (40, 5))
    fit = learn.fit(walker, start(), given, NEWTON, where=lambda p: p.std, num_steps=20)
    some = np.concatenate([noise[0], noise[1, :5]])
    np.testing.assert_allclose(fit.params.std, np.sqrt((some**2).mean()) * 100, 1e-5)


def test_states_with_keys_stop_as_well():
    def step(params, key, scan):
        key, draw = jax.random.split(key)
        told = jax.random.normal(draw) + params.mean + 0 * scan.interval
        return key, learning.Told(told, params.mean[None, None], jnp.ones(1))

    drawing = Tracker(lambda params, key: key, step)
    settings = {"where": mean_alone, "num_steps": 1, "errors": False}
    fit = learn.fit(drawing, start(), cut(watched()), **settings)
    keys = engine.run_keys(0, 0, 3)
    told = []
    for key, length in zip(keys, LENGTHS, strict=True):
        for _ in range(length):
            key, draw = jax.random.split(key)
            told.append(float(jax.random.normal(draw)) + 0.5)
    np.testing.assert_allclose(fit.history.loss[0], -np.mean(told), rtol=1e-12)


@pytest.mark.slow
def test_jpda_tells_of_each_what_it_tells_of_it_alone():
    params, tracker = case_of("jpda").params, tracker_of("jpda")
    one, other = (random_scans("jpda", seed) for seed in range(2))
    short = jax.tree.map(lambda x: x[: len(x) // 2], other)
    few = short._replace(detections=short.detections[:, :3], valid=short.valid[:, :3])
    given, only = [one, few], {"where": lambda p: p.clutter.rate, "num_steps": 1}
    fit = learn.fit(tracker, params, given, errors=False, **only)
    run = jax.jit(engine.run, static_argnums=0)
    told = [run(tracker, params, x, jax.random.key(0)).log_evidence for x in given]
    expected = -np.concatenate([np.asarray(x) for x in told]).mean()
    np.testing.assert_allclose(fit.history.loss[0], expected, rtol=1e-10)


def test_a_fit_of_other_lengths_is_refused_where_one_is_kept(tmp_path):
    """Even where every scan is the same, so that the stacks are."""
    settings = {"where": both, "num_steps": 2, "errors": False, "directory": tmp_path}
    same = jax.tree.map(np.ones_like, watched())
    first = learn.fit(watcher, start(), cut(same), **settings)
    again = learn.fit(watcher, start(), cut(same), **settings)
    np.testing.assert_array_equal(first.history.loss, again.history.loss)
    with pytest.raises(ValueError, match="code and values"):
        learn.fit(watcher, start(), cut(same, (40, 6, 1)), **settings)


def test_a_list_of_equal_ones_is_the_same_as_a_stack():
    settings = {"where": both, "num_steps": 3, "errors": False}
    stacked = learn.fit(watcher, start(), watched(), **settings)
    before = slopes.slope._cache_size()
    listed = learn.fit(watcher, start(), cut(watched(), (40, 40, 40)), **settings)
    assert slopes.slope._cache_size() == before
    np.testing.assert_array_equal(stacked.history.loss, listed.history.loss)


def test_sensors_get_slots_of_their_own():
    def scan(total, slots):
        detections = np.ones((total, slots, 2))
        return Scan(detections, np.ones((total, slots), bool), np.ones(total))

    given = [
        Scans((scan(t, k), scan(t, 4 - k)), np.ones((t, 2), bool))
        for t, k in ((2, 1), (5, 3))
    ]
    scans, _, length = recordings.stack(given, None)
    assert length.tolist() == [2, 5]
    one, other = scans.each
    assert one.detections.shape == other.detections.shape == (2, 5, 3, 2)
    assert one.valid.sum(2).tolist() == [[1] * 5, [3] * 5]
    assert other.valid.sum(2).tolist() == [[3] * 5, [1] * 5]


@pytest.mark.parametrize(
    ("scans", "truth", "told"),
    [
        ([], None, "scans is an empty list; give at least one recording"),
        ([watched()], None, "recording 0 of the list has an axis of recordings, too"),
        (
            cut(watched()),
            np.ones(40),
            "a list of 3 recordings, and the truth is a ndarray; give",
        ),
        (
            cut(watched()),
            [None] * 2,
            "a list of 3 recordings, and the truth is 2; give",
        ),
        (
            [Scans((), np.ones(3))],
            None,
            "recording 0 of the list: scans are of type Scans; give a Scan or Scans",
        ),
        (
            [watched()[:2]],
            None,
            "recording 0 of the list: scans are of type tuple; give a Scan or Scans",
        ),
        (
            [Scan(np.ones((3, 1, 2)), np.ones(3), np.ones(3))],
            None,
            r"has detections of shape \(3, 1, 2\) and valid of shape \(3,\); give",
        ),
        (
            cut(watched(), (3,)) + [Scans(tuple(cut(watched(), (3,))), np.ones(3))],
            None,
            "scans of recording 1 are PyTreeDef.*, and of recording 0 PyTreeDef",
        ),
        (
            [
                *cut(watched(), (3,)),
                Scan(np.ones((3, 1, 2)), np.ones((3, 1)), np.ones(3)),
            ],
            None,
            r"scans of recording 1 hold arrays of shapes \[\(1, 2\), \(1,\), \(\)\] a",
        ),
        (
            [None],
            None,
            "recording 0 of the list: scans are of type NoneType; give a Sc",
        ),
        (
            cut(watched(), (3, 2)),
            [np.ones(3), np.ones((2, 2))],
            r"truth of recording 1 hold arrays of shapes \[\(2,\)\] a scan, and of rec",
        ),
    ],
)
def test_lists_that_make_no_sense_are_told(scans, truth, told):
    with pytest.raises(ValueError, match=told):
        recordings.stack(scans, truth)


def test_a_window_is_no_longer_than_the_shortest():
    with pytest.raises(
        ValueError, match="window is 2; give a number from 1 to 1, all sc"
    ):
        learn.fit(watcher, start(), cut(watched()), window=2)
