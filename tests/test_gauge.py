"""Distances from a bank of modes, and its blending, against plain loops."""

import functools

import jax
import numpy as np
import pytest
from cases.targets import array, imm_nonlinear_case, linear_case, value

from jaxtrack.targets import blending, gauge, imm, mixture

KEY = jax.random.key(0)
CASES = {
    "linear": functools.partial(linear_case, imm.imm()),
    "radar": imm_nonlinear_case,
}


@functools.cache
def seen(name, yardstick="mixture", blend=blending.by_mixture):
    """A predicted bank, how it is seen, and what the verbs make of it."""
    case = CASES[name]()
    target = imm.imm(yardstick=yardstick, blend=blend)
    rng = np.random.default_rng(3)
    gap = rng.uniform(-0.1, 0.1, (5, case.centre.size)) * case.reach
    detections = case.centre + gap
    log_weight = np.log(array(0.1, 0.3, 0.05, 0.2, 0.15, 0.2))

    @jax.jit
    def verbs(params, prior, mode_prob):
        bank = target.begin(params, prior, mode_prob, KEY)
        bank, _ = target.predict(params, bank, value(0.75))
        view = target.look(params, bank)
        missed, _ = target.miss(params, bank)
        distance = target.distance(params, view, detections)
        blended = target.blend(params, view, missed, log_weight, detections)
        return bank, view, distance, blended, missed

    told = verbs(case.params, case.prior, case.mode_prob)
    return jax.tree.map(np.array, (detections, *told)), np.exp(log_weight)


def innovations(view):
    """Expected detection and innovation covariance of every mode."""
    sights = view.modes.sight
    lower = np.linalg.inv(np.array(sights.whitening))
    return sights.expected, lower @ lower.transpose(0, 2, 1)


def by_hand(expected, covs, weight):
    """Moments of a mixture of detections, angles near one another."""
    mean = sum(w * z for w, z in zip(weight, expected, strict=True))
    cov = sum(
        w * (s + np.outer(z - mean, z - mean))
        for w, s, z in zip(weight, covs, expected, strict=True)
    )
    return mean, cov


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("yardstick", gauge.YARDSTICKS)
def test_distances_by_hand(name, yardstick):
    (detections, _, view, (square, log_det), _, _), _ = seen(name, yardstick)
    expected, covs = innovations(view)
    weight = np.exp(view.log_weight) / np.exp(view.log_weight).sum()
    if yardstick == "mixture":
        mean, cov = by_hand(expected, covs, weight)
    else:
        widest = np.argmax([np.linalg.det(s) for s in covs])
        mean, cov = expected[widest], covs[widest]
    for z, found in zip(detections, square, strict=True):
        np.testing.assert_allclose(
            found, (z - mean) @ np.linalg.inv(cov) @ (z - mean), rtol=1e-9
        )
    np.testing.assert_allclose(log_det, np.log(np.linalg.det(cov)), rtol=1e-9)


def test_a_mixture_measures_as_the_bank_it_equals():
    case = CASES["linear"]()
    alike = mixture.mixture(max_components=2, merge_threshold=0.0)
    found = []
    for target in (alike, imm.imm()):

        @jax.jit
        def distance(params, prior, mode_prob, target=target):
            born = target.begin(params, prior, mode_prob, KEY)
            return target.distance(
                params, target.look(params, born), case.centre[None] + 1.0
            )

        found.append(distance(case.params, case.prior, case.mode_prob))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)


@pytest.mark.parametrize("name", CASES)
def test_modes_by_the_average_residual(name):
    """Gomes' Table 5, steps 2 and 3, as loops."""
    told, weight = seen(name, blend=blending.by_residual)
    detections, bank, view, _, blended, _ = told
    expected, covs = innovations(view)
    beta = weight / weight.sum()
    mode_weight = np.zeros(2)
    for i in range(2):
        gain = np.array(view.modes.sight.gain)[i]
        residuals = [z - expected[i] for z in detections]
        average = sum(b * r for b, r in zip(beta, residuals, strict=False))
        inverse = np.linalg.inv(covs[i])
        density = np.exp(-average @ inverse @ average / 2)
        density /= np.sqrt(np.linalg.det(2 * np.pi * covs[i]))
        mode_weight[i] = np.exp(view.log_weight[i]) * density
        spread = sum(b * np.outer(r, r) for b, r in zip(beta, residuals, strict=False))
        spread = spread - np.outer(average, average)
        cov = bank.cov[i] - (1 - beta[-1]) * gain @ covs[i] @ gain.T
        cov = cov + gain @ spread @ gain.T
        np.testing.assert_allclose(
            blended.mean[i], bank.mean[i] + gain @ average, rtol=1e-9
        )
        np.testing.assert_allclose(blended.cov[i], cov, rtol=1e-8)
    found = np.exp(blended.log_weight)
    np.testing.assert_allclose(found, mode_weight / mode_weight.sum(), rtol=1e-9)


def test_both_ways_agree_on_one_certain_detection():
    case = CASES["linear"]()
    log_weight = array(0.0, -np.inf, -np.inf)
    found = []
    for way in (blending.by_mixture, blending.by_residual):
        target = imm.imm(blend=way)

        @jax.jit
        def blend(params, prior, mode_prob, target=target):
            born = target.begin(params, prior, mode_prob, KEY)
            bank, _ = target.predict(params, born, value(0.75))
            view, (missed, _) = target.look(params, bank), target.miss(params, bank)
            near = case.centre[None] + array(0.4, 9.0)[:, None]
            return target.blend(params, view, missed, log_weight, near)

        found.append(blend(case.params, case.prior, case.mode_prob))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_a_yardstick_that_there_is_not():
    for maker in (imm.imm, mixture.mixture):
        with pytest.raises(ValueError, match="yardstick is 'widest'"):
            maker(yardstick="widest")
