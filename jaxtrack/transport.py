"""Resampling by optimal transport: new particles are averages of old ones.

The plan that carries the weighted particles to equally weighted ones at the least cost,
with an entropy added, is smooth in weights and states, and so are the averages that it
takes. Particles go nowhere but within their mode; each mode keeps its weight.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import transport
    >>> from jaxtrack.particle import Particles
    >>> two = Particles(jnp.log(jnp.array([0.75, 0.25])), jnp.array([[1.0], [2.0]]),
    ...                 jnp.zeros(2, int))
    >>> new = transport.transport(epsilon=0.01)(jax.random.key(0), two, size=2, num=2)
    >>> print(new.state[:, 0].round(2), jnp.exp(new.log_weight))
    [1.  1.5] [0.5 0.5]

The mean is kept as far as Sinkhorn's iteration has settled, the cloud shrinks, the more
the larger `epsilon` is. The cost is that of `num_steps` passes over [P, size].

References: Corenflos, Thornton, Deligiannidis and Doucet, "Differentiable particle
filtering via entropy-regularized optimal transport", ICML 2021; Cuturi, "Sinkhorn
distances", NIPS 2013.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.special import logsumexp

from jaxtrack import mixture, resampling
from jaxtrack.particle import Particles
from jaxtrack.types import Array


@functools.cache
def transport(epsilon: float = 0.1, num_steps: int = 50) -> resampling.Scheme:
    """Makes a scheme for `jaxtrack.resampling` that transports.

    Args:
        epsilon: Weight of the entropy, relative to the mean squared distance of a
            component from the mean.
        num_steps: Of Sinkhorn's iteration.

    Raises:
        ValueError: A number that makes no sense.
    """
    if not epsilon > 0:
        raise ValueError(f"epsilon is {epsilon}; give a number above 0, e.g. 0.1")
    if num_steps < 1:
        raise ValueError(f"num_steps is {num_steps}; give at least 1")
    return functools.partial(_resample, epsilon, num_steps)


def _resample(
    epsilon: float,
    num_steps: int,
    key: Array,
    particles: Particles,
    size: int,
    num: Any,
) -> Particles:
    """Carries to the places of particles that are picked evenly."""
    log_weight = mixture.log_normalise(particles.log_weight)
    filled = particles.log_weight > -jnp.inf
    equal = resampling.even(filled, log_weight.dtype)
    index = resampling.systematic_index(key, equal, size, num)
    mode = particles.mode[index]
    there = (jnp.arange(size) < num) & filled[index]
    same = (particles.mode[:, None] == mode[None]) & filled[:, None] & there[None]
    alike = (mode[:, None] == mode[None]) & there[None]

    # A slot has its mode's weight, shared out; modes without a slot are left out.
    weight = jnp.exp(log_weight)
    shared = jnp.where(same, weight[:, None], 0.0).sum(0) / jnp.maximum(alike.sum(1), 1)
    log_slot = jnp.where(
        shared > 0, jnp.log(jnp.where(shared > 0, shared, 1.0)), -jnp.inf
    )
    cost = _cost(weight, particles.state, particles.state[index])
    cost = jnp.where(same, cost, jnp.inf)
    plan = _plan(epsilon, num_steps, log_weight, log_slot, cost)
    state = jnp.matmul(plan.T, particles.state, precision=jax.lax.Precision.HIGHEST)
    state = jnp.where(there[:, None], state, particles.state[index])
    log_new = jnp.where(filled.any(), mixture.log_normalise(log_slot), -jnp.inf)
    return Particles(log_new, state, mode)


def _cost(weight: Array, state: Array, place: Array) -> Array:
    """Returns squared distances, each component in its own spread, [P, size]."""
    fixed = jax.lax.stop_gradient((weight, state))
    mean = (fixed[0][:, None] * fixed[1]).sum(0)
    gap = fixed[1] - mean[None]
    variance = (fixed[0][:, None] * gap * gap).sum(0)
    scale = jnp.where(
        variance > 0, jnp.sqrt(jnp.where(variance > 0, variance, 1.0)), 1.0
    )
    apart = (state[:, None] - place[None]) / scale[None, None]
    return (apart * apart).mean(2)


def _plan(
    epsilon: float, num_steps: int, log_row: Array, log_column: Array, cost: Array
) -> Array:
    """Returns what each column takes from each row, [P, size]; columns sum to one.

    The entropy starts as large as the cost and is halved from step to step.
    """

    def balance(log_share: Array, price: Array, cost: Array, width: Array) -> Array:
        """Returns the price of each row that makes up its sum, 0 where it has none."""
        log_each = log_share[None] + (price[None] - cost) / width
        empty = jnp.all(log_each == -jnp.inf, axis=1)
        safe = jnp.where(empty[:, None], 0.0, log_each)
        return jnp.where(empty, 0.0, -width * logsumexp(safe, axis=1))

    def step(price: Array, width: Array) -> tuple[Array, None]:
        row = balance(log_column, price, cost, width)
        return balance(log_row, row, cost.T, width), None

    largest = jnp.where(cost < jnp.inf, cost, 0.0).max()
    halved = jax.lax.stop_gradient(largest) * jnp.exp2(
        -jnp.arange(num_steps, dtype=cost.dtype)
    )
    widths = jnp.maximum(halved, epsilon).at[-1].set(epsilon)
    price, _ = jax.lax.scan(step, jnp.zeros_like(log_column), widths)
    row = balance(log_column, price, cost, widths[-1])
    price = balance(log_row, row, cost.T, widths[-1])
    return jnp.exp(log_row[:, None] + (row[:, None] + price[None] - cost) / epsilon)
