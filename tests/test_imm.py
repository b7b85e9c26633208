"""Tests of jaxtrack.imm against the equations, FilterPy, and the edge cases."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from jax.test_util import check_grads
from reference import imm as book

from jaxtrack import imm, mixture
from jaxtrack.types import Affine, Mixture

mix = jax.jit(imm.mix)


def apart(models):
    """Affine models in one stack, [M, ...], one by one."""
    return [jax.tree.map(lambda x, n=n: x[n], models) for n in range(len(models.cov))]


@jax.jit
def predict(bank, motions):
    return imm.predict(bank, apart(motions))


@functools.partial(jax.jit, static_argnames="residual")
def update(bank, sensors, detection, residual=jnp.subtract):
    return imm.update(bank, apart(sensors), detection, residual)


collapse = jax.jit(mixture.collapse)


def random_cov(rng, *shape):
    root = rng.normal(size=shape)
    return root @ np.swapaxes(root, -1, -2) + np.eye(shape[-1])


def random_bank(seed, num_modes=3, dim=4):
    """A bank and a transition matrix with no symmetry that could hide a transpose."""
    rng = np.random.default_rng(seed)
    bank = Mixture(
        log_weight=jnp.log(rng.dirichlet(np.ones(num_modes))),
        mean=jnp.asarray(rng.normal(size=(num_modes, dim))),
        cov=jnp.asarray(random_cov(rng, num_modes, dim, dim)),
    )
    return bank, jnp.log(rng.dirichlet(np.ones(num_modes), size=num_modes))


def random_models(seed, num_modes=3, dim=4, num_outputs=2):
    """A motion and a sensor for each mode, none alike."""
    rng = np.random.default_rng(seed)
    motions = Affine(
        matrix=rng.normal(size=(num_modes, dim, dim)),
        offset=rng.normal(size=(num_modes, dim)),
        cov=random_cov(rng, num_modes, dim, dim),
    )
    sensors = Affine(
        matrix=rng.normal(size=(num_modes, num_outputs, dim)),
        offset=rng.normal(size=(num_modes, num_outputs)),
        cov=random_cov(rng, num_modes, num_outputs, num_outputs),
    )
    return jax.tree.map(jnp.asarray, (motions, sensors))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("num_modes", "dim"), [(1, 2), (2, 1), (3, 4)])
def test_mix_follows_the_equations(seed, num_modes, dim):
    bank, log_p = random_bank(seed, num_modes, dim)
    c, m0, p0 = book.mix(
        (np.exp(bank.log_weight), np.array(bank.mean), np.array(bank.cov)),
        np.exp(log_p),
    )
    expected = Mixture(jnp.log(c), jnp.asarray(m0), jnp.asarray(p0))
    chex.assert_trees_all_close(mix(bank, log_p), expected, rtol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_mix_moves_belief_but_makes_none(seed):
    bank, log_p = random_bank(seed)
    before, after = collapse(bank), collapse(mix(bank, log_p))
    chex.assert_trees_all_close(after, before, rtol=1e-10)


def test_mix_without_switching_changes_nothing():
    bank, _ = random_bank(0)
    never = jnp.log(jnp.eye(3))
    chex.assert_trees_all_close(mix(bank, never), bank, rtol=1e-10)


def test_mode_that_cannot_be_entered_stays_finite():
    bank, _ = random_bank(0, num_modes=2, dim=2)
    log_p = jnp.log(jnp.array([[1.0, 0.0], [1.0, 0.0]]))

    @jax.jit
    @jax.value_and_grad
    def total(arguments):
        mixed = imm.mix(*arguments)
        return mixed.mean.sum() + mixed.cov.sum()

    assert imm.mix(bank, log_p).log_weight[1] == -jnp.inf
    chex.assert_tree_all_finite(total((bank, log_p)))


def test_mix_has_correct_gradients():
    check_grads(mix, random_bank(0, num_modes=2, dim=2), order=1, modes=["rev"])


def test_mix_batches_over_runs_and_traces_once():
    banks, log_p = jax.tree.map(lambda *x: jnp.stack(x), *map(random_bank, range(4)))
    batched = jax.jit(jax.vmap(chex.assert_max_traces(imm.mix, n=1)))
    for _ in range(2):
        result = batched(banks, log_p)
    one_by_one = [mix(*random_bank(seed)) for seed in range(4)]
    expected = jax.tree.map(lambda *x: jnp.stack(x), *one_by_one)
    chex.assert_trees_all_close(result, expected, rtol=1e-10)


def test_mix_names_the_shape_it_wanted():
    bank, log_p = random_bank(0)
    with pytest.raises(AssertionError, match=r"\(2, 3\) but expected \(3, 3\)"):
        imm.mix(bank, log_p[:2])


def filterpy_estimator(bank, log_p, motions, sensors):
    """FilterPy's IMM; it takes p[i, j] as i to j, whatever its documentation says."""
    filters = []
    for n in range(len(bank.mean)):
        one = KalmanFilter(dim_x=bank.mean.shape[1], dim_z=sensors.offset.shape[1])
        one.x, one.P = np.array(bank.mean[n]), np.array(bank.cov[n])
        one.F, one.Q = np.array(motions.matrix[n]), np.array(motions.cov[n])
        one.H, one.R = np.array(sensors.matrix[n]), np.array(sensors.cov[n])
        filters.append(one)
    return IMMEstimator(filters, np.exp(bank.log_weight), np.exp(log_p))


@pytest.mark.parametrize("seed", range(3))
def test_cycle_agrees_with_filterpy(seed):
    bank, log_p = random_bank(seed)
    motions, sensors = (
        model._replace(offset=jnp.zeros_like(model.offset))
        for model in random_models(seed)
    )
    # Motions that grow without bound would cost both their digits.
    motions = motions._replace(matrix=motions.matrix / 2)
    peer = filterpy_estimator(bank, log_p, motions, sensors)
    asymmetry = jnp.abs(jnp.exp(log_p) - jnp.exp(log_p).T).max()
    assert asymmetry > 0.1
    for detection in np.random.default_rng(seed).normal(size=(6, 2)) * 2:
        bank = predict(mix(bank, log_p), motions)
        bank, log_density = update(bank, sensors, jnp.asarray(detection))
        peer.predict()
        entered = peer.cbar.copy()
        peer.update(detection)
        density = entered @ peer.likelihood
        np.testing.assert_allclose(log_density, np.log(density), rtol=1e-9)
        means = np.array([one.x for one in peer.filters])
        covs = np.array([one.P for one in peer.filters])
        np.testing.assert_allclose(jnp.exp(bank.log_weight), peer.mu, rtol=1e-9)
        np.testing.assert_allclose(bank.mean, means, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(bank.cov, covs, rtol=1e-9, atol=1e-12)
        whole = collapse(bank)
        np.testing.assert_allclose(whole.mean, peer.x, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(whole.cov, peer.P, rtol=1e-9, atol=1e-12)


def test_predict_moves_each_mode_by_its_own_motion():
    bank, _ = random_bank(1)
    motions, _ = random_models(1)
    moved = predict(bank, motions)
    for n in range(3):
        matrix, offset, noise = (np.array(x[n]) for x in motions)
        np.testing.assert_allclose(moved.mean[n], matrix @ bank.mean[n] + offset)
        cov = matrix @ np.array(bank.cov[n]) @ matrix.T + noise
        np.testing.assert_allclose(moved.cov[n], cov, rtol=1e-12)
    np.testing.assert_array_equal(moved.log_weight, bank.log_weight)


def test_update_needs_no_normalised_bank():
    bank, _ = random_bank(2)
    _, sensors = random_models(2)
    detection = jnp.array([0.3, -1.2])
    scaled = bank._replace(log_weight=bank.log_weight - 5)
    chex.assert_trees_all_close(
        update(scaled, sensors, detection), update(bank, sensors, detection), rtol=1e-10
    )


def test_update_uses_the_residual():
    bank, _ = random_bank(3)
    _, sensors = random_models(3)
    detection = jnp.array([0.3, -1.2])

    def turned(detection, expected):
        return detection - expected - 2 * jnp.pi

    chex.assert_trees_all_close(
        update(bank, sensors, detection + 2 * jnp.pi, turned),
        update(bank, sensors, detection),
        rtol=1e-10,
    )


def test_update_with_impossible_mode_has_finite_gradients():
    bank, _ = random_bank(4, num_modes=2, dim=2)
    bank = bank._replace(log_weight=jnp.array([0.0, -jnp.inf]))
    _, sensors = random_models(4, num_modes=2, dim=2)

    @jax.jit
    @jax.value_and_grad
    def loss(arguments):
        posterior, log_density = update(*arguments)
        return log_density + collapse(posterior).mean.sum()

    chex.assert_tree_all_finite(loss((bank, sensors, jnp.array([0.1, 0.4]))))


def test_a_mode_that_one_detection_rules_out_can_come_back():
    """Log-weights hundreds of nats apart are kept, not rounded to nothing."""
    bank = Mixture(jnp.log(jnp.array([0.5, 0.5])), jnp.array([[0.0], [50.0]]), ONE)
    sensors = Affine(ONE, jnp.zeros((2, 1)), ONE)
    log_total = 0.0
    for z in (0.0, 75.0):
        bank, log_density = update(bank, sensors, jnp.array([z]))
        log_total += log_density
    gap = np.diff(np.asarray(bank.log_weight))[0]
    # Sum of both surprises in each mode: N(z; 0, 2), then N(z; z/2, 1.5).
    first = -(50.0**2) / 4 - (-0.0)
    second = -((75 - 25) ** 2) / 3 + (75.0 - 0.0) ** 2 / 3
    np.testing.assert_allclose(gap, first + second, rtol=1e-12)
    assert np.isfinite(log_total)


def test_predict_wants_a_motion_for_each_mode():
    bank, _ = random_bank(1)
    motions, _ = random_models(1)
    with pytest.raises(ValueError, match="shorter"):
        imm.predict(bank, apart(motions)[:2])


ONE = jnp.ones((2, 1, 1))
