"""Copies: what clouds are worth after they were drawn from fewer particles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.models import motion, probability, sensor, switching
from jaxtrack.targets import particles
from jaxtrack.types import Gaussian

NUM = 200
WAYS = {
    "prior": particles.particles(NUM, regularise=True),
    "moves": particles.particles(NUM, regularise=True, num_moves=1),
}
PARAMS = particles.Params(
    motions=(motion.ConstantVelocity(np.zeros(1)),),  # so that copies stay copies
    switching=switching.MarkovSwitching(np.ones((1, 1))),
    sensor=sensor.Position(np.array([0.1])),
    survive=probability.Constant(np.array(1.0)),
    detect=probability.Constant(np.array(0.9)),
)


@pytest.mark.parametrize("way", WAYS)
def test_copies_count_once_until_they_move(way):
    target, even = WAYS[way], jnp.log(jnp.array([0.5, 0.5]))

    def stack(*beliefs):
        return jax.tree.map(lambda *x: jnp.stack(x), *beliefs)

    @jax.jit
    def told(keys):
        prior = Gaussian(jnp.zeros(2), jnp.eye(2))
        born = [target.begin(PARAMS, prior, jnp.ones(1), key) for key in keys]
        views = [target.look(PARAMS, x) for x in born]
        detection = jnp.array([1.5])
        first, second = (target.correct(PARAMS, x, detection) for x in views)
        pooled = target.absorb(PARAMS, even, stack(*views), detection)
        alone = target.collapse(jnp.array([0.0, -jnp.inf]), stack(pooled, first))
        joined = target.collapse(even, stack(pooled, first))
        later, _ = target.predict(PARAMS, joined, jnp.array(1.0))
        every = (first, second, pooled, alone, joined, later)
        return [target.effective_size(x) for x in every], later.state

    worth, state = told(jax.random.split(jax.random.key(0)))
    first, second, pooled, alone, joined, later = (float(x) for x in worth)
    np.testing.assert_allclose(pooled, 4 / (1 / first + 1 / second), rtol=1e-9)
    assert pooled < 0.4 * NUM
    np.testing.assert_allclose(alone, pooled, rtol=1e-9)
    np.testing.assert_allclose(joined, 4 / (1 / first + 1 / pooled), rtol=1e-9)
    np.testing.assert_allclose(later, NUM, rtol=1e-9)
    assert len(np.unique(np.array(state), axis=0)) == NUM
