"""Gates: quantiles against SciPy, volumes by counting, and what passes them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from cases import two_sensors
from cases.lines import scans_of
from cases.targets import array, case_of, value

from jaxtrack import engine, gate
from jaxtrack.targets import single
from jaxtrack.trackers import cbmember, cphd, phd
from jaxtrack.types import Scan

KEY = jax.random.key(0)


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


def scores_of(name, max_scored):
    """Two tracks and eight detections, two of them empty slots at the centre."""
    case = case_of(name)
    rng = np.random.default_rng(6)
    detections = case.centre + rng.uniform(-1, 1, (8, case.centre.size)) * case.reach
    detections[:2] = case.centre
    scan = Scan(detections, np.arange(8) > 1, value(1.0))

    @jax.jit
    def find(params, prior, mode_prob):
        keys = jax.random.split(jax.random.key(0), 2)
        begin = functools.partial(case.target.begin, params, prior, mode_prob)
        views = jax.vmap(functools.partial(case.target.look, params))(
            jax.vmap(begin)(keys)
        )
        log_miss = jnp.log(array(0.2, 0.9))
        square, log_det = jax.vmap(case.target.distance, (None, 0, None))(
            params, views, detections
        )
        every = gate.scores(case.target, params, views, log_miss, scan)
        some = gate.scores(case.target, params, views, log_miss, scan, max_scored)
        return every, some, -(square + log_det) / 2, log_miss

    return jax.tree.map(np.array, find(case.params, case.prior, case.mode_prob))


@pytest.mark.parametrize("name", ["mixture", "single_ekf"])
def test_near_detections_are_scored_in_full_and_far_ones_by_moments(name):
    every, some, log_near, log_miss = scores_of(name, 3)
    unit = np.log(2 * np.pi) * case_of(name).centre.size / 2
    rough = log_near - unit + np.log(1 - np.exp(log_miss))[:, None]
    order = 2 + np.argsort(-log_near[:, 2:], axis=1)
    for track in range(2):
        near, far = order[track, :3], [*order[track, 3:], 0, 1]
        np.testing.assert_allclose(some[track, near], every[track, near], rtol=1e-12)
        np.testing.assert_allclose(some[track, far], rough[track, far], rtol=1e-9)
    assert not np.isclose(every, rough).all()


def test_enough_scores_are_all_scores():
    every, some, _, _ = scores_of("mixture", 8)
    np.testing.assert_array_equal(some, every)
    with pytest.raises(ValueError, match="max_scored is 0"):
        gate.check_scored(0)


@pytest.mark.parametrize("maker", [phd.phd, cphd.cphd, cbmember.cbmember])
def test_trackers_score_no_more_detections_than_they_are_told(maker):
    scored, target = [], single.single()

    def score(params, view, detections):
        scored.append(len(detections))
        return target.score(params, view, detections)

    tracker = maker(target._replace(score=score), max_scored=2)
    scene = two_sensors.scene(np.random.default_rng(0), count=two_sensors.SLOTS)
    scan = scans_of([scene.z[0]], 5, 1.0)
    params = two_sensors.alone(two_sensors.params_of(scene))
    jax.eval_shape(functools.partial(engine.run, tracker), params, scan, KEY)
    assert set(scored) == {2}


@pytest.mark.parametrize("prob", [0.0, -1.0, 1.5, float("nan")])
def test_a_probability_that_no_gate_has(prob):
    with pytest.raises(ValueError, match=f"gate_prob is {prob}"):
        gate.check(prob)
