"""Probabilities that depend on mode, state or time."""

import jax
import numpy as np
import pytest

from jaxtrack.models.probability import Constant, InsideDisc, Lifetime, PerMode

STATE = np.array([3.0, 99.0, 4.0, 99.0, 99.0])


@pytest.mark.parametrize(
    ("model", "want"),
    [
        (Constant(0.7), [0.7, 0.7]),
        (PerMode(np.array([0.2, 0.9])), [0.2, 0.9]),
        (Lifetime(20.0), [np.exp(-0.25)] * 2),
        (InsideDisc(0.8, np.zeros(2), 4.0, 0.5), [0.8 / (1 + np.exp(2))] * 2),
        (InsideDisc(0.8, np.array([3.0, 4.0]), 4.0, 0.5), [0.8 / (1 + np.exp(-8))] * 2),
    ],
)
def test_probability_of_each_mode(model, want):
    @jax.jit
    def both(model):
        prob = jax.vmap(model.prob, (0, None, None))(np.arange(2), STATE, 5.0)
        slope = jax.grad(lambda m, x: m.prob(1, x, 5.0), (0, 1))(model, STATE)
        return prob, slope

    prob, slope = both(model)
    np.testing.assert_allclose(prob, want)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))


def test_two_halves_of_an_interval_are_survived_as_the_whole():
    life = Lifetime(20.0)
    half, whole = (life.prob(0, STATE, t) for t in (2.0, 4.0))
    np.testing.assert_allclose(half**2, whole)
    np.testing.assert_array_equal(life.prob(0, STATE, 0.0), 1.0)


def test_a_field_of_view_ends_at_its_rim():
    disc = InsideDisc(0.8, np.array([100.0, 200.0]), 50.0, 2.0)
    states = np.zeros((3, 4))
    states[:, 0], states[:, 2] = 100, [200, 250, 350]
    got = jax.jit(jax.vmap(disc.prob, (None, 0, None)))(0, states, 1.0)
    np.testing.assert_allclose(got, [0.8, 0.4, 0.0], atol=1e-8)
