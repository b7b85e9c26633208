"""Fits of rough evidence, against closed forms of what is smooth beneath."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from cases import learning
from cases.learning import SCANS, Told, start, watched, watcher

from jaxtrack import learn
from jaxtrack.learn import information, leaves, roughness, slopes
from jaxtrack.learn.loss import evidence
from jaxtrack.types import Tracker

NOISE = 3.0  # of a slope, times the scans
SLOW = optax.adam(optax.cosine_decay_schedule(0.1, 200))
NEWTON = optax.lbfgs()


def only_mean(p):
    return p.mean


def jagged(params, state, scan):
    """Sees what `watch` does, with ripples.

    Their slope is up to 0.01, what that of the rest is a ninth of an error away; their
    curvature up to a thousand times that of the rest.
    """
    state, told = learning.watch(params, state, scan)
    ripple = 1e-7 * jnp.sin(1e5 * params.mean)
    return state, told._replace(log_evidence=told.log_evidence + ripple)


def drawing(params, state, scan):
    """Sees what `watch` does, with a slope that is drawn."""
    _, told = learning.watch(params, state, scan)
    return state, Told(
        told.log_evidence + state * params.mean, told.mean, told.existence_prob
    )


ripples = Tracker(watcher.init, jagged)
draws = Tracker(lambda params, key: NOISE * jax.random.normal(key), drawing)


def fit(tracker, rough=None, **more):
    settings = {"where": only_mean, "num_steps": 200, "patience": None} | more
    return learn.fit(tracker, start(), watched(), SLOW, rough=rough, **settings)


def total():
    return watched().detections.size


def test_ripples_spoil_an_error_but_not_that_of_slopes_that_lie_apart():
    found = fit(ripples, learn.Rough(apart=0.5))
    expected = total() ** -0.5
    # Two ripples, over a whole error.
    np.testing.assert_allclose(found.information.std_error["mean"], expected, rtol=0.13)
    plain = fit(ripples).information.std_error["mean"]
    assert not 0.5 * expected < plain < 2 * expected


def test_the_mean_of_the_last_places_is_found():
    """A single draw has a valley elsewhere."""
    found = fit(draws, learn.Rough(average=30))
    plain = learn.fit(draws, start(), watched(), NEWTON, where=only_mean, num_steps=40)
    places = found.history.values["mean"]
    np.testing.assert_allclose(found.params.mean, places[-30:].mean(), rtol=1e-12)
    mean = watched().detections.mean()
    keys = slopes.gather(watched(), None, 0).keys
    drawn = np.mean([NOISE * jax.random.normal(key) for key in keys])
    np.testing.assert_allclose(plain.params.mean, mean + drawn, rtol=1e-6)
    assert abs(found.params.mean - mean) < abs(drawn) / 5


def test_fewer_places_than_are_averaged_are_all_averaged():
    found = fit(draws, learn.Rough(average=30), num_steps=7)
    places = found.history.values["mean"]
    np.testing.assert_allclose(found.params.mean, places.mean(), rtol=1e-12)


def test_each_step_draws_anew_and_every_fit_the_same():
    """At a place where the smooth slope is known."""
    still = optax.sgd(0.0)
    told = fit(draws, learn.Rough(), num_steps=50, errors=False)
    again = fit(draws, learn.Rough(), num_steps=50, errors=False)
    np.testing.assert_array_equal(told.history.loss, again.history.loss)
    losses = learn.fit(
        draws,
        start(),
        watched(),
        still,
        where=only_mean,
        num_steps=50,
        patience=None,
        errors=False,
        rough=learn.Rough(),
    ).history.loss
    assert len(np.unique(losses)) == 50
    # Its scatter: of 3 recordings, at a mean of 0.5.
    np.testing.assert_allclose(losses.std(), NOISE * 0.5 / 3**0.5, rtol=0.3)
    plain = fit(draws, num_steps=2, errors=False, where=lambda p: p.std)
    same = fit(draws, num_steps=1, errors=False, where=lambda p: p.std)
    assert plain.history.loss[0] == same.history.loss[0]


def test_batches_are_drawn_as_without():
    """What trackers draw with is apart from it."""
    more = {"batch": 1, "window": 9, "num_steps": 5, "errors": False}
    plain, rough = fit(watcher, **more), fit(watcher, learn.Rough(), **more)
    np.testing.assert_array_equal(plain.history.loss, rough.history.loss)


@functools.cache
def problem(tracker):
    plan = leaves.plan(start(), lambda p: p.std)
    rest = evidence, None, None, None, 16, 1, True
    return slopes.Problem(tracker, plan, *rest)


def slope_of(log_std):
    """Returns the slope of all scans' negative log-evidence in the log of `std`."""
    z = watched().detections - start().mean
    return z.size - (z**2).sum() * np.exp(-2 * log_std)


def secant(place, step):
    return (slope_of(place + step) - slope_of(place - step)) / (2 * step)


@pytest.mark.parametrize("apart", [0.1, 0.5, 2.0])
def test_slopes_are_compared_so_many_errors_apart(apart):
    place = np.log(1.3)
    free = {"std": np.array([place])}
    data = slopes.gather(watched(), None, 0)
    rough = learn.Rough(apart=apart)
    found = information.observed(problem(watcher), start(), data, free, rough)
    step = apart / secant(place, information.NEAR) ** 0.5
    np.testing.assert_allclose(found.hessian, [[secant(place, step)]], rtol=1e-8)


def test_slopes_are_averaged_over_draws():
    """Of the slope that is drawn a difference at the same draw leaves nothing."""

    def curved(params, state, scan):
        _, told = learning.watch(params, state, scan)
        return state, told._replace(
            log_evidence=told.log_evidence - state * jnp.log(params.std) ** 2
        )

    tracker = Tracker(draws.init, curved)
    place, number = np.log(1.3), 25
    free = {"std": np.array([place])}
    data = slopes.gather(watched(), None, 0)
    rough = learn.Rough(draws=number)
    found = information.observed(problem(tracker), start(), data, free, rough)
    keys = jax.random.split(data.keys[0], number)
    each = [
        NOISE * jax.random.normal(x)
        for key in keys
        for x in jax.random.split(jax.random.fold_in(key, slopes.REDRAWN), 3)
    ]
    more = 2 * np.mean(each) * 3 * SCANS
    step = 0.5 / (secant(place, information.NEAR) + more) ** 0.5
    expected = secant(place, step) + more
    np.testing.assert_allclose(found.hessian, [[expected]], rtol=1e-8)


def test_where_nothing_is_known_slopes_are_no_further_apart_than_a_factor_of_e():
    told = roughness.steps(learn.Rough(apart=0.5), np.array([25.0, 0.0, -3.0, 0.01]))
    np.testing.assert_allclose(told, [0.1, 1.0, 1.0, 1.0], rtol=1e-12)


def test_a_fit_that_was_stopped_goes_on_with_the_same_draws(tmp_path):
    whole = fit(draws, learn.Rough())
    fit(draws, learn.Rough(), num_steps=20, errors=False, directory=tmp_path)
    found = fit(draws, learn.Rough(), directory=tmp_path)
    np.testing.assert_array_equal(whole.params.mean, found.params.mean)
    with pytest.raises(ValueError, match="keeps another fit"):
        fit(draws, directory=tmp_path)


def test_what_diverged_is_not_averaged():
    def broken(params, state, scan):
        state, told = learning.watch(params, state, scan)
        far = jnp.where(params.mean > 1.2, jnp.inf, 0.0)
        return state, told._replace(log_evidence=told.log_evidence + far)

    found = fit(Tracker(watcher.init, broken), learn.Rough(), errors=False)
    assert found.stopped == "diverged"
    np.testing.assert_array_equal(found.params.mean, found.history.values["mean"][-1])


@pytest.mark.parametrize(
    ("rough", "message"),
    [
        (True, "rough is True; give learn.Rough"),
        (learn.Rough(average=0), "average is 0; give at least 1"),
        (learn.Rough(average=None), "average is None; give at least 1"),
        (learn.Rough(draws=1.5), "draws is 1.5; give at least 1"),
        (learn.Rough(apart=0.0), "apart is 0.0; give a number above 0"),
        (learn.Rough(apart=np.inf), "apart is inf; give a number above 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(rough, message):
    with pytest.raises(ValueError, match=message):
        fit(watcher, rough)
