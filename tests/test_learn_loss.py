"""Losses of the estimates, against the metrics and against finite differences."""

import itertools
import types
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from cases import learning
from cases import slopes as differences

from jaxtrack import engine, learn
from jaxtrack.learn import loss, segments
from jaxtrack.metrics.gospa import gospa
from jaxtrack.metrics.ospa import ospa
from jaxtrack.models import motion, sensor
from jaxtrack.types import Scan

SCANS, TRUE, TOLD, CUTOFF, ORDER = 6, 3, 4, 10.0, 2.0
INDEX = (0, 2)


def sets(seed, certain):
    """Truth and estimates [x, vx, y, vy], some of them far from any other."""
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(SCANS, TRUE, 4)) * 20
    mean = rng.normal(size=(SCANS, TOLD, 4)) * 20
    mean[:, :TRUE] = state + rng.normal(size=state.shape) * 4
    prob = rng.uniform(0.05, 1, (SCANS, TOLD))
    prob = np.round(prob) if certain else prob
    exists = rng.random((SCANS, TRUE)) < 0.8
    exists[0], prob[1] = False, 0.0  # a scan without truth, one without estimates
    exists[2], prob[2] = False, 0.0
    return types.SimpleNamespace(state=state, exists=exists, mean=mean, prob=prob)


def value(make, temperature, scene):
    told = learning.Told(None, scene.mean, scene.prob)
    return make(INDEX, CUTOFF, ORDER, temperature)(told, None, scene)


METRICS = {"gospa": (loss.gospa, gospa), "ospa": (loss.ospa, ospa)}


@pytest.mark.parametrize("name", METRICS)
def test_of_certain_estimates_it_is_the_metric(name):
    make, metric = METRICS[name]
    scene = sets(0, certain=True)
    there = scene.prob > 0.5

    def both(scene):
        one = jax.vmap(lambda *x: metric(*x, CUTOFF, ORDER).distance)
        index = np.array(INDEX)
        exact = one(
            scene["state"][..., index],
            scene["exists"],
            scene["mean"][..., index],
            there,
        )
        return value(make, 1e-3, types.SimpleNamespace(**scene)), exact

    found, exact = jax.jit(both)(vars(scene))
    assert np.ptp(exact) > 3
    # Pairs whose gain is within some thousandths share, and are as good.
    np.testing.assert_allclose(found, exact.mean(), rtol=1e-3)


def plain_gospa(place, there, mean, prob):
    """The expected cost of the best pairing, by trying all."""
    half = CUTOFF**ORDER / 2
    true, told = np.flatnonzero(there), np.flatnonzero(prob > 0)
    best = np.inf
    for size in range(min(len(true), len(told)) + 1):
        for left in itertools.combinations(true, size):
            for right in itertools.permutations(told, size):
                cost = half * (len(true) - size)
                cost += half * sum(prob[j] for j in told if j not in right)
                for i, j in zip(left, right, strict=True):
                    d = np.linalg.norm(place[i] - mean[j])
                    cost += prob[j] * min(d, CUTOFF) ** ORDER + (1 - prob[j]) * half
                best = min(best, cost)
    return best ** (1 / ORDER)


def test_of_uncertain_estimates_it_is_what_they_cost_on_average():
    scene = sets(1, certain=False)
    index = list(INDEX)
    expected = [
        plain_gospa(x[:, index], there, y[:, index], prob)
        for x, there, y, prob in zip(
            scene.state, scene.exists, scene.mean, scene.prob, strict=True
        )
    ]
    found = jax.jit(lambda: value(loss.gospa, 1e-3, scene))()
    np.testing.assert_allclose(found, np.mean(expected), rtol=1e-3)


@pytest.mark.parametrize("name", METRICS)
def test_slopes_are_right(name):
    scene = sets(2, certain=False)

    def of(tree):
        mean, prob = tree
        return value(
            METRICS[name][0],
            0.05,
            types.SimpleNamespace(**{**vars(scene), "mean": mean, "prob": prob}),
        )

    tree = scene.mean, np.clip(scene.prob, 0.05, 0.95)
    moved, scale = differences.walks(tree)
    values, slope = jax.jit(lambda x, y: (jax.vmap(of)(x), jax.grad(of)(y)))(
        moved, tree
    )
    found = differences.differences(values)
    # A distance of some metres is told to 1e-15, its differences to 1e-10.
    differences.assert_right(tree, slope, found, scale, rtol=1e-5, atol=1e-7)
    assert np.isfinite(differences.flat(slope)).all()


def test_held_out_scans_are_the_last_ones():
    told = learning.Told(np.arange(10.0), None, None)
    np.testing.assert_allclose(loss.held_out(0.3)(told, None), -8.0)
    np.testing.assert_allclose(loss.held_out(0.21)(told, None), -8.0)
    with pytest.raises(ValueError, match="fraction is 0; give a number above 0"):
        loss.held_out(0)


def test_it_is_told_of_how_many_scans_a_loss_is_the_evidence():
    assert loss.counted(loss.evidence, 10) == 10
    assert loss.counted(loss.held_out(0.21), 10) == 3
    assert loss.counted(loss.gospa(INDEX, CUTOFF), 10) is None
    assert loss.counted(lambda estimates, scans: 0.0, 10) is None


@pytest.mark.parametrize(
    ("arguments", "told"),
    [((0.0,), "cutoff is 0.0"), ((1.0, 0.5), "order"), ((1.0, 2.0, 0), "temperature")],
)
def test_numbers_that_make_no_sense_are_told(arguments, told):
    with pytest.raises(ValueError, match=told):
        loss.ospa(INDEX, *arguments)


class Truth(NamedTuple):
    state: Any
    exists: Any


def test_a_fit_may_be_supervised():
    """The place of a certain estimate, learned from where the truth is."""
    scans = learning.watched(seed=3)
    places = scans.detections
    truth = Truth(places, np.ones(places.shape[:-1], bool))
    fit = learn.fit(
        learning.watcher,
        learning.start(mean=0.5),
        scans,
        where=lambda p: p.mean,
        loss=loss.gospa((0,), cutoff=50.0),
        truth=truth,
        num_steps=60,
        patience=None,
    )
    assert fit.information is None
    assert fit.history.loss[-1] < fit.history.loss[0]
    # The existence grows with the mean, too, and that outweighs.
    assert fit.params.mean > places.mean()


PARAMS = learning.Line(
    motion.ConstantVelocity(np.array([2.0])), sensor.Position(np.array([1.0]))
)


def test_segments_bound_the_memory_of_a_gradient():
    many = 10_000
    scans = Scan(np.zeros((many, 1, 1)), np.ones((many, 1), bool), np.ones(many))

    def size(segment):
        def total(params):
            told = segments.run(learning.follower, params, scans, np.zeros(0), segment)
            return told.log_evidence.sum()

        program = jax.jit(jax.grad(total)).lower(PARAMS).compile()
        return program.memory_analysis().temp_size_in_bytes

    assert size(100) < size(None) / 5


@pytest.mark.parametrize("segment", [1, 12, 40, None])
def test_segments_change_neither_values_nor_slopes(segment):
    scans = jax.tree.map(lambda x: x[0], learning.moving(0))
    key = np.zeros(0)

    def total(run, params):
        return run(learning.follower, params, scans, key).log_evidence.sum()

    def parts(*arguments):
        return segments.run(*arguments, segment=segment)

    def both(params):
        return [
            jax.value_and_grad(total, argnums=1)(run, params)
            for run in (parts, engine.run)
        ]

    found, expected = jax.jit(both)(PARAMS)
    jax.tree.map(
        lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-12), found, expected
    )
