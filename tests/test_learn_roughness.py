"""Fits of rough evidence, against closed forms of what is smooth beneath."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from cases import learning
from cases.learning import RUNS, SCANS, Told, start, watched, watcher

from benchmarks import learning_cases
from benchmarks.learning import recordings
from jaxtrack import learn, linearize, resampling
from jaxtrack.learn import information, leaves, roughness, slopes
from jaxtrack.learn.loss import evidence
from jaxtrack.targets import particles
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
    return RUNS * SCANS


def test_ripples_spoil_an_error_but_not_that_of_slopes_that_lie_apart():
    found = fit(ripples, learn.Rough(apart=0.5))
    expected = total() ** -0.5
    # Two ripples, over a whole error.
    np.testing.assert_allclose(found.information.std_error["mean"], expected, rtol=0.13)
    plain = fit(ripples).information.std_error["mean"]
    assert not 0.5 * expected < plain < 2 * expected


def test_the_mean_of_the_last_places_is_found():
    """A single draw has a valley elsewhere."""
    found = fit(draws, learn.Rough(average=30, draws=1))
    plain = learn.fit(draws, start(), watched(), NEWTON, where=only_mean, num_steps=40)
    places = found.history.values["mean"]
    np.testing.assert_allclose(found.params.mean, places[-30:].mean(), rtol=1e-12)
    mean = watched().detections.mean()
    keys = slopes.gather(watched(), None, 0).keys
    drawn = np.mean([NOISE * jax.random.normal(key) for key in keys])
    np.testing.assert_allclose(plain.params.mean, mean + drawn, rtol=1e-6)
    assert abs(found.params.mean - mean) < abs(drawn) / 5


def test_the_way_there_is_not_averaged():
    """Patience lasts until as many places as are averaged lie before them."""
    adam, start_far = optax.adam(0.05), start(mean=-1.0)
    found = learn.fit(
        watcher,
        start_far,
        watched(),
        adam,
        where=only_mean,
        patience=5,
        rough=learn.Rough(average=30),
    )
    assert found.stopped == "converged"
    error = found.information.std_error["mean"]
    np.testing.assert_allclose(
        found.params.mean, watched().detections.mean(), rtol=0, atol=error / 5
    )


def test_patience_compares_means_where_slopes_are_drawn():
    """The least of all losses is a matter of luck."""
    still = optax.sgd(0.0)
    told = learn.fit(
        draws,
        start(),
        watched(),
        still,
        where=only_mean,
        patience=20,
        errors=False,
        rough=learn.Rough(average=10, draws=1),
    ).history.loss
    assert len(told) >= 40
    assert told[-20:].mean() >= told[-40:-20].mean()
    assert all(
        told[i - 20 : i].mean() < told[i - 40 : i - 20].mean()
        for i in range(40, len(told))
    )


@pytest.mark.parametrize("draws_of_a_fit", [None, 1])
def test_steps_draw_anew_if_there_are_draws(draws_of_a_fit):
    """At one place; slopes are drawn for each of 3 recordings."""
    rough = learn.Rough(average=25, draws=draws_of_a_fit)
    told, again = (
        learn.fit(
            draws,
            start(),
            watched(),
            optax.sgd(0.0),
            where=only_mean,
            num_steps=50,
            patience=None,
            errors=False,
            rough=rough,
        ).history.loss
        for _ in range(2)
    )
    np.testing.assert_array_equal(told, again)
    if draws_of_a_fit is None:
        assert len(np.unique(told)) == 1
    else:  # 50 draws know their scatter to a tenth
        np.testing.assert_allclose(told.std(), NOISE * 0.5 / 3**0.5, rtol=0.3)


def test_batches_are_drawn_as_without():
    """What trackers draw with is apart from it."""
    more = {"batch": 1, "window": 9, "num_steps": 5, "errors": False}
    settings = learn.Rough(average=2, draws=1)
    plain, rough = fit(watcher, **more), fit(watcher, settings, **more)
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
    step = apart * (1 / total()) ** 0.5
    for _ in range(30):  # a step that is so many of its own errors
        step = apart / secant(place, step) ** 0.5
    near = [secant(place, step * x) for x in (1 / 1.25, 1.25)]
    assert near[0] <= found.hessian.item() <= near[1]
    # A secant of exp(-2 x) is above its slope, here by a 400th for apart = 1.
    smooth = 2 * (total() - slope_of(place))
    assert abs(found.hessian.item() / smooth - 1) > apart**2 / 500


def test_slopes_are_averaged_over_draws():
    """With a curvature that is drawn."""

    def curved(params, state, scan):
        _, told = learning.watch(params, state, scan)
        more = -state * (params.mean - 1.5) ** 2 / 30
        return state, told._replace(log_evidence=told.log_evidence + more)

    first = start(mean=1.0)  # its unit
    plan = leaves.plan(first, only_mean)
    rest = evidence, None, None, None, 16, 1, True
    asked = slopes.Problem(Tracker(draws.init, curved), plan, *rest)
    data, number = slopes.gather(watched(), None, 0), 25
    free = {"mean": np.array([1.5])}
    rough = learn.Rough(draws=number)
    found = information.observed(asked, first, data, free, rough)
    key = jax.random.fold_in(data.keys[0], information.APART)
    each = [
        NOISE * jax.random.normal(x)
        for key in jax.random.split(key, number)
        for x in jax.random.split(jax.random.fold_in(key, slopes.REDRAWN), 3)
    ]
    expected = total() * (1 + np.mean(each) / 15)
    np.testing.assert_allclose(found.hessian, [[expected]], rtol=1e-8)


def bowl(scale, centre=0.0, beyond=np.inf):
    """Returns slopes of a parabola, which are 0, or not finite, so far away."""

    def gradient(x):
        slope = scale * (x - centre)
        return np.where(np.abs(x - centre) > beyond, 0.0, slope)

    return gradient


@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e3, 1e5])
def test_steps_go_with_what_is_known(scale):
    told = roughness.secants(bowl(scale), np.zeros(1), 0.5)
    np.testing.assert_allclose(told, [[scale]], rtol=1e-9)


def test_a_narrow_valley_is_found():
    """Slopes a tenth away are of nothing that matters here."""
    told = roughness.secants(bowl(4e4, beyond=0.02), np.zeros(1), 0.5)
    np.testing.assert_allclose(told, [[4e4]], rtol=1e-9)


def test_what_is_not_finite_is_gone_around():
    def gradient(x):
        return np.where(np.abs(x) > 0.04, np.nan, 100 * x)

    told = roughness.secants(gradient, np.zeros(1), 0.5)
    np.testing.assert_allclose(told, [[100.0]], rtol=1e-9)


def test_of_what_is_never_finite_nothing_is_told():
    told = roughness.secants(lambda x: x * np.array([np.nan, 1.0]), np.zeros(2), 0.5)
    assert np.isnan(information.std_of(np.eye(2), told)).all()
    assert np.isnan(information.cov_of(told)).all()


def test_where_nothing_is_known_there_is_no_information():
    told = roughness.secants(lambda x: 0 * x, np.zeros(2), 0.5)
    np.testing.assert_array_equal(told, np.zeros((2, 2)))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_several_numbers_of_smooth_evidence_have_the_errors_of_a_plain_fit(dtype):
    """Through a Kalman filter, in recordings of unequal length, with a prior."""
    whole = learning.moving(1)
    cast = jax.tree.map(lambda x: x.astype(dtype) if x.dtype != bool else x, whole)
    some = [
        jax.tree.map(lambda x, r=r, n=n: x[r, :n], cast)
        for r, n in enumerate((SCANS, SCANS - 7, SCANS))
    ]
    first = learning.Line(
        learning.motion.ConstantVelocity(np.array([0.4], dtype)),
        learning.sensor.Position(np.array([2.0], dtype)),
    )
    ask = functools.partial(
        learn.fit,
        learning.follower,
        first,
        some,
        optax.adam(optax.cosine_decay_schedule(0.05, 120)),
        num_steps=120,
        patience=None,
        prior=lambda p: -(jnp.log(p.sensor.noise_std[0]) ** 2),
    )
    plain, rough = ask(), ask(rough=learn.Rough(average=5))
    for path, error in plain.information.std_error.items():
        told = rough.information.std_error[path]
        np.testing.assert_allclose(told, error, rtol=0.05)  # it is no parabola


def test_a_fit_that_was_stopped_goes_on_with_the_same_draws(tmp_path):
    rough = learn.Rough(average=10, draws=1)
    whole = fit(draws, rough)
    fit(draws, rough, num_steps=20, errors=False, directory=tmp_path)
    found = fit(draws, rough, directory=tmp_path)
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
        (learn.Rough(average=101), "average is 101 and num_steps is 200; average at"),
        (learn.Rough(apart=0.0), "apart is 0.0; give a number above 0"),
        (learn.Rough(apart=np.inf), "apart is inf; give a number above 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(rough, message):
    with pytest.raises(ValueError, match=message):
        fit(watcher, rough)


@pytest.mark.slow
def test_particles_find_what_a_kalman_filter_does():
    """One target, in three recordings; 300 particles are few, hence a whole error."""
    size = 3, 40, 12
    exact = learning_cases.followed(one=True)._replace(size=size)
    case = learning_cases.particles()._replace(size=size)
    scans = recordings(exact, 3)
    few = particles.particles(
        300, scheme=resampling.soft(0.5), proposal=linearize.taylor
    )
    best = learn.fit(exact.tracker, exact.first, scans, NEWTON, where=exact.where)
    found = learn.fit(
        learning_cases.patient(few, 1),
        case.first,
        scans,
        optax.adam(0.05),
        where=case.where,
        num_steps=case.steps,
        patience=None,
        rough=case.rough._replace(draws=16),
    )
    pairs = {
        "motion.noise_density": "motions[0].noise_density",
        "sensor.noise_std": "sensor.noise_std",
    }
    for theirs, own in pairs.items():
        ends = (
            fit.information.interval[f"target.{path}"][0]
            for fit, path in ((best, theirs), (found, own))
        )
        (middle, error), (told, own_error) = (
            (np.log(x).mean(), np.log(x[1] / x[0]) / 4) for x in ends
        )
        assert abs(told - middle) < error
        np.testing.assert_allclose(own_error, error, rtol=0.4)  # of few draws
