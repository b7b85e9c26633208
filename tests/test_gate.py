"""Gates: quantiles against SciPy, volumes by counting, and what passes them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from cases.targets import array, case_of, value

from jaxtrack import gate
from jaxtrack.types import Scan


@pytest.mark.parametrize("size", range(1, 8))
@pytest.mark.parametrize("prob", [1e-4, 0.5, 0.9, 0.999, 1 - 1e-9])
def test_thresholds_are_chi_square_quantiles(prob, size):
    expected = scipy.stats.chi2.ppf(prob, size)
    np.testing.assert_allclose(gate.threshold(prob, size), expected, rtol=1e-6)


def test_no_gate_lets_everything_in():
    assert gate.threshold(1.0, 3) == np.inf


@pytest.mark.parametrize("size", [1, 2, 3])
def test_volume_by_counting(size):
    cov = np.diag(np.arange(1.0, size + 1)) + 0.3
    limit, reach = 2.0, 4.0
    points = np.random.default_rng(0).uniform(-reach, reach, (200_000, size))
    square = np.einsum("nd,de,ne->n", points, np.linalg.inv(cov), points)
    counted = (square <= limit).mean() * (2 * reach) ** size
    found = gate.log_volume(jnp.log(np.linalg.det(cov)), limit, size)
    np.testing.assert_allclose(np.exp(found), counted, rtol=0.03)


def gates_of(name, gate_prob):
    case = case_of(name)
    rng = np.random.default_rng(5)
    detections = case.centre + rng.uniform(-1, 1, (400, case.centre.size)) * case.reach
    valid = np.arange(400) != 7

    @jax.jit
    def find(params, prior, mode_prob):
        born = case.target.begin(params, prior, mode_prob, jax.random.key(0))
        view = case.target.look(params, born)
        views = jax.tree.map(lambda x: x[None], view)
        scan = Scan(detections, valid, value(1.0))
        square, log_det = case.target.distance(params, view, detections)
        gates = gate.validate(case.target, params, views, scan, gate_prob)
        return gates, square, log_det

    return jax.tree.map(np.array, find(case.params, case.prior, case.mode_prob)), valid


@pytest.mark.parametrize("name", ["single_ekf", "imm", "mixture"])
def test_what_is_near_is_inside(name):
    (gates, square, log_det), valid = gates_of(name, 0.9)
    size = case_of(name).centre.size
    limit = scipy.stats.chi2.ppf(0.9, size)
    np.testing.assert_array_equal(gates.inside[0], (square <= limit) & valid)
    assert 0 < gates.inside.sum() < valid.sum()
    volume = gate.log_volume(log_det[0], limit, size)
    np.testing.assert_allclose(gates.log_volume, [volume], rtol=1e-6)


def test_a_gate_of_one_holds_all_that_is_valid():
    (gates, _, _), valid = gates_of("single_ekf", 1.0)
    np.testing.assert_array_equal(gates.inside[0], valid)


def test_missed_or_outside():
    missed = gate.log_missed(jnp.log(array(0.1, 1.0, 1e-30)), 0.9)
    np.testing.assert_allclose(np.exp(missed), [1 - 0.9 * 0.9, 1.0, 0.1], rtol=1e-12)
    slope = jax.grad(lambda x: gate.log_missed(x, 0.9))(jnp.log(value(0.1)))
    np.testing.assert_allclose(slope, 0.9 * 0.1 / 0.19, rtol=1e-12)
    assert gate.log_missed(value(-np.inf), 1.0) == -np.inf


def test_clutter_is_what_the_gates_hold():
    inside = np.array([[True, True, False], [False, True, False], [False] * 3])
    volume = np.log(
        array(2.0, 6.0, 0.0), where=array(1, 1, 0) > 0, out=np.full(3, -np.inf)
    )
    density = functools.partial(gate.log_clutter_density)
    np.testing.assert_allclose(density(gate.Gates(inside, volume)), np.log(2 / 8))
    nobody = gate.Gates(np.zeros((2, 3), bool), np.full(2, -np.inf))
    assert np.isfinite(density(nobody))


@pytest.mark.parametrize("prob", [0.0, -1.0, 1.5, float("nan")])
def test_a_probability_that_no_gate_has(prob):
    with pytest.raises(ValueError, match=f"gate_prob is {prob}"):
        gate.check(prob)
