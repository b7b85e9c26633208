"""Resampling: how many copies, how they vary, and what happens at the edges."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import particle, resampling, transport
from jaxtrack.particle import Particles

INDEX = {
    "systematic": resampling.systematic_index,
    "stratified": resampling.stratified_index,
    "residual": resampling.residual_index,
    "multinomial": resampling.multinomial_index,
}
SCHEMES = {
    "systematic": resampling.systematic,
    "stratified": resampling.stratified,
    "residual": resampling.residual,
    "multinomial": resampling.multinomial,
    "soft": resampling.soft(0.5),
    "soft, all": resampling.soft(1.0),
    "transport": transport.transport(0.1),
}
NUM, RUNS = 12, 4000
every_index = pytest.mark.parametrize("name", INDEX)
every_scheme = pytest.mark.parametrize("name", SCHEMES)


def weights(seed=0, num=8):
    return np.random.default_rng(seed).gamma(0.6, size=num)


@functools.cache
def copies(name):
    """How often each of 8 particles is taken in each run, [runs, 8]."""
    log_weight = jnp.log(jnp.array(weights()))

    def one(key):
        index = INDEX[name](key, log_weight, NUM, NUM)
        return (index[:, None] == jnp.arange(len(log_weight))[None]).sum(0)

    return np.array(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), RUNS)))


@every_index
def test_copies_are_expected_in_proportion_to_the_weight(name):
    count = copies(name)
    share = weights() / weights().sum() * NUM
    error = count.mean(0) - share
    spread = count.std(0) / np.sqrt(RUNS) + 1e-9
    assert (np.abs(error / spread) < 4.5)[count.std(0) > 0].all()
    np.testing.assert_array_equal(count.sum(1), NUM)


@every_index
def test_what_is_certain_is_certain(name):
    """All but multinomial keep at least the whole part of the expected copies."""
    share = weights() / weights().sum() * NUM
    least = np.zeros_like(share) if name == "multinomial" else np.floor(share)
    if name == "stratified":
        least = least - 1  # a stratum may straddle either edge
    assert (copies(name) >= least).all()
    if name == "systematic":
        assert (copies(name) <= np.floor(share) + 1).all()


def test_copies_vary_least_with_the_most_even_scheme():
    """Whole parts are sure and strata shared; no order holds of every estimate."""
    spread = {name: copies(name).var(0).sum() for name in INDEX}
    assert spread["systematic"] < spread["stratified"] < 0.8 * spread["multinomial"]
    assert spread["residual"] < 0.8 * spread["multinomial"]


def some(log_weight, dtype=float):
    log_weight = jnp.asarray(log_weight, dtype)
    state = jnp.arange(2.0 * log_weight.size, dtype=dtype).reshape(-1, 2)
    return Particles(log_weight, state, jnp.arange(log_weight.size) % 2)


@functools.cache
def compiled(name, num):
    scheme = SCHEMES[name]
    return jax.jit(lambda key, given: scheme(key, given, 16, num))


def drawn(name, log_weight, num=16, dtype=float):
    given = some(log_weight, dtype)
    return given, compiled(name, num)(jax.random.key(3), given)


@every_scheme
def test_empty_slots_stay_out_and_surplus_slots_are_empty(name):
    log_weight = np.log(weights(1))
    log_weight[[0, 3, 7]] = -np.inf
    given, new = drawn(name, log_weight, num=11)
    filled = np.isfinite(new.log_weight)
    np.testing.assert_array_equal(filled, np.arange(16) < 11)
    np.testing.assert_allclose(np.exp(new.log_weight).sum(), 1, rtol=1e-9)
    assert np.isfinite(new.state).all()
    if name != "transport":
        taken = (np.array(new.state)[:11, 0] / 2).astype(int)
        assert not set(taken) & {0, 3, 7}
        np.testing.assert_array_equal(np.array(given.mode)[taken], new.mode[:11])


@every_scheme
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_one_that_is_alive_is_all_there_is(name, dtype):
    alone = np.where(np.arange(8) == 5, -700.0, -np.inf)
    given, new = drawn(name, alone, dtype=dtype)
    assert new.log_weight.dtype == dtype
    np.testing.assert_allclose(
        new.state, given.state[5:6] + np.zeros((16, 1)), rtol=1e-6
    )
    np.testing.assert_allclose(np.exp(new.log_weight), 1 / 16, rtol=1e-6)


@every_scheme
def test_nobody_stays_nobody(name):
    _, new = drawn(name, np.full(8, -np.inf))
    assert np.isneginf(new.log_weight).all()
    assert np.isfinite(new.state).all()


@every_index
def test_tiny_weights_lose_nothing_but_their_scale(name):
    log_weight = jnp.log(jnp.array(weights()))
    index = jax.jit(functools.partial(INDEX[name], size=NUM, num=NUM))
    plain, tiny = (
        index(jax.random.key(1), x) for x in (log_weight, log_weight - 690.7)
    )
    np.testing.assert_array_equal(plain, tiny)


@pytest.mark.parametrize("name", ["soft", "soft, all", "transport"])
def test_schemes_with_derivatives_keep_the_mean_and_pass_it_on(name):
    """The mean after is, on average over keys, the mean before; so are its slopes."""
    log_weight = jnp.log(jnp.array(weights(2)))
    given = some(log_weight)._replace(mode=jnp.zeros(8, int))
    scheme = SCHEMES[name]

    def before(log_weight):
        return particle.moments(given._replace(log_weight=log_weight)).mean[0]

    def after(log_weight, key):
        new = scheme(key, given._replace(log_weight=log_weight), 8, 8)
        return particle.moments(new).mean[0]

    slopes = jax.vmap(jax.value_and_grad(after), (None, 0))
    keys = jax.random.split(jax.random.key(0), 2000)
    value, slope = jax.jit(slopes)(
        log_weight, keys[: 2 if name == "transport" else None]
    )
    expected, expected_slope = jax.jit(jax.value_and_grad(before))(log_weight)
    spread = value.std() / np.sqrt(len(value))
    assert abs(value.mean() - expected) < 4 * spread + 0.05
    error = np.array(slope.mean(0) - expected_slope)
    # Soft weights are normalised: a ratio, which is biased by the order of 1 / L.
    assert np.abs(error).max() < 0.25 * np.abs(expected_slope).max()


def test_transport_keeps_modes_apart():
    log_weight = np.log(weights(3))
    given = some(log_weight)._replace(mode=(jnp.arange(8) % 3 == 0).astype(int))
    new = transport.transport(0.05)(jax.random.key(0), given, 8, 8)
    before, after = (particle.mode_prob(x, 2) for x in (given, new))
    np.testing.assert_allclose(after, before, rtol=1e-9)
    for mode in (0, 1):
        old = np.array(given.state)[np.array(given.mode) == mode, 0]
        states = np.array(new.state)[np.array(new.mode) == mode, 0]
        assert old.min() - 1e-9 <= states.min() <= states.max() <= old.max() + 1e-9


def test_effective_size_counts_equal_weights():
    log_weight = jnp.log(jnp.array([0.25, 0.25, 0.25, 0.25, 0.0])) - 1e3
    np.testing.assert_allclose(particle.effective_size(log_weight), 4, rtol=1e-12)
    assert particle.effective_size(jnp.full(3, -jnp.inf)) == 0
    uneven = jnp.log(jnp.array([0.5, 0.3, 0.2]))
    np.testing.assert_allclose(particle.effective_size(uneven), 1 / 0.38, rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: resampling.soft(0.0), "share is 0.0"),
        (lambda: resampling.soft(1.5), "share is 1.5"),
        (lambda: transport.transport(0.0), "epsilon is 0.0"),
        (lambda: transport.transport(0.1, 0), "num_steps is 0"),
    ],
)
def test_settings_are_checked(make, word):
    with pytest.raises(ValueError, match=word):
        make()


@pytest.mark.parametrize("num", [10, 49, 500, 1000])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_residual_keeps_everybody_where_all_weigh_the_same(num, dtype):
    """Whole parts of exactly one, which rounding must not turn into chance."""
    index = resampling.residual_index(
        jax.random.key(0), jnp.full(num, -3.0, dtype), num, num
    )
    np.testing.assert_array_equal(index, np.arange(num))
