import warnings
from functools import partial

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from reference import kalman as book

from jaxtrack import entries, kalman, kalman_parallel
from jaxtrack.kalman import Filtered
from jaxtrack.types import Affine, Gaussian

predict = jax.jit(kalman.predict)
run_filter, run_smooth = jax.jit(kalman.filter), jax.jit(kalman.smooth)


def random_step(seed, dim=4, num_outputs=2):
    """A belief, a motion, a sensor and a detection without any symmetry."""
    rng = np.random.default_rng(seed)
    belief = Gaussian(rng.normal(size=dim), book.random_cov(rng, dim))
    motion = Affine(
        rng.normal(size=(dim, dim)), rng.normal(size=dim), book.random_cov(rng, dim)
    )
    sensor = Affine(
        rng.normal(size=(num_outputs, dim)),
        rng.normal(size=num_outputs),
        book.random_cov(rng, num_outputs),
    )
    detection = rng.normal(size=num_outputs)
    return jax.tree.map(jnp.asarray, (belief, motion, sensor, detection))


def by_the_book(prior, motions, sensors, detections, detected):
    """`Filtered` and the smoothed `Gaussian` of the NumPy reference."""
    *beliefs, log_density = book.filter(prior, motions, sensors, detections, detected)
    filtered = Filtered(Gaussian(*beliefs[:2]), Gaussian(*beliefs[2:]), log_density)
    return filtered, Gaussian(*book.smooth(*beliefs[2:], motions))


@jax.jit
def every_step(belief, motion, sensor, detection):
    updated = kalman.update(belief, sensor, detection)
    density = kalman.log_density(belief, sensor, detection)
    return kalman.predict(belief, motion), updated, density


@pytest.mark.parametrize("sizes", [(1, 2), (3, 2), (8, 4)])
def test_steps_follow_the_equations(sizes):
    belief, motion, sensor, detection = step = random_step(0, *sizes)
    predicted, (after, log_density), density = every_step(*step)
    *expected, expected_density = book.update(*belief, *sensor, detection)
    close = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9)
    jax.tree.map(close, tuple(predicted), book.predict(*belief, *motion))
    jax.tree.map(close, list(after), expected)
    close(log_density, expected_density)
    close(density, expected_density)


def test_residual_of_the_sensor_is_used():
    def wrap(detection, expected):
        return (detection - expected + jnp.pi) % (2 * jnp.pi) - jnp.pi

    belief, _, sensor, detection = random_step(2)
    sensor = sensor._replace(matrix=sensor.matrix / 100)
    detection = jnp.clip(detection, -1, 1)

    @jax.jit
    def both(detection):
        density = kalman.log_density(belief, sensor, detection, wrap)
        return kalman.update(belief, sensor, detection, wrap), density

    turned = both(detection + 2 * jnp.pi)
    chex.assert_trees_all_close(turned, both(detection), rtol=1e-9)
    chex.assert_trees_all_close(turned[0][1], turned[1], rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_filter_and_smoother_agree_with_the_book_over_missing_detections(seed):
    track = book.random_track(seed)
    filtered = run_filter(*track)
    smoothed = run_smooth(filtered, track[1])
    expected = by_the_book(*track)
    chex.assert_trees_all_close((filtered, smoothed), expected, rtol=1e-9, atol=1e-8)
    for cov in (filtered.predicted.cov, filtered.filtered.cov, smoothed.cov):
        chex.assert_trees_all_close(cov, cov.mT, rtol=1e-13)


def test_filter_and_smoother_agree_with_filterpy():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its docstrings have invalid escapes
        from filterpy.kalman import KalmanFilter

    track = prior, motions, sensors, detections, detected = book.random_track(3)
    peer = KalmanFilter(dim_x=4, dim_z=2)
    peer.x, peer.P = prior
    mean, cov, log_density = [], [], []
    for t, seen in enumerate(detected):
        F, u, Q = (x[t] for x in motions)
        H, d, R = (x[t] for x in sensors)
        peer.predict(u=u, B=np.eye(4), F=F, Q=Q)
        peer.update(detections[t] - d if seen else None, R=R, H=H)
        mean.append(peer.x)
        cov.append(peer.P)
        log_density.append(peer.log_likelihood if seen else 0.0)
    filtered = run_filter(*track)
    ours = (*filtered.filtered, filtered.log_density)
    expected = tuple(map(np.array, (mean, cov, log_density)))
    chex.assert_trees_all_close(ours, expected, rtol=1e-9, atol=1e-8)

    # FilterPy smooths without offsets.
    still = track[1]._replace(offset=jnp.zeros((12, 4)))
    filtered = run_filter(track[0], still, *track[2:])
    means, covs = map(np.asarray, filtered.filtered)
    expected = peer.rts_smoother(means, covs, motions.matrix, motions.cov)[:2]
    smoothed = run_smooth(filtered, still)
    chex.assert_trees_all_close(tuple(smoothed), expected, rtol=1e-9, atol=1e-8)


def test_filter_and_smoother_agree_with_dynamax():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its dependencies deprecate one another
        from dynamax.linear_gaussian_ssm import lgssm_smoother
        from dynamax.linear_gaussian_ssm.inference import make_lgssm_params

    prior, motions, sensors, detections, _ = book.random_track(4)
    detected = jnp.ones(12, bool)
    filtered = run_filter(prior, motions, sensors, detections, detected)
    smoothed = run_smooth(filtered, motions)

    # Its prior is the belief at the first scan, before the detection.
    first = predict(prior, jax.tree.map(lambda x: x[0], motions))
    with jax.numpy_rank_promotion("allow"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        params = make_lgssm_params(
            first.mean,
            first.cov,
            dynamics_weights=motions.matrix,
            dynamics_cov=motions.cov,
            dynamics_bias=motions.offset,
            emissions_weights=sensors.matrix,
            emissions_cov=sensors.cov,
            emissions_bias=sensors.offset,
        )
        peer = jax.jit(lgssm_smoother)(params, detections)
    theirs = (
        Gaussian(peer.filtered_means, peer.filtered_covariances),
        Gaussian(peer.smoothed_means, peer.smoothed_covariances),
        peer.marginal_loglik,
    )
    ours = (filtered.filtered, smoothed, filtered.log_density.sum())
    chex.assert_trees_all_close(ours, theirs, rtol=1e-9, atol=1e-8)


def test_a_missed_scan_leaves_the_prediction_as_it_is():
    *rest, detected = book.random_track(0)
    filtered = run_filter(*rest, detected)
    for predicted, after in zip(filtered.predicted, filtered.filtered, strict=True):
        np.testing.assert_array_equal(after[~detected], predicted[~detected])
    np.testing.assert_array_equal(filtered.log_density == 0, ~detected)


def test_steps_of_a_large_state_have_correct_gradients():
    vector, unravel = ravel_pytree(random_step(0, dim=7, num_outputs=1))

    @jax.jit
    @jax.value_and_grad
    def loss(vector):
        belief, motion, sensor, detection = unravel(vector)
        belief, motion, sensor = map(book.symmetric, (belief, motion, sensor))
        predicted = kalman.predict(belief, motion)
        after, log_density = kalman.update(predicted, sensor, detection)
        before = kalman.smooth_step(belief, motion, predicted, after)
        return book.weighted_sum([*after, log_density, *before])

    by_gradient, by_differences = book.slopes(loss, vector)
    np.testing.assert_allclose(by_gradient, by_differences, rtol=1e-6)


def test_tracks_have_correct_gradients_whatever_stands_in_a_missing_detection():
    prior, *models, detected = book.random_track(0, num_scans=5, num_axes=1)
    vector, unravel = ravel_pytree((prior, *models))

    @jax.jit
    @jax.value_and_grad
    def loss(vector):
        prior, motions, sensors, detections = unravel(vector)
        prior, motions, sensors = map(book.symmetric, (prior, motions, sensors))
        filtered = kalman.filter(prior, motions, sensors, detections, detected)
        smoothed = kalman.smooth(filtered, motions)
        outcome = (filtered.log_density, *smoothed)
        return book.weighted_sum(outcome)

    by_gradient, by_differences = book.slopes(loss, vector)
    np.testing.assert_allclose(by_gradient, by_differences, rtol=1e-6)

    def spoil(x):
        seen = jnp.expand_dims(detected, tuple(range(1, x.ndim)))
        return jnp.where(seen, x, jnp.nan)

    spoiled = (prior, models[0], *jax.tree.map(spoil, tuple(models[1:])))
    chex.assert_trees_all_close(loss(ravel_pytree(spoiled)[0]), loss(vector))


@pytest.mark.parametrize("noise_density", [1.0, 1e-4])
def test_covariance_stays_positive_definite_in_float32(noise_density):
    """10,000 irregular scans of a target 100 km away, measured to a millimetre."""
    num_scans = 10_000
    rng = np.random.default_rng(0)
    dt = rng.uniform(0.3, 3.0, num_scans)
    matrix = np.zeros((num_scans, 4, 4))
    noise = np.zeros((num_scans, 4, 4))
    for axis in (slice(0, 2), slice(2, 4)):
        entries = np.array([[dt**0, dt], [0 * dt, dt**0]])
        matrix[:, axis, axis] = entries.transpose(2, 0, 1)
        entries = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        noise[:, axis, axis] = entries.transpose(2, 0, 1) * noise_density
    jump = rng.normal(size=(num_scans, 2)) * np.sqrt(noise_density * dt[:, None])
    velocity = np.cumsum(jump, 0)
    route = np.cumsum((velocity - velocity.mean(0)) * dt[:, None], 0)
    track = (
        Gaussian(np.array([1e5, 0, -1e5, 0]), np.diag([1e8, 1e2, 1e8, 1e2])),
        Affine(matrix, np.zeros((num_scans, 4)), noise),
        Affine(
            matrix=np.tile(np.eye(4)[::2], (num_scans, 1, 1)),
            offset=np.zeros((num_scans, 2)),
            cov=np.tile(np.eye(2) * 1e-6, (num_scans, 1, 1)),
        ),
        np.array([1e5, -1e5]) + route,
    )
    single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), track)
    result = run_filter(*single, np.ones(num_scans, bool))

    # The prior's velocity is 1e8 times less certain than the first detection, so that
    # the next prediction is singular but for rounding.
    for belief, least in ((result.predicted, 0.0), (result.filtered, 0.1)):
        assert belief.cov.dtype == belief.mean.dtype == jnp.float32
        cov = np.asarray(belief.cov, np.float64)
        scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
        scaled = cov / scale[:, :, None] / scale[:, None, :]
        assert np.linalg.eigvalsh(scaled).min() > least
    assert jnp.isfinite(result.log_density).all()
    np.testing.assert_allclose(result.filtered.mean[:, ::2], track[3], atol=0.1)


def test_filter_names_the_shape_it_wanted():
    prior, motions, *rest = book.random_track(0)
    short = jax.tree.map(lambda x: x[1:], motions)
    with pytest.raises(AssertionError, match=r"\(11, 4\) but expected \(12, 4\)"):
        kalman.filter(prior, short, *rest)


def test_random_outputs_leave_float32_positive_definite():
    """Two outputs of all components, a prior ten thousand times less certain."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(500, 4, 4)) * 100 + 30 * np.eye(4)
    cov = (root @ root.transpose(0, 2, 1)).astype(np.float32)
    matrix = rng.normal(size=(500, 2, 4)).astype(np.float32)

    @jax.jit
    @jax.vmap
    def one(cov, matrix):
        sensor = Affine(matrix, jnp.zeros(2, cov.dtype), jnp.eye(2, dtype=cov.dtype))
        prior = Gaussian(jnp.zeros(4, cov.dtype), cov)
        return kalman.update(prior, sensor, jnp.ones(2, cov.dtype))[0].cov

    after = np.asarray(one(cov, matrix), np.float64)
    assert after.dtype == np.float64
    scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2).astype(float))
    scaled = after / scale[:, :, None] / scale[:, None, :]
    assert np.linalg.eigvalsh(scaled).min() > 0


@pytest.mark.parametrize("form", ["array", "known"])
def test_one_sensor_and_motion_serve_all_scans(form):
    """A matrix that is known has no axis over time; smoothers take it, too."""
    prior, motions, sensors, detections, detected = book.random_track(0)
    num = len(detections)
    same = [np.eye(4), np.eye(2, 4)]
    known = [entries.Matrix(x.astype(int).tolist()) for x in same]
    many = [np.tile(x, (num, 1, 1)) for x in same]
    motion, sensor = known if form == "known" else many
    motions = motions._replace(matrix=motion)
    sensors = sensors._replace(matrix=sensor)
    given = prior, motions, sensors, detections, detected
    expected = kalman.filter(
        prior,
        motions._replace(matrix=many[0]),
        sensors._replace(matrix=many[1]),
        detections,
        detected,
    )
    for module in (kalman, kalman_parallel):
        filtered = jax.jit(module.filter)(*given)
        chex.assert_trees_all_close(filtered, expected, rtol=1e-6, atol=1e-6)
        smoothed = jax.jit(module.smooth)(filtered, motions)
        np.testing.assert_allclose(
            smoothed.mean[-1], expected.filtered.mean[-1], rtol=1e-6, atol=1e-6
        )
