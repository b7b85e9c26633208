"""Tests of `trackers.pmht` and its parts against loops over detections and causes."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import slopes
from reference import pmht as plain

from jaxtrack import engine, kalman
from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position, RangeBearing, Timed
from jaxtrack.targets import single
from jaxtrack.trackers import pmht, pmht_batch
from jaxtrack.types import Affine, Scan

NUM, TARGETS, SCANS, SLOTS, ROUNDS, BOX = 20, 2, 5, 4, 8, 40.0


def draw(seed):
    """A random problem: numbers, scans as lists, and the intervals."""
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(TARGETS, 2, 2))
    model = {
        "noise_density": rng.uniform(0.2, 2.0),
        "sensor_var": rng.uniform(0.3, 3.0),
        "clutter": rng.uniform(0.3, 3.0),
        "false_density": 1 / BOX,
        "rate": rng.uniform(0.5, 0.95) * rng.uniform(0.5, 1.0, TARGETS),
        "mean": rng.normal(size=(TARGETS, 2)) * np.array([5.0, 1.0]),
        "cov": 4 * roots @ roots.swapaxes(1, 2) + 0.1 * np.eye(2),
        "scale": np.array([1.0, rng.uniform(3.0, 20.0)]),
        "share": np.array([0.7, 0.3]),
    }
    scans = [rng.normal(0, 6, rng.integers(0, SLOTS + 1)) for _ in range(SCANS)]
    return model, scans, rng.uniform(0.4, 2.0, SCANS)


def params_of(model):
    exists = model["rate"] / model["rate"].max()
    return pmht_batch.Params(
        target=single.Params(
            ConstantVelocity(model["noise_density"] * np.ones(1)),
            Position(np.sqrt(model["sensor_var"]) * np.ones(1)),
            None,
            Constant(np.array(model["rate"].max())),
        ),
        clutter=UniformClutter(
            np.array(model["clutter"]), -BOX / 2 * np.ones(1), BOX / 2 * np.ones(1)
        ),
        start=MultiBernoulliBirth(
            exists, model["mean"], model["cov"], np.ones((TARGETS, 1))
        ),
        spread=pmht_batch.Spread(model["scale"], model["share"]),
    )


def scans_of(scans, intervals):
    detections = np.zeros((SCANS, SLOTS, 1))
    valid = np.zeros((SCANS, SLOTS), bool)
    for t, scan in enumerate(scans):
        # From the last slot on, so that empty ones come first.
        where = SLOTS - 1 - np.arange(len(scan))
        detections[t, where, 0], valid[t, where] = scan, True
    return Scan(detections, valid, intervals)


def stack(trees):
    return jax.tree.map(lambda *x: np.stack(x), *trees)


@functools.cache
def problems():
    drawn = [draw(seed) for seed in range(NUM)]
    params = stack([params_of(model) for model, *_ in drawn])
    return drawn, params, stack([scans_of(*rest) for _, *rest in drawn])


smooth = jax.jit(
    jax.vmap(lambda params, scans: pmht_batch.smooth(params, scans, ROUNDS))
)


@functools.cache
def found():
    _, params, scans = problems()
    return jax.tree.map(np.asarray, smooth(params, scans))


def test_iterations_are_those_of_the_loops():
    drawn, _, given = problems()
    for k, (model, scans, intervals) in enumerate(drawn):
        motions = plain.moves(model, intervals)
        paths, log_density = plain.guess(scans, model, motions)
        np.testing.assert_allclose(found().log_density[k], log_density, rtol=1e-10)
        for _ in range(ROUNDS):
            paths = plain.improve(paths, scans, model, motions)
        for n, (mean, cov) in enumerate(paths):
            # Coordinates and covariances of order one, that come near 0.
            np.testing.assert_allclose(
                found().belief.mean[k, n], mean, rtol=1e-8, atol=1e-9
            )
            np.testing.assert_allclose(
                found().belief.cov[k, n], cov, rtol=1e-7, atol=1e-9
            )
        shares = [row for scan in plain.shares(paths, scans, model) for row in scan]
        prob = found().prob[k][:, ::-1][given.valid[k][:, ::-1]]
        expected = np.reshape(shares, (-1, TARGETS + 1))
        np.testing.assert_allclose(prob, expected, rtol=1e-7, atol=1e-12)
        assert (found().prob[k][~given.valid[k]] == 0).all()


def test_objective_sums_over_all_causes_of_all_detections():
    for k, (model, scans, intervals) in enumerate(problems()[0]):
        paths = list(zip(found().belief.mean[k], found().belief.cov[k], strict=True))
        expected = plain.log_objective(paths, scans, model, intervals)
        np.testing.assert_allclose(
            found().log_objective[k, -1], expected, rtol=1e-10, err_msg=str(k)
        )


def test_objective_never_falls():
    gain = np.diff(found().log_objective)
    assert gain.min() > -1e-11  # rounding of sums of some hundred
    assert gain[:, 0].min() > 1e-6
    assert (gain[:, -1] < gain[:, 0]).all()


@pytest.mark.slow
def test_objective_never_falls_where_rates_are_learned():
    _, params, scans = problems()
    many = jax.jit(
        jax.vmap(lambda p, s: pmht_batch.smooth(p, s, 40, learns_rates=True))
    )
    result = many(params, scans)
    assert np.diff(result.log_objective).min() > -1e-11  # as above
    number = result.prob[:, :, :, :-1].sum(2).mean(1)
    # Nearly a fixed point after 40 rounds.
    np.testing.assert_allclose(result.rate[:, :, 0], number, rtol=0.1, atol=0.02)


def test_alone_and_always_seen_it_is_the_kalman_smoother():
    model, _, intervals = draw(0)
    places = np.random.default_rng(5).normal(0, 3, SCANS)
    params = params_of(model)
    target = params.target._replace(detect=Constant(np.ones(())))
    start = params.start._replace(existence_prob=np.array([1.0, 0.0]))
    clutter = params.clutter._replace(rate=np.zeros(()))
    params = params._replace(target=target, start=start, clutter=clutter)
    params = params._replace(spread=pmht_batch.Spread(np.ones(2), np.array([0.3, 0.7])))
    scans = scans_of([[z] for z in places], intervals)
    result = smooth(*stack([(params, scans)] * NUM))
    F, u, Q = plain.moves(model, intervals)
    sensors = Affine(
        np.tile(np.array([[[1.0, 0.0]]]), (SCANS, 1, 1)),
        np.zeros((SCANS, 1)),
        np.full((SCANS, 1, 1), model["sensor_var"]),
    )
    prior = type(result.belief)(model["mean"][0], model["cov"][0])
    motions = Affine(F, u, Q)
    seen = np.ones(SCANS, bool)
    filtered = jax.jit(kalman.filter)(prior, motions, sensors, places[:, None], seen)
    expected = jax.jit(kalman.smooth)(filtered, motions)
    np.testing.assert_allclose(result.belief.mean[0, 0], expected.mean, rtol=1e-9)
    np.testing.assert_allclose(result.belief.cov[0, 0], expected.cov, rtol=1e-9)
    density = filtered.log_density - 1  # one detection expected
    np.testing.assert_allclose(result.log_density[0], density, rtol=1e-9)


@pytest.mark.slow
def test_gradients_of_the_objective_are_right():
    _, params, scans = problems()
    first, seen = jax.tree.map(lambda x: x[3], (params, scans))

    def objective(params):
        return pmht_batch.smooth(params, seen, ROUNDS).log_objective[-1]

    # Neither noise of clutter's box nor a share can be moved alone.
    learned = first._replace(clutter=first.clutter.rate, spread=None)

    def of(learned):
        clutter = first.clutter._replace(rate=learned.clutter)
        return objective(learned._replace(clutter=clutter, spread=first.spread))

    slope = jax.jit(jax.grad(of))(learned)
    moved, scale = slopes.walks(learned)
    values = jax.jit(jax.vmap(of))(moved)
    differences = slopes.differences(values)
    slopes.assert_right(learned, slope, differences, scale, rtol=1e-5, atol=1e-6)


def radar_scans(heading):
    """Two targets fly past a radar, and their bearings across -x."""
    rng = np.random.default_rng(2)
    state = np.array([[-60.0, 1.0, 30.0, -8.0], [-90.0, 2.0, -40.0, 9.0]])
    rows, path = [], []
    for _ in range(8):
        state[:, ::2] += state[:, 1::2]
        path.append(state.copy())
        noise = rng.normal(size=(2, 2)) * np.array([1.0, 0.01])
        true = np.stack(
            [
                np.hypot(state[:, 0], state[:, 2]),
                np.arctan2(state[:, 2], state[:, 0]),
            ],
            1,
        )
        false = rng.uniform([0.0, -math.pi], [150.0, math.pi], (2, 2))
        both = np.concatenate([true + noise, false])
        turned = both[:, 1] - heading
        both[:, 1] = np.arctan2(np.sin(turned), np.cos(turned))
        rows.append(both)
    return Scan(np.array(rows), np.ones((8, 4), bool), np.ones(8)), np.array(path)


@pytest.mark.slow
def test_bearings_may_wrap():
    headings = np.array([0.0, 3.0])
    scans = stack([radar_scans(heading)[0] for heading in headings])
    truth = radar_scans(0.0)[1].swapaxes(0, 1)
    start = np.array([[-60.0, 1.0, 30.0, -8.0], [-90.0, 2.0, -40.0, 9.0]])

    @jax.jit
    @jax.vmap
    def run(heading, scans):
        low, high = jnp.array([0.0, -4.0]), jnp.array([150.0, 4.0])
        params = pmht_batch.Params(
            single.Params(
                ConstantVelocity(0.1 * jnp.ones(2)),
                RangeBearing(jnp.array([1.0, 0.01]), jnp.zeros(2), heading),
                None,
                Constant(jnp.array(0.9)),
            ),
            UniformClutter(jnp.array(2.0), low, high),
            MultiBernoulliBirth(
                jnp.ones(2),
                start,
                jnp.tile(jnp.diag(jnp.array([9.0, 1.0, 9.0, 1.0])), (2, 1, 1)),
                jnp.ones((2, 1)),
            ),
        )
        return pmht_batch.smooth(params, scans, 10)

    result = run(headings, scans)
    for mean in result.belief.mean:
        assert np.abs(mean - truth)[:, :, ::2].max() < 2.5
    np.testing.assert_allclose(
        result.log_objective[1], result.log_objective[0], rtol=1e-9
    )
    assert (np.diff(result.log_objective[:, -5:]) > -1e-6).all()


def run(tracker, params, scans):
    return engine.run(tracker, params, scans, jax.random.key(0))


def test_a_window_over_everything_is_the_batch():
    _, params, scans = problems()
    one = jax.tree.map(lambda x: x[4], (params, scans))
    tracker = pmht.pmht(SCANS, ROUNDS, SLOTS)
    estimates = jax.jit(functools.partial(run, tracker))(*one)
    batch = jax.tree.map(lambda x: x[4], found())
    # Coordinates of order one, that come near 0.
    np.testing.assert_allclose(
        estimates.mean[-1], batch.belief.mean[:, -1], rtol=1e-8, atol=1e-10
    )
    np.testing.assert_allclose(estimates.log_evidence, batch.log_density, rtol=1e-9)
    assert (np.asarray(estimates.label) == np.arange(TARGETS)[None]).all()
    assert (estimates.dropped == 0).all()


@pytest.mark.slow
def test_a_short_window_forgets_and_too_many_detections_are_counted():
    _, params, scans = problems()
    tracker = pmht.pmht(2, ROUNDS, SLOTS - 1)
    less = jax.jit(jax.vmap(functools.partial(run, tracker)))(params, scans)
    lost = np.maximum(scans.valid.sum(2) - (SLOTS - 1), 0)
    np.testing.assert_array_equal(less.dropped, lost)
    gap = abs(less.mean[:, -1] - found().belief.mean[:, :, -1]).max((1, 2))
    assert np.isfinite(gap).all()
    assert (gap > 1e-6).all()


def test_scans_may_have_no_slots():
    empty = Scan(np.zeros((SCANS, 0, 1)), np.zeros((SCANS, 0), bool), np.ones(SCANS))
    shape = jax.eval_shape(lambda: pmht_batch.smooth(params_of(draw(0)[0]), empty, 1))
    assert shape.belief.mean.shape == (TARGETS, SCANS, 2)
    assert shape.prob.shape == (SCANS, 1, TARGETS + 1)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="num_scans is 0; give at least 1"):
        pmht.pmht(num_scans=0)
    params = params_of(draw(0)[0])
    timed = params._replace(
        target=params.target._replace(sensor=Timed(params.target.sensor))
    )
    with pytest.raises(ValueError, match="sensor is a Timed, which sees"):
        pmht.pmht().init(timed, jax.random.key(0))
    with pytest.raises(ValueError, match="num_iterations is -1"):
        pmht_batch.check(params, -1)
