"""JPDA* and set JPDA: against plain enumeration, and on two targets side by side."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import engine, models, targets
from jaxtrack.trackers import jpda, jpda_star, set_jpda, single_scan
from jaxtrack.trackers.association import Events
from jaxtrack.types import Scan


def all_events(log_score):
    """Every joint event and its log-weight."""
    num, columns = log_score.shape
    events = []
    for event in itertools.product(range(columns), repeat=num):
        taken = [k for k in event if k < columns - 1]
        weight = sum(log_score[n, k] for n, k in enumerate(event))
        if len(set(taken)) == len(taken) and weight > -np.inf:
            events.append((event, weight))
    return events


def star_by_hand(log_score):
    """Marginals over the likeliest event of each set of tracks and detections."""
    last = log_score.shape[1] - 1
    kept = {}
    for event, weight in all_events(log_score):
        tracks = frozenset(n for n, k in enumerate(event) if k < last)
        detections = frozenset(k for k in event if k < last)
        best = kept.get((tracks, detections), (None, -np.inf))
        if weight > best[1]:
            kept[tracks, detections] = event, weight
    prob = np.zeros(log_score.shape)
    for event, weight in kept.values():
        for n, k in enumerate(event):
            prob[n, k] += np.exp(weight)
    return prob / prob.sum(1, keepdims=True)


@functools.cache
def star(num, columns):
    def marginals(log_score):
        return jnp.exp(jpda_star.associate(log_score, max_events=200).log_prob)

    return jax.jit(jax.vmap(marginals))


@pytest.mark.parametrize(("num", "columns"), [(2, 3), (3, 4), (4, 3)])
def test_jpda_star_by_hand(num, columns):
    rng = np.random.default_rng(num * columns)
    scores = rng.normal(size=(30, num, columns)) * 2
    scores[rng.random(scores.shape) < 0.2] = -np.inf
    scores[..., -1] = np.maximum(scores[..., -1], -3)
    found = star(num, columns)(scores)
    for one, score in zip(found, scores, strict=True):
        # Shares are between 0 and 1.
        np.testing.assert_allclose(one, star_by_hand(score), atol=1e-12)


def trade(events, point, there):
    return np.array(jax.jit(set_jpda.trades)(events, point, there))


def spread(events, point, taker):
    """Sum over places of the variance of who takes them."""
    prob = np.exp(events.log_prob)
    total = 0.0
    for place in range(point.shape[0]):
        taken = np.array(
            [
                point[who[place], column[who[place]]]
                for who, column in zip(taker, events.column, strict=True)
            ]
        )
        mean = prob @ taken
        total += prob @ ((taken - mean) ** 2).sum(1)
    return total


def test_trades_are_a_local_optimum():
    """Against all combinations of permutations over events, for two tracks."""
    rng = np.random.default_rng(0)
    swaps = np.array([[0, 1], [1, 0]])
    best = 0
    for _ in range(20):
        point = rng.normal(size=(2, 4, 2)) * 2
        column = np.array(list(itertools.permutations(range(3), 2)))
        events = Events(column, np.log(rng.dirichlet(np.ones(6))))
        found = trade(events, point, np.ones(2, bool))
        value = spread(events, point, found)
        at = point[np.arange(2)[None], column]  # [E, N, P]
        mean = np.exp(events.log_prob) @ np.stack(
            [x[who] for x, who in zip(at, found, strict=True)]
        ).reshape(6, -1)
        for x, who in zip(at, found, strict=True):  # nobody would trade again
            stay, swap = (
                ((mean.reshape(2, 2) - x[w]) ** 2).sum() for w in (who, 1 - who)
            )
            assert stay <= swap + 1e-12
        least = min(
            spread(events, point, swaps[list(choice)])
            for choice in itertools.product((0, 1), repeat=6)
        )
        assert value <= spread(events, point, np.tile(swaps[0], (6, 1))) + 1e-12
        best += value <= least + 1e-9
    assert best >= 10


def test_empty_slots_trade_with_nobody():
    point = np.zeros((3, 3, 1))
    point[:, :, 0] = [[0.0, 1.0, 9.0], [1.0, 0.0, 9.0], [0.5, 0.5, 0.5]]
    events = Events(np.array([[0, 1, 2], [1, 0, 2]]), np.log([0.5, 0.5]))
    taker = trade(events, point, np.array([True, True, False]))
    np.testing.assert_array_equal(taker[:, 2], 2)


def pair(gap, scans=40):
    """Two targets that go side by side and part, [T, 2, 2]."""
    time = np.arange(scans, dtype=float)
    apart = np.where(time < 25, gap, gap + 4.0 * (time - 25))
    y = np.stack([apart / 2, -apart / 2], 1)
    x = np.stack([10 * time, 10 * time], 1)
    return np.stack([x, y], -1)


@functools.cache
def distance_kept(maker, **choices):
    """How far apart the tracks are, on average, while the targets are 8 m apart."""
    place = pair(8.0)
    start = np.array([[-10.0, 10, 4.0, 0], [-10.0, 10, -4.0, 0]])
    params = single_scan.Params(
        target=targets.single.Params(
            motion=models.motion.ConstantVelocity(np.full(2, 0.5)),
            sensor=models.sensor.Position(np.full(2, 10.0)),
            survive=models.probability.Constant(np.array(1.0)),
            detect=models.probability.Constant(np.array(0.95)),
        ),
        birth=None,
        clutter=models.clutter.UniformClutter(
            np.array(0.5), np.full(2, -500.0), np.full(2, 500.0)
        ),
        start=models.birth.MultiBernoulliBirth(
            np.ones(2),
            start,
            np.tile(np.diag([25.0, 4, 25, 4]), (2, 1, 1)),
            np.ones((2, 1)),
        ),
    )
    tracker = maker(targets.single.single(), max_tracks=2, gate_prob=1.0, **choices)
    rng = np.random.default_rng(0)
    many = 40
    points = place[None] + 10 * rng.normal(size=(many, *place.shape))
    scans = Scan(points, rng.random(points.shape[:3]) < 0.95, np.ones(points.shape[:2]))

    def one(scans):
        return engine.run(tracker, params, scans, jax.random.key(0)).mean[:, :, ::2]

    found = np.array(jax.jit(jax.vmap(one))(scans))
    return np.abs(found[:, :25, 0, 1] - found[:, :25, 1, 1]).mean()


def test_jpda_coalesces_and_the_others_do_not():
    """Noise of 10 m."""
    joint = distance_kept(jpda.jpda)
    star = distance_kept(jpda_star.jpda_star, max_events=20)
    sets = distance_kept(set_jpda.set_jpda, max_events=20)
    assert joint < 4.0
    assert star > 1.5 * joint
    assert sets > 1.5 * joint


def test_set_jpda_of_targets_far_apart_is_jpda():
    with np.errstate(divide="ignore"):
        log_score = np.log([[9.0, 0.0, 1.0], [0.0, 4.0, 2.0]])
    events = jax.jit(lambda score: jpda.by_events(score, 8).events)(log_score)
    point = np.array([[[0.0], [1e3], [1.0]], [[0.0], [1e3], [1e3 + 1]]])
    taker = trade(events, point, np.ones(2, bool))
    likely = np.exp(events.log_prob) > 1e-9
    assert likely.sum() == 4
    np.testing.assert_array_equal(taker[likely], [[0, 1]] * 4)


@pytest.mark.parametrize("maker", [jpda_star.jpda_star, set_jpda.set_jpda])
def test_no_events_are_too_few(maker):
    with pytest.raises(ValueError, match="max_events is 0"):
        maker(targets.single.single(), max_events=0)
