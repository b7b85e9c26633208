"""The plain PHD and CPHD filters beside enumeration: where they are exact."""

import math

import numpy as np
import pytest
from reference import cphd, phd, sets
from reference import kalman as book

H, R = np.array([[1.0, 0.0]]), np.array([[0.25]])
CLUTTER = phd.Clutter(0.8, lambda z: 1 / 20)
DETECTIONS = [np.array([-0.4]), np.array([1.1]), np.array([4.0])]


def model(detect):
    """Two modes, so that two components may be detected differently."""
    still = [np.eye(2)] * 2
    return phd.Model(still, still, H, R, np.eye(2), np.ones(2), np.array(detect))


def two_components(mass):
    wide = np.diag([4.0, 1.0])
    return [
        (0.3 * mass, np.array([-0.5, 1.0]), np.eye(2), 0),
        (0.7 * mass, np.array([1.0, 0.0]), wide, 1),
    ]


def by_enumeration(p, components, detect, detections):
    mass = sum(w for w, *_ in components)
    g = np.array(
        [
            [np.exp(book.update(m, P, H, 0, R, z)[2]) for z in detections]
            for _, m, P, _ in components
        ]
    ).reshape(len(components), len(detections))
    share = np.array([w / mass for w, *_ in components])
    intensity = np.full(len(detections), CLUTTER.rate / 20)
    return sets.update(p, share, detect, g, intensity, CLUTTER.rate)


@pytest.mark.parametrize("count", range(4))
@pytest.mark.parametrize("detect", [(0.9, 0.6), (1.0, 1.0), (0.0, 0.5)])
def test_plain_cphd_is_bayes_rule(count, detect):
    p, detections = [0.3, 0.1, 0.4, 0.2], DETECTIONS[:count]
    components = two_components(mass=np.dot(p, range(4)))
    *parts, number, log_evidence = cphd.update(
        model(detect), CLUTTER, components, p, detections
    )
    missed, hits = phd.weights(*parts)
    exact = by_enumeration(p, components, detect, detections)
    np.testing.assert_allclose(log_evidence, np.log(exact[0]), rtol=1e-12)
    # Absolute: what cannot be is zero but for rounding.
    np.testing.assert_allclose(number, exact[1], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(missed, exact[2], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(hits, exact[3], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(
        missed.sum() + hits.sum(), np.dot(number, range(4)), rtol=1e-12
    )


@pytest.mark.parametrize("count", range(3))
def test_plain_phd_is_bayes_rule_for_a_poisson_number(count):
    """Cut off at six: seven are as likely as 2e-11."""
    detect, detections, mass = (0.9, 0.6), DETECTIONS[:count], 0.1
    components = two_components(mass)
    *parts, log_evidence = phd.update(model(detect), CLUTTER, components, detections)
    missed, hits = phd.weights(*parts)
    p = [math.exp(-mass) * mass**n / math.factorial(n) for n in range(7)]
    exact = by_enumeration(p, components, detect, detections)
    np.testing.assert_allclose(log_evidence, np.log(exact[0]), rtol=1e-9)
    np.testing.assert_allclose(missed, exact[2], rtol=1e-8)
    np.testing.assert_allclose(hits, exact[3], rtol=1e-8)


def test_plain_cphd_with_a_poisson_number_is_the_plain_phd():
    components = two_components(mass=1.5)
    p = [math.exp(-1.5) * 1.5**n / math.factorial(n) for n in range(40)]
    given = model((0.9, 0.6)), CLUTTER, components
    *parts, number, log_evidence = cphd.update(*given, p, DETECTIONS)
    *expected, log_expected = phd.update(*given, DETECTIONS)
    np.testing.assert_allclose(log_evidence, log_expected, rtol=1e-12)
    for found, known in zip(phd.weights(*parts), phd.weights(*expected), strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-12)


def test_plain_particles_are_components_without_width():
    """One particle for each of many points of a Gaussian: nearly the Gaussian."""
    rng = np.random.default_rng(0)
    (w, m, P, _), _ = two_components(mass=1.0)
    states = m + rng.normal(size=(20000, 2)) @ np.linalg.cholesky(P).T
    particles = [(w / len(states), x) for x in states]

    def likelihood(z, x):
        return np.exp(-((z[0] - x[0]) ** 2) / R[0, 0] / 2) / np.sqrt(
            2 * np.pi * R[0, 0]
        )

    def detect(x):
        return 0.9

    p, two = [0.2, 0.5, 0.3], DETECTIONS[:2]
    given = detect, likelihood, CLUTTER, particles
    *_, log_phd = phd.update_particles(*given, two)
    *parts, number, log_cphd = cphd.update_particles(*given, p, two)
    one = model((0.9, 0.9)), CLUTTER, [(w, m, P, 0)]
    *_, expected = phd.update(*one, two)
    *others, known, log_known = cphd.update(*one, p, two)
    # Bounds: the Monte Carlo error of 20000 particles.
    np.testing.assert_allclose([log_phd, log_cphd], [expected, log_known], atol=0.03)
    np.testing.assert_allclose(number, known, atol=0.03)
    for found, right in zip(phd.weights(*parts), phd.weights(*others), strict=True):
        np.testing.assert_allclose(found.sum(0), right[0], atol=0.03)


def test_plain_prediction_of_the_number_is_that_of_all_the_ways():
    found = cphd.predict_cardinality([0.1, 0.2, 0.7, 0, 0], 0.9, [0.6, 0.3, 0.1])
    thinned = np.array([0.1, 0.2, 0.7]) @ [[1, 0, 0], [0.1, 0.9, 0], [0.01, 0.18, 0.81]]
    np.testing.assert_allclose(found, np.convolve(thinned, [0.6, 0.3, 0.1]), rtol=1e-12)
