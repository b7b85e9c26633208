"""Tests of `tpmbm`, `tmbm` and of trajectories.

What they are held to with room for all stands in `test_tpmbm_histories`.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes

from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.trackers import (
    forest,
    growing,
    mht,
    remembering,
    retrodiction,
    tmbm,
    tpmbm,
    trajectories,
    undetected,
)
from jaxtrack.types import Scan

pytestmark = pytest.mark.usefixtures("whole_matrices")

KEY = jax.random.key(0)
FEW = 1, 2
ROOM = {"gate_prob": 1.0, "prune_threshold": 0.0}
ALL = {**ROOM, "exist_threshold": 0.0, "num_scans": 2}
POISSON = {"max_tracks": 5, "max_leaves": 9, "max_undetected": 4}


def run(tracker, params, scans):
    state = tracker.init(params, jax.random.key(0))
    return jax.lax.scan(functools.partial(tracker.step, params), state, scans)[1]


def certain_scene(seen):
    """One target for sure, detected in some of the scans; few others are expected."""
    drawn = {**scenes.draw(0), "clutter": 1e-3, "births": 1e-4, "detect": 0.9}
    params = scenes.params_of(drawn)
    places = np.linspace(0.0, 2.0, len(seen))
    intervals = np.tile([0.7, 1.3, 0.4], len(seen))[: len(seen)]
    return params, Scan(places[:, None, None], np.array(seen)[:, None], intervals)


@functools.cache
def program(kind):
    room = {"max_tracks": 3, "max_leaves": 6, "max_undetected": 2, "num_scans": 1}
    tracker = {
        "mht": lambda: mht.mht(scenes.target, delay=3, **room),
        "all": lambda: tpmbm.tpmbm(scenes.target, lag=2, exist_threshold=0.2, **room),
        "alive": lambda: tpmbm.tpmbm(
            scenes.target, lag=2, exist_threshold=0.2, trajectories="alive", **room
        ),
    }[kind]()
    return jax.jit(functools.partial(run, tracker))


def test_a_trajectory_is_smoothed_grows_and_ends():
    seen = [True, True, False, True, True, True] + 8 * [False]
    params, scans = certain_scene(seen)
    told = program("all")(params, scans)
    later = program("mht")(params, scans).retrodicted
    paths, size = told.paths, told.paths.alive.shape[2]
    for t in range(size - 1, 9):
        at = int(np.argmax(later.label[t] == 0))
        mine = int(np.argmax(paths.label[t] == 0))
        place = paths.mean[t, mine, 0]
        np.testing.assert_allclose(place, later.mean[t, at], rtol=1e-9)
    at = int(np.argmax(paths.label[3] == 0))
    filtered = paths.filtered[:4, at, -1]
    np.testing.assert_allclose(paths.filtered[3, at, 1:], filtered[1:], rtol=1e-12)
    np.testing.assert_allclose(filtered[3], told.mean[3, at], rtol=1e-12)
    assert (abs(paths.filtered - paths.mean)[3, at, 1:-1] > 1e-4).any()
    found = trajectories.assemble(paths, max_trajectories=2)
    assert found.label.tolist() == [0, -1]
    assert found.dropped == 0
    # It ended where it was last seen: survival is less likely than that.
    assert found.alive[:, 0].tolist() == 6 * [True] + 8 * [False]
    before = trajectories.assemble(paths, 2, now=4)
    assert before.alive[:, 0].tolist() == 5 * [True] + 9 * [False]
    newest = int(np.argmax(paths.label[4] == 0))
    np.testing.assert_allclose(before.mean[1:5, 0], paths.mean[4, newest], rtol=1e-12)


def test_alive_trajectories_go_with_their_targets():
    seen = [True, True, False, True, True, True] + 8 * [False]
    params, scans = certain_scene(seen)
    told, every = (program(kind)(params, scans) for kind in ("alive", "all"))
    there = (told.label == 0) & (told.existence_prob > 0.2)
    assert there.any(1)[:6].all()
    gone = int(np.argmin((told.paths.label == 0).any(1)))
    # The other awaits that its last detection is reported, three scans later.
    assert gone < 8 < int(np.argmin((every.paths.label == 0).any(1)))
    for now in (1, 5):
        one, other = (
            trajectories.assemble(x.paths, max_trajectories=2, now=now)
            for x in (told, every)
        )
        assert one.label.tolist() == [0, -1]
        assert one.alive[:, 0].tolist() == (now + 1) * [True] + (13 - now) * [False]
        np.testing.assert_allclose(one.mean, other.mean, rtol=1e-12)
    one = trajectories.assemble(told.paths, max_trajectories=2)
    assert one.label.tolist() == [-1, -1]
    assert not one.alive.any()


def test_ends_are_where_they_are_likeliest():
    begun = jnp.array([False, True, True, True])
    for alive, never, expected in (
        ([0.0, 1.0, 1.0, 0.9], 0.0, [0, 1, 1, 1]),
        ([0.0, 1.0, 0.4, 0.3], 0.0, [0, 1, 0, 0]),
        # Whether it ever was is another question.
        ([0.0, 0.6, 0.3, 0.1], 0.4, [0, 1, 0, 0]),
        # It may have ended before the window.
        ([0.0, 0.6, 0.3, 0.1], 0.05, [0, 0, 0, 0]),
    ):
        found = trajectories.ended(jnp.array(alive), begun, never)
        assert found.tolist() == [bool(x) for x in expected]


def test_an_old_track_goes_on_though_it_may_never_have_been():
    """Of all lives of a target that was seen once, the longest is the likeliest."""
    drawn = {**scenes.draw(0), "clutter": 0.5, "births": 0.6, "detect": 0.2}
    params = scenes.params_of({**drawn, "survive": 0.9})._replace(undetected=None)
    seen = np.array([True] + 4 * [False])
    scans = Scan(np.zeros((5, 1, 1)), seen[:, None], np.full(5, scenes.INTERVAL))
    room = {"max_tracks": 3, "max_leaves": 6, "max_undetected": 2, **ROOM}
    tracker = tpmbm.tpmbm(
        scenes.target, num_scans=1, lag=1, report_threshold=0.2, **room
    )
    told = jax.jit(functools.partial(run, tracker))(params, scans)
    at = int(np.argmax(told.label[0] == 0))
    first = float(told.existence_prob[0, at])
    missed = 0.9 * (1 - 0.2)
    ends = first * missed ** np.arange(5) * np.where(np.arange(5) < 4, 1 - 0.9, 1.0)
    never = 1 - first
    # Its window holds three scans; it begins before, and ended there or never was.
    assert ends[4] > ends[:2].sum()
    assert ends[4] < ends[:2].sum() + never
    at = int(np.argmax(told.paths.label[4] == 0))
    alive = np.cumsum(ends[::-1])[::-1] / (ends.sum() + never)
    np.testing.assert_allclose(told.paths.alive_prob[4, at], alive[2:], rtol=1e-9)
    assert told.paths.alive[4, at].tolist() == [True, True, True]


def test_what_finds_no_room_is_counted():
    label = jnp.array([[0, 1, 2]])
    paths = trajectories.Paths(
        mean=jnp.arange(3.0).reshape(1, 3, 1, 1),
        cov=jnp.ones((1, 3, 1, 1, 1)),
        filtered=jnp.zeros((1, 3, 1, 1)),
        alive_prob=jnp.ones((1, 3, 1)),
        alive=jnp.ones((1, 3, 1), bool),
        label=label,
    )
    found = trajectories.assemble(paths, 2)
    assert found.label.tolist() == [0, 1]
    assert found.mean[0, :, 0].tolist() == [0.0, 1.0]
    assert found.dropped == 1


def test_gradient_of_the_evidence_is_right():
    scans = scenes.stacked(scenes.padded(scenes.detections(3, FEW)))
    room = {**ALL, **POISSON, "max_leaves": 4, "max_hypotheses": 6}
    tracker = tpmbm.tpmbm(scenes.target, solver="greedy", **room)
    given = scenes.draw(3)
    names = "detect", "clutter", "births", "sensor_var"

    def evidence(values):
        params = scenes.params_of({**given, **dict(zip(names, values, strict=True))})
        return run(tracker, params, scans).log_evidence.sum()

    values = np.array([given[name] for name in names])
    steps = 1e-5 * values[:, None] * np.eye(len(names))
    near = np.concatenate([values[None] + steps, values[None] - steps])
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(evidence)))(near)
    found = (value[: len(names)] - value[len(names) :]) / (2e-5 * values)
    told = slope.reshape(2, len(names), -1).mean(0).diagonal()
    np.testing.assert_allclose(found, told, rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"lag": -1}, "lag is -1; give 0 or more"),
        ({"num_scans": -1}, "num_scans is -1"),
        ({"max_leaves": 1}, "max_leaves is 1"),
        ({"solver": "simplex"}, "solver is 'simplex'"),
        ({"trajectories": "dead"}, "trajectories is 'dead'; give 'all' or 'alive'"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, sentence):
    for make in (tpmbm.tpmbm, tmbm.tmbm):
        with pytest.raises(ValueError, match=sentence):
            make(scenes.target, **settings)


def test_fewer_birth_times_than_none_are_refused():
    with pytest.raises(ValueError, match="num_birth_times is -1; give 0 or more"):
        tpmbm.tpmbm(scenes.target, num_birth_times=-1)


def test_births_of_the_other_kind_are_refused():
    params = scenes.params_of(scenes.draw(0))
    places = params._replace(birth=MultiBernoulliBirth(*params.birth), undetected=None)
    with pytest.raises(ValueError, match="birth is a PoissonBirth"):
        tmbm.tmbm(scenes.target).init(params, KEY)
    with pytest.raises(ValueError, match="birth is a MultiBernoulliBirth"):
        tpmbm.tpmbm(scenes.target).init(places, KEY)


def test_a_tree_is_awaited_where_its_detection_was_likely_of_a_target():
    exists = jnp.array([[[1e-6, 1e-7]], [[0.9, 0.5]], [[0.9, 0.9]]])
    seen = jnp.array([[[True, False]], [[True, False]], [[True, True]]])
    gain = jnp.log(jnp.array([[[1.0, 1.0]], [[1.0, 0.2]], [[1.0, 1.0]]]))
    history = remembering.History(None, exists, gain, seen, jnp.ones(2), 2)
    found = retrodiction.awaited(history, jnp.array([0, 0, -1]), 2 * jnp.ones(3), 1e-3)
    assert found.tolist() == [False, True, False]
    # What was before a tree began says nothing of it.
    found = retrodiction.awaited(history, jnp.zeros(3, int), jnp.array([2, 1, 1]), 1e-3)
    assert found.tolist() == [False, False, True]


def test_trees_begin_with_the_likeliest_detections():
    drawn, key = scenes.draw(0), jax.random.key(0)
    params = scenes.params_of(drawn)
    trees = forest.begin(scenes.target, params, (2, 3, 1), key)
    belief = jax.tree.map(lambda x: jnp.repeat(x[:1, 0], 3, axis=0), trees.belief)
    score = jnp.log(jnp.array([1.0, 0.25, 3.0]))
    firsts = undetected.Firsts(score, belief, None, jnp.zeros(()))
    grown, label, lost = growing.plant(True, 2, trees, firsts, jnp.array(5))
    assert grown.label.tolist() == [-1, -1, 5, 6]
    assert grown.past[2:, 0, -1].tolist() == [0, 2]
    np.testing.assert_allclose(grown.existence_prob[2:, 0], [0.5, 0.75])
    np.testing.assert_allclose(lost, 0.2)
    assert label == 7
