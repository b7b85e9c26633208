"""Expectation-maximisation against plain NumPy, and against gradients."""

import functools

import jax
import numpy as np
import scipy.optimize
from cases import learning
from reference import kalman as book

from jaxtrack import kalman
from jaxtrack.learn import em
from jaxtrack.types import Affine

T = learning.SCANS
FEW = 8  # the plain inverse below loses digits over more scans


def random_track():
    """Of 2 components, seen by changing sensors; every third scan sees nothing."""
    return book.random_track(5, num_scans=FEW, num_axes=1)


def joint(prior, motions, sensors, detections, detected):
    """The states of all scans, that before the first, and the data, as one Gaussian."""
    dim, size = prior.mean.size, (FEW + 1) * prior.mean.size
    mean, cov = np.zeros(size), np.zeros((size, size))
    mean[:dim], cov[:dim, :dim] = prior
    for t in range(FEW):
        old, new = slice(t * dim, (t + 1) * dim), slice((t + 1) * dim, (t + 2) * dim)
        move = motions.matrix[t]
        mean[new] = move @ mean[old] + motions.offset[t]
        cov[new, : new.start] = move @ cov[old, : new.start]
        cov[: new.start, new] = cov[new, : new.start].T
        cov[new, new] = move @ cov[old, old] @ move.T + motions.cov[t]
    seen = np.flatnonzero(detected)
    pick = np.zeros((len(seen), size))
    for i, t in enumerate(seen):
        pick[i, (t + 1) * dim : (t + 2) * dim] = sensors.matrix[t, 0]
    noise = np.diag(sensors.cov[seen, 0, 0])
    innovation = detections[seen, 0] - pick @ mean - sensors.offset[seen, 0]
    gain = cov @ pick.T @ np.linalg.inv(pick @ cov @ pick.T + noise)
    return mean + gain @ innovation, cov - gain @ pick @ cov


@functools.cache
def smoothed():
    return jax.tree.map(np.array, jax.jit(em.smooth)(*random_track()))


def test_what_is_expected_of_the_noises_is_that_of_the_joint_gaussian():
    track = random_track()
    _, motions, sensors, detections, detected = track
    mean, cov = joint(*track)
    for t in range(FEW):
        both = np.hstack([-motions.matrix[t], np.eye(2)])
        place = slice(2 * t, 2 * t + 4)
        error = both @ mean[place] - motions.offset[t]
        expected = both @ cov[place, place] @ both.T + np.outer(error, error)
        # The joint covariance has 2e4, and its inverse loses 4e-6 of small entries.
        np.testing.assert_allclose(smoothed().motion[t], expected, rtol=1e-6, atol=1e-5)
        look, place = sensors.matrix[t], slice(2 * t + 2, 2 * t + 4)
        error = detections[t] - look @ mean[place] - sensors.offset[t]
        expected = detected[t] * (look @ cov[place, place] @ look.T + error**2)
        np.testing.assert_allclose(smoothed().sensor[t], expected, rtol=1e-6)


def test_the_evidence_is_that_of_the_filter():
    expected = jax.jit(kalman.filter)(*random_track()).log_density.sum()
    np.testing.assert_allclose(smoothed().log_evidence, expected, rtol=1e-12)


def line():
    """One recording of `learning.moving` as arrays, for a density of 1."""
    scans = jax.tree.map(lambda x: x[0], learning.moving(1))
    pairs = [learning.models(dt) for dt in scans.interval]
    move, noise = (np.stack(x) for x in zip(*pairs, strict=True))
    motions = Affine(move, np.zeros((T, 2)), noise)
    look, four = np.tile([[[1.0, 0.0]]], (T, 1, 1)), np.full((T, 1, 1), 4.0)
    sensors = Affine(look, np.zeros((T, 1)), four)
    return learning.PRIOR, motions, sensors, scans.detections[:, 0], scans.valid[:, 0]


@functools.cache
def learned():
    return jax.tree.map(np.array, jax.jit(em.linear, static_argnums=5)(*line(), 600))


def test_the_evidence_never_falls():
    told = learned().log_evidence
    assert told[1] > told[0] + 0.1
    assert (np.diff(told) > -1e-9).all()  # rounding of some -100


def test_it_ends_where_the_evidence_is_largest():
    alone = jax.tree.map(lambda x: x[:1], learning.moving(1))

    def total(x):
        return -learning.log_evidence(alone, *np.exp(x))

    found = np.exp(scipy.optimize.minimize(total, np.zeros(2), tol=1e-10).x)
    told = [learned().density, learned().sensor_cov[0, 0] ** 0.5]
    np.testing.assert_allclose(told, found, rtol=1e-3)


def chain(seed=0, num_scans=60):
    """Modes that jump, each with its own probability of three symbols."""
    rng = np.random.default_rng(seed)
    true = np.array([[0.9, 0.1, 0.0], [0.0, 0.7, 0.3], [0.5, 0.2, 0.3]])
    says = np.array([[0.8, 0.1, 0.1], [0.2, 0.6, 0.2], [0.1, 0.1, 0.8]])
    mode, told = 0, []
    for _ in range(num_scans):
        mode = rng.choice(3, p=true[mode])
        told.append(says[:, rng.choice(3, p=says[mode])])
    return true, np.array(told)


def test_transitions_are_those_of_baum_and_welch():
    """Forward and backward over a chain of which only the modes are hidden."""
    true, likelihood = chain()
    forward = [np.full(3, 1 / 3) * likelihood[0]]
    for one in likelihood[1:]:
        forward.append(forward[-1] @ true * one)
    backward = [np.ones(3)]
    for one in likelihood[:0:-1]:
        backward.append(true @ (one * backward[-1]))
    backward = backward[::-1]
    expected = np.zeros((3, 3))
    for t in range(len(likelihood) - 1):
        pair = forward[t][:, None] * true * (likelihood[t + 1] * backward[t + 1])
        expected += pair / pair.sum()
    told = np.array([x / x.sum() for x in forward])
    found = jax.jit(em.transitions)(told, true)
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    assert (np.array(found)[true == 0] == 0).all()


def test_a_mode_that_nothing_enters_has_counts_of_zero():
    told = np.array([[1.0, 0.0], [1.0, 0.0]])
    found = jax.jit(em.transitions)(told, np.array([[1.0, 0.0], [0.5, 0.5]]))
    np.testing.assert_array_equal(found, [[1.0, 0.0], [0.0, 0.0]])
