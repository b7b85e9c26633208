"""Tests of `scenarios.drawn`: what is drawn has the statistics of its models."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models import birth, motion, probability, sensor, switching
from jaxtrack.scenarios import drawn
from jaxtrack.targets import imm, single

RUNS, SCANS = 400, 20
CHANGE = np.array([[0.8, 0.2], [0.5, 0.5]])


def target(survive=0.9):
    return single.Params(
        motion.ConstantVelocity(jnp.array([0.5])),
        sensor.Position(jnp.ones(1)),
        probability.Constant(jnp.array(survive)),
        probability.Constant(jnp.array(0.9)),
    )


def places(of=birth.MultiBernoulliBirth, rate=(0.3, 0.1)):
    mean = jnp.array([[5.0, 1.0], [-5.0, 0.0]])
    cov = jnp.array([[[4.0, 1.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, 0.25]]])
    return of(jnp.array(rate), mean, cov, jnp.ones((2, 1)))


def many(*given, **more):
    keys = jax.random.split(jax.random.key(0), RUNS)
    draw = jax.jit(jax.vmap(lambda key: drawn.draw(key, *given, **more)))
    return jax.tree.map(np.asarray, draw(keys))


def test_births_have_their_rates_places_and_covariances():
    truth = many(target(), places(), jnp.ones(SCANS))
    slots = truth.exists.reshape(RUNS, SCANS, SCANS, 2)
    born = np.stack([slots[:, t, t] for t in range(SCANS)], 1)  # [R, T, B]
    # Four standard errors of a share of 8,000.
    np.testing.assert_allclose(born.mean((0, 1)), [0.3, 0.1], atol=0.021)
    for later in range(1, SCANS):
        assert not slots[:, :later, later].any()
    state = truth.state.reshape(RUNS, SCANS, SCANS, 2, 2)
    first = np.stack([state[:, t, t] for t in range(SCANS)], 1)
    for place, known in enumerate(zip(places().mean, places().cov, strict=True)):
        some = first[:, :, place].reshape(-1, 2)
        # Four standard errors of a mean of 8,000, and of a variance of 4.
        np.testing.assert_allclose(some.mean(0), known[0], atol=0.09)
        np.testing.assert_allclose(np.cov(some.T), known[1], atol=0.26)


def test_lives_are_geometric_and_moves_have_the_noise():
    truth = many(target(), places(), jnp.full(SCANS, 2.0))
    slots = truth.exists[:, :, :2]  # born in the first scan
    alive = slots.sum((0, 2))
    # 160 are born; four standard errors of a share of them.
    np.testing.assert_allclose(alive[5] / alive[0], 0.9**5, atol=0.16)
    assert not (slots[:, 1:] & ~slots[:, :-1]).any()  # nobody rises again
    step = np.array([[1.0, 2.0], [0.0, 1.0]])
    path = truth.state[:, :, :2]
    noise = (path[:, 1:] - path[:, :-1] @ step.T).reshape(-1, 2)
    cov = 0.5 * np.array([[8 / 3, 2.0], [2.0, 2.0]])
    # Four standard errors of a variance of 4/3 from 15,200.
    np.testing.assert_allclose(np.cov(noise.T), cov, atol=0.062)
    np.testing.assert_allclose(truth.time[0], 2.0 * np.arange(1, SCANS + 1))


def test_the_first_come_before_the_scans_and_a_number_may_be_poisson():
    poisson = places(birth.PoissonBirth, rate=(0.5, 0.2))
    truth = many(target(1.0), poisson, jnp.ones(3), start=places(), room=4)
    assert truth.exists.shape == (RUNS, 3, 2 + 3 * 2 * 4)
    # Four standard errors of 400: who was there, all of whom live; who is born.
    np.testing.assert_allclose(truth.exists[:, 0, :2].mean(0), [0.3, 0.1], atol=0.092)
    born = truth.exists[:, 2, 2:].reshape(RUNS, 3, 2, 4).sum(3).mean((0, 1))
    np.testing.assert_allclose(born, [0.5, 0.2], atol=0.082)


def test_modes_switch_as_they_are_told():
    """A mode that is told by how far it moves."""
    near, far = (motion.ConstantVelocity(jnp.array([x])) for x in (1e-6, 1.0))
    params = imm.Params(
        (near, far),
        switching.MarkovSwitching(jnp.array(CHANGE)),
        *target(1.0)[1:],
    )
    start = places()._replace(mode_prob=jnp.array([[1.0, 0.0], [0.0, 1.0]]))
    always = start._replace(existence_prob=jnp.ones(2))
    never = start._replace(existence_prob=jnp.zeros(2))
    truth = many(params, never, jnp.ones(SCANS), start=always)
    path = truth.state[:, :, :2]
    step = np.array([[1.0, 1.0], [0.0, 1.0]])
    off = np.abs(path[:, 1:] - path[:, :-1] @ step.T)[..., 1]
    mode = (off > 0.01).astype(int)  # far moves less in one case of 125
    for before, row in enumerate(CHANGE):
        after = mode[:, 1:][mode[:, :-1] == before]
        # Four standard errors of 4,000, and the cases of 125.
        np.testing.assert_allclose(after.mean(), row[1], atol=0.04)
