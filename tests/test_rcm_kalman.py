import chex
import jax
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from reference import kalman as book

from jaxtrack import rcm_kalman
from jaxtrack.rcm_kalman import Belief, RandomAffine
from jaxtrack.types import Gaussian

begin = jax.jit(rcm_kalman.begin)


@jax.jit
def step(belief, motion, sensor, detection):
    predicted = rcm_kalman.predict(belief, motion)
    return predicted, *rcm_kalman.update(predicted, sensor, detection)


def random_map(rng, num, rows, dim):
    return RandomAffine(
        prob=rng.dirichlet(np.ones(num)),
        matrix=rng.normal(size=(num, rows, dim)),
        cov=np.array([book.random_cov(rng, rows) for _ in range(num)]),
    )


def random_system(seed, dim=4, num_outputs=2):
    rng = np.random.default_rng(seed)
    prior = Gaussian(rng.normal(size=dim) * 3, book.random_cov(rng, dim))
    motion = random_map(rng, 3, dim, dim)
    return prior, motion, random_map(rng, 2, num_outputs, dim)


def two_targets(seed):
    """Two targets stacked, which take the detections in order or exchanged."""
    rng = np.random.default_rng(seed)
    prior = Gaussian(rng.normal(size=8) * 3, book.random_cov(rng, 8))
    rows = np.eye(8)[[0, 2, 4, 6]]
    matrix = np.array([rows, rows[[2, 3, 0, 1]]])
    cov = np.array([book.random_cov(rng, 4)] * 2)
    sensor = RandomAffine(np.array([0.7, 0.3]), matrix, cov)
    return prior, random_map(rng, 3, 8, 8), sensor


@pytest.mark.parametrize("system", [random_system(0), random_system(1), two_targets(0)])
def test_filter_follows_the_equations(system):
    prior, motion, sensor = system
    rng = np.random.default_rng(2)
    belief = begin(prior)
    m, P = prior
    second = P + np.outer(m, m)
    for _ in range(3):
        detection = rng.normal(size=sensor.cov.shape[-1])
        predicted, belief, log_density = step(belief, motion, sensor, detection)
        m, P, second = book.random_predict(m, P, second, *motion)
        expected = Belief(m, P, second)
        chex.assert_trees_all_close(predicted, expected, rtol=1e-9, atol=1e-9)
        m, P, expected_density = book.random_update(m, P, second, *sensor, detection)
        expected = Belief(m, P, second)
        chex.assert_trees_all_close(belief, expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(log_density, expected_density, rtol=1e-9)


def test_filter_is_the_kalman_filter_where_nothing_is_random():
    prior, motion, sensor = random_system(0)

    def alike(random):
        """Realisations that are all the same, drawn with unequal probabilities."""
        matrix = np.broadcast_to(random.matrix[0], random.matrix.shape)
        return random._replace(
            matrix=matrix, cov=np.broadcast_to(random.cov[0], random.cov.shape)
        )

    motion, sensor = alike(motion), alike(sensor)
    rng = np.random.default_rng(1)
    belief = begin(prior)
    m, P = prior
    for _ in range(4):
        detection = rng.normal(size=2)
        _, belief, log_density = step(belief, motion, sensor, detection)
        m, P = book.predict(m, P, motion.matrix[0], 0.0, motion.cov[0])
        H, R = sensor.matrix[0], sensor.cov[0]
        m, P, expected_density = book.update(m, P, H, 0.0, R, detection)
        chex.assert_trees_all_close((belief.mean, belief.cov), (m, P), rtol=1e-9)
        np.testing.assert_allclose(log_density, expected_density, rtol=1e-9)


def test_prediction_without_detections_has_the_moments_of_the_mixture():
    prior, motion, sensor = random_system(3)
    means, covs = [], []
    for F, Q in zip(motion.matrix, motion.cov, strict=True):
        mean, cov = book.predict(*prior, F, 0.0, Q)
        means.append(mean)
        covs.append(cov)
    centre = sum(p * mean for p, mean in zip(motion.prob, means, strict=True))
    spread = np.zeros((4, 4))
    for p, mean, cov in zip(motion.prob, means, covs, strict=True):
        spread += p * (cov + np.outer(mean - centre, mean - centre))
    predicted, _, _ = step(begin(prior), motion, sensor, np.zeros(2))
    expected = Belief(centre, spread, spread + np.outer(centre, centre))
    chex.assert_trees_all_close(predicted, expected, rtol=1e-12)


def draw(rng, random, states):
    """Sends each of R states [R, D] through a realisation of its own."""
    which = rng.choice(len(random.prob), size=len(states), p=random.prob)
    noise = rng.normal(size=(len(states), random.cov.shape[-1]))
    root = np.linalg.cholesky(random.cov)[which]
    moved = np.einsum("rij,rj->ri", random.matrix[which], states)
    return moved + np.einsum("rij,rj->ri", root, noise)


def test_moments_are_those_of_many_runs_and_the_error_is_orthogonal_to_the_data():
    """With an error that no detection correlates with, no linear filter is better."""
    num_runs = 100_000
    prior, motion, sensor = random_system(4, dim=2, num_outputs=1)
    rng = np.random.default_rng(5)
    root = np.linalg.cholesky(prior.cov)
    states = prior.mean + rng.normal(size=(num_runs, 2)) @ root.T

    axes = Belief(0, None, None)
    batched = jax.jit(jax.vmap(step, (axes, None, None, 0), (axes, axes, 0)))
    belief = begin(prior)
    belief = belief._replace(mean=np.broadcast_to(prior.mean, (num_runs, 2)))
    seen = []
    for _ in range(3):
        states = draw(rng, motion, states)
        detections = draw(rng, sensor, states)
        seen.append(detections[:, 0])
        predicted, belief, _ = batched(belief, motion, sensor, detections)

        scale = np.sqrt(np.diagonal(belief.second_moment))
        second = states.T @ states / num_runs
        error = states - belief.mean
        for actual, expected in (
            (second, belief.second_moment),
            (np.cov((states - predicted.mean).T), predicted.cov),
            (np.cov(error.T), belief.cov),
        ):
            assert (abs(actual - expected) / np.outer(scale, scale)).max() < 0.02
        assert abs(error.mean(0) / scale).max() < 0.02
        data = np.array(seen)
        strength = np.sqrt((data**2).mean(1))
        assert abs(error.T @ data.T / num_runs / np.outer(scale, strength)).max() < 0.02


def test_covariance_does_not_depend_on_detections():
    prior, motion, sensor = random_system(0)
    belief = begin(prior)
    near, far = (step(belief, motion, sensor, np.full(2, z))[1] for z in (0.0, 100.0))
    chex.assert_trees_all_equal(near[1:], far[1:])


def test_filter_has_correct_gradients():
    prior, motion, sensor = random_system(0, dim=2, num_outputs=1)
    vector, unravel = ravel_pytree((prior, motion, sensor, np.ones(1)))

    @jax.jit
    @jax.value_and_grad
    def loss(vector):
        *models, detection = unravel(vector)
        prior, motion, sensor = map(book.symmetric, models)
        belief = rcm_kalman.begin(prior)
        _, belief, log_density = step(belief, motion, sensor, detection)
        return book.weighted_sum([*belief, log_density])

    by_gradient, by_differences = book.slopes(loss, vector)
    np.testing.assert_allclose(by_gradient, by_differences, rtol=1e-6)


def test_average_names_the_shape_it_wanted():
    prior, motion, _ = random_system(0)
    with pytest.raises(AssertionError, match=r"\(2,\) but expected \(3\)"):
        rcm_kalman.predict(begin(prior), motion._replace(prob=motion.prob[:2]))
