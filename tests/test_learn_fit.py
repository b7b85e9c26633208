"""Fits, against closed forms and against a plain filter with SciPy's optimiser."""

import functools
import math
from typing import NamedTuple

import chex
import jax
import numpy as np
import optax
import pytest
import scipy.optimize
from cases import learning
from cases.learning import SCANS, follower, moving, start, watched, watcher
from cases.trackers import case_of, random_scans, tracker_of

from jaxtrack import learn
from jaxtrack.learn import information, leaves, sizes, slopes
from jaxtrack.learn.loss import evidence, held_out
from jaxtrack.models import motion, sensor
from jaxtrack.types import Scans

pytestmark = pytest.mark.usefixtures("whole_matrices")

# What Hessians may be where they are 0: differences of slopes divide the rounding of
# these, summed over 120 scans, by 1e-5.
DIFFERENCED = 1e-6
NEWTON = optax.lbfgs()
ADAM = optax.adam(0.1)
FIRST = learning.Line(
    motion.ConstantVelocity(np.array([2.0])), sensor.Position(np.array([1.0]))
)


def both(p):
    return p.std, p.mean


@functools.cache
def closed():
    """A fit of mean and standard deviation of independent numbers."""
    return learn.fit(
        watcher, start(), watched(), NEWTON, where=both, num_steps=40, patience=5
    )


def test_the_best_mean_and_deviation_are_those_of_the_sample():
    z, found = watched().detections, closed().params
    # The loss is flat at its least: steps that lower it by 1e-16 are seen no more.
    np.testing.assert_allclose(found.mean, z.mean(), rtol=1e-6)
    np.testing.assert_allclose(found.std, z.std(), rtol=1e-6)
    assert found.factor == 1.0
    assert closed().stopped == "converged"


def test_standard_errors_are_those_of_the_normal_distribution():
    z, known = watched().detections, closed().information
    expected = z.std() / np.sqrt(z.size)
    assert known.names == ["mean", "std"]
    np.testing.assert_allclose(known.std_error["mean"], expected, rtol=1e-5)
    np.testing.assert_allclose(known.std_error["std"], expected / 2**0.5, rtol=1e-5)
    # In log(std) and mean / 0.5, its scale.
    hessian = np.diag([z.size / z.var() / 4, 2 * z.size])
    np.testing.assert_allclose(known.hessian, hessian, rtol=1e-8, atol=DIFFERENCED)


def test_history_begins_at_the_start_and_tells_every_step():
    told = closed().history
    assert len(told.loss) == closed().num_steps
    np.testing.assert_allclose(told.values["mean"][0], 0.5)
    np.testing.assert_allclose(told.free["std"][:, 0], np.log(told.values["std"]))
    z = watched().detections
    first = np.log(2 * np.pi) / 2 + ((z - 0.5) ** 2).mean() / 2
    np.testing.assert_allclose(told.loss[0], first)


def test_what_cannot_be_known_apart_has_an_infinite_error():
    fit = learn.fit(watcher, start(), watched(), NEWTON, num_steps=40)
    errors = fit.information.std_error
    assert errors["std"] == errors["factor"] == np.inf
    assert np.isfinite(errors["mean"])
    product = fit.params.std * fit.params.factor
    np.testing.assert_allclose(product, watched().detections.std(), rtol=1e-6)


def test_all_scans_count_for_the_information_of_minibatches():
    problem = slopes.Problem(
        watcher, leaves.plan(start(), both), evidence, None, 2, 9, 16, 1
    )
    told = closed().history
    free = {name: x[told.loss.argmin()] for name, x in told.free.items()}
    data = slopes.gather(watched(), None, 0)
    found = information.observed(problem, start(), data, free)
    expected = closed().information.hessian
    np.testing.assert_allclose(found.hessian, expected, rtol=1e-9, atol=DIFFERENCED)


@pytest.mark.parametrize(
    ("loss", "last"),
    [(evidence, SCANS), (held_out(0.3), math.ceil(0.3 * SCANS))],
    ids=["all", "held out"],
)
def test_a_prior_pulls_towards_what_it_likes(loss, last):
    """Against the scans that count, which also tell the error."""

    def prior(p):
        return -((p.mean - 3.0) ** 2) / 2 / 0.01

    fit = learn.fit(
        watcher,
        start(std=0.7),
        watched(),
        NEWTON,
        where=lambda p: p.mean,
        loss=loss,
        prior=prior,
        num_steps=40,
    )
    z = watched().detections[:, -last:]
    precision = z.size / 0.49
    expected = (z.mean() * precision + 3.0 * 100) / (precision + 100)
    np.testing.assert_allclose(fit.params.mean, expected, rtol=1e-6)
    error = fit.information.std_error["mean"]
    np.testing.assert_allclose(error, (precision + 100) ** -0.5, rtol=1e-5)


@functools.cache
def kalman_fit():
    return learn.fit(follower, FIRST, moving(1), NEWTON, num_steps=60)


def test_a_kalman_filter_learns_what_scipy_finds_with_a_plain_one():
    def total(x):
        return -learning.log_evidence(moving(1), *np.exp(x))

    found = scipy.optimize.minimize(total, np.log([2.0, 1.0]), tol=1e-10)
    expected = np.exp(found.x)
    density, std = (x[0] for x in jax.tree.leaves(kalman_fit().params))
    np.testing.assert_allclose([density, std], expected, rtol=1e-4)
    np.testing.assert_allclose(
        kalman_fit().history.loss.min() * 3 * SCANS, found.fun, rtol=1e-9
    )
    # Second differences of the plain filter; errors of the parameters themselves.
    step = 1e-3 * np.eye(2)
    hessian = [
        [
            total(found.x + a + b)
            - total(found.x + a - b)
            - total(found.x - a + b)
            + total(found.x - a - b)
            for a in step
        ]
        for b in step
    ]
    cov = np.linalg.inv(np.array(hessian) / 4e-6)
    errors = kalman_fit().information.std_error
    told = [errors["motion.noise_density"][0], errors["sensor.noise_std"][0]]
    np.testing.assert_allclose(told, expected * np.sqrt(np.diag(cov)), rtol=1e-3)


def test_one_recording_needs_no_axis():
    alone = jax.tree.map(lambda x: x[0], watched())
    fit = learn.fit(watcher, start(), alone, NEWTON, where=both, num_steps=30)
    np.testing.assert_allclose(fit.params.mean, alone.detections.mean(), rtol=1e-6)


def test_a_fit_that_diverges_says_where_and_returns_the_last_finite_one():
    wild = optax.sgd(2e3)
    fit = learn.fit(watcher, start(), watched(), wild, where=both, errors=False)
    assert fit.stopped == "diverged"
    assert fit.message == f"diverged at step {fit.num_steps}: std is not finite"
    chex.assert_tree_all_finite((fit.params, fit.history))
    np.testing.assert_array_equal(fit.params.mean, fit.history.values["mean"][-1])

    broken = watched()._replace(detections=np.full((3, SCANS, 1, 1), np.nan))
    fit = learn.fit(watcher, start(), broken, wild, where=both)
    assert fit.message == "diverged at step 0: the gradient of mean is not finite"
    assert (fit.params, fit.history) == (start(), None)


class Outer(NamedTuple):
    scan: int


def with_truth(estimates, scans, truth):
    return truth.mean()


def test_windows_and_batches_are_drawn_evenly():
    times = np.arange(5 * 8.0).reshape(5, 8)
    data = slopes.gather(times, None, seed=0)
    draw = jax.jit(jax.vmap(lambda key: slopes.pick(key, data, 3, 6).scans))
    found = np.array(draw(jax.random.split(jax.random.key(0), 600)))
    assert found.shape == (600, 3, 6)
    assert (np.diff(found) == 1).all()
    rows, first = found[..., 0] // 8, found[..., 0] % 8
    assert all(len(set(row)) == 3 for row in rows)
    # 360 of each row and 600 of each beginning are expected, with deviations of 12
    # and 20.
    np.testing.assert_allclose(np.bincount(rows.astype(int).ravel()), 360, atol=60)
    np.testing.assert_allclose(np.bincount(first.astype(int).ravel()), 600, atol=100)


def test_minibatches_come_near_and_return_the_last():
    settings = {"batch": 2, "window": 10, "num_steps": 150, "patience": None}
    fit = learn.fit(
        watcher, start(), watched(), optax.adam(0.02), where=both, **settings
    )
    # Half of a standard error at 20 numbers, and what a step of 0.02 leaves.
    assert abs(fit.params.mean - watched().detections.mean()) < 0.1
    assert abs(fit.params.std / watched().detections.std() - 1) < 0.1
    np.testing.assert_array_equal(fit.params.mean, fit.history.values["mean"][-1])
    whole = closed().information.std_error["mean"]
    np.testing.assert_allclose(fit.information.std_error["mean"], whole, rtol=0.1)


def test_the_same_sizes_compile_nothing_anew():
    run = functools.partial(learn.fit, watcher, where=both, num_steps=3, errors=False)
    run(start(), watched(), ADAM)
    before = slopes.slope._cache_size()
    run(start(std=2.0), watched(seed=5), ADAM)
    assert slopes.slope._cache_size() == before


@pytest.mark.slow
def test_jpda_learns_noise_and_detection_among_clutter():
    name = "jpda"
    scans = jax.tree.map(
        lambda *x: np.stack(x), *(random_scans(name, seed) for seed in range(2))
    )
    params = case_of(name).params
    far = params.target.sensor._replace(noise_std=3 * params.target.sensor.noise_std)
    params = params._replace(target=params.target._replace(sensor=far))
    fit = learn.fit(
        tracker_of(name),
        params,
        scans,
        ADAM,
        where=lambda p: (p.target.sensor, p.target.detect),
        num_steps=6,
        errors=False,
    )
    assert set(fit.history.values) == {"target.sensor.noise_std", "target.detect.value"}
    assert fit.history.loss[-1] < fit.history.loss[0] - 0.05
    assert fit.params.target.sensor.noise_std < 0.7 * far.noise_std


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"batch": 4}, "batch is 4; give a number from 1 to 3"),
        ({"window": 41}, "window is 41; give a number from 1 to 40"),
        ({"num_steps": 0}, "num_steps is 0; give at least 1"),
        (
            {"truth": np.zeros((3, 7)), "loss": with_truth},
            r"truth hold an array of shape \(3, 7\)",
        ),
        ({"num_steps": 2.5}, "num_steps is 2.5; give at least 1, a whole number"),
        ({"num_steps": None}, "num_steps is None; give at least 1, a whole number"),
        ({"window": 2.5}, "window is 2.5; give a number from 1 to 40"),
        ({"tolerance": np.nan}, "tolerance is nan; give a finite number, at least 0"),
        ({"tolerance": None}, "tolerance is None; give a finite number"),
        ({"scans": None}, r"scans are of type NoneType; give a Scan or Scans whose"),
        ({"scans": Outer(1)}, "of type Outer, which has them in .scan; give"),
        ({"optimizer": None}, "optimizer is None; give one of optax, such as"),
        ({"where": "std"}, "where is 'std'; give a function such as lambda"),
        ({"loss": None}, "loss is None; give a function"),
        ({"loss": with_truth}, "the loss needs the truth; give truth="),
        (
            {"truth": np.zeros((3, 40))},
            "truth is given, but the loss takes none; leave",
        ),
        ({"loss": lambda estimates: 0.0}, "does not take .estimates, scans., nor"),
        (
            {"loss": lambda estimates, scans: estimates.log_evidence},
            r"the loss returns shape \(40,\); return a scalar, as of .mean",
        ),
        (
            {"loss": lambda estimates, scans: (estimates.log_evidence.mean(), 1)},
            "the loss returns a tuple; return a scalar",
        ),
        (
            {"loss": lambda estimates, scans: estimates.log_evidence.argmax()},
            "the loss returns int.*, not a float; it has no slope",
        ),
        ({"prior": lambda p: p.mean[None]}, r"the prior returns shape \(1,\); return"),
    ],
)
def test_sizes_that_make_no_sense_are_told(settings, told):
    given = {"scans": watched(), **settings}
    with pytest.raises(ValueError, match=told):
        learn.fit(watcher, start(), **given)


def test_scans_of_several_sensors_are_counted_by_the_first():
    every = Scans((watched(), watched()), np.ones((3, SCANS, 2), bool))
    assert sizes.recordings(every, None) == (True, 3, SCANS)


def test_shapes_of_scans_are_told():
    with pytest.raises(ValueError, match=r"interval has shape \(\); give \[T\]"):
        sizes.recordings(jax.tree.map(lambda x: x[0, 0], watched()), None)
