"""Recordings of unequal length, against what is known of them one by one."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from cases import learning
from cases.learning import follower, moving, start, watched, watcher

from jaxtrack import learn
from jaxtrack.learn import loss, slopes, together
from jaxtrack.models import motion, sensor
from jaxtrack.types import Scan, Scans

pytestmark = pytest.mark.usefixtures("whole_matrices")

LENGTHS = 40, 7, 1
NEWTON = optax.lbfgs()


class Truth(NamedTuple):
    state: np.ndarray
    exists: np.ndarray


def both(p):
    return p.std, p.mean


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
    together_ = learn.fit(watcher, start(), given, truth=truth, **few)
    alone = [
        learn.fit(watcher, start(), one, truth=told, **few).history.loss[0]
        for one, told in zip(given, truth, strict=True)
    ]
    expected = np.average(alone, weights=LENGTHS)
    np.testing.assert_allclose(together_.history.loss[0], expected, rtol=1e-12)


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
    with pytest.raises(ValueError, match="of unequal length, and the loss takes no co"):
        learn.fit(watcher, start(), cut(watched()), loss=plain)
    learn.fit(watcher, start(), cut(watched()), loss=plain, window=1, num_steps=1)


def test_windows_lie_where_there_are_scans():
    times = [Scan(*[np.arange(float(t))[:, None]] * 2, np.ones(t)) for t in (8, 3)]
    scans, _, length = together.together(times, None)
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
        together.together(given, None)[0], None, 0, length=np.array([40, 4])
    )
    key = jax.random.fold_in(jax.random.key(0), 0)
    drawn = slopes.pick(key, data, None, 4).scans.detections[..., 0, 0]
    each = (np.log(2 * np.pi) / 2 + (drawn - 0.5) ** 2 / 2).mean(1)
    expected = np.average(each, weights=(40, 4))
    np.testing.assert_allclose(fit.history.loss[0], expected, rtol=1e-12)
    known = fit.information.hessian[0, 0]
    np.testing.assert_allclose(known, 44 * 0.25 / fit.params.std**2, rtol=1e-6)


def test_batches_take_lengths_along():
    fit = learn.fit(watcher, start(), cut(watched()), batch=2, num_steps=8, seed=1)
    pairs = [(0, 1), (0, 2), (1, 2)]
    told = []
    names = "mean", "std", "factor"
    for place in np.stack([fit.history.values[name] for name in names], 1):
        mean, std, factor = place
        each = cut(watched())
        told.append(
            [
                np.mean(
                    np.log(2 * np.pi) / 2
                    + np.log(std * factor)
                    + (numbers([each[i] for i in pair]) - mean) ** 2
                    / 2
                    / (std * factor) ** 2
                )
                for pair in pairs
            ]
        )
    gap = np.abs(np.array(told) - fit.history.loss[:, None])
    assert (gap.min(1) < 1e-12).all()
    assert len(set(gap.argmin(1))) > 1


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
    scans, _, length = together.together(given, None)
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
        (cut(watched()), np.ones(40), "a list of 3 recordings, and the truth is none"),
        (
            [watched(), Scans((), np.ones(3))],
            None,
            "recording 0 of the list has an axis of recordings",
        ),
        (
            [
                *cut(watched(), (3,)),
                Scan(np.ones((3, 1, 2)), np.ones((3, 1)), np.ones(3)),
            ],
            None,
            r"scans of recording 1 hold arrays of shapes \[\(1, 2\), \(1,\), \(\)\] a",
        ),
        ([None], None, "scans are of type NoneType; give a Scan or Scans"),
        (
            cut(watched(), (3, 2)),
            [np.ones(3), np.ones((2, 2))],
            r"truth of recording 1 hold arrays of shapes \[\(2,\)\] a scan, and of rec",
        ),
    ],
)
def test_lists_that_make_no_sense_are_told(scans, truth, told):
    with pytest.raises(ValueError, match=told):
        together.together(scans, truth)


def test_a_window_is_no_longer_than_the_shortest():
    with pytest.raises(ValueError, match="window is 2; give a number from 1 to 1"):
        learn.fit(watcher, start(), cut(watched()), window=2)
