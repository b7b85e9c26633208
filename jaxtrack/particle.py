"""Weighted particles with modes: what a belief made of samples is worth.

    log_weight, log_total = reweight(log_weight, log_factor)
    particles = resampling.systematic(key, particles, size, num)

`jaxtrack.resampling` has the ways to draw new particles from old. An empty slot has
log-weight -inf and finite values behind it.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import particle
    >>> log_weight = jnp.log(jnp.array([0.5, 0.5, 0.0]))
    >>> print(particle.effective_size(log_weight).round(3))
    2.0
    >>> some = particle.Particles(log_weight, jnp.array([[0.0], [4.0], [9.0]]),
    ...                           jnp.array([0, 1, 1]))
    >>> print(particle.moments(some).mean, particle.mode_prob(some, 2).round(3))
    [2.] [0.5 0.5]

References: Gordon, Salmond and Smith, "Novel approach to nonlinear/non-Gaussian
Bayesian state estimation", IEE Proc. F 140(2), 1993; Musso, Oudjane and Le Gland,
"Improving regularised particle filters", 2001; Liu and West, "Combined parameter and
state estimation in simulation-based filtering", 2001 (the shrinkage), both in
"Sequential Monte Carlo methods in practice"; Gilks and Berzuini, "Following a moving
target: Monte Carlo inference for dynamic Bayesian models", J. Royal Statistical Society
B 63(1), 2001 (the move).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg, mixture
from jaxtrack.types import Array, Gaussian


class Particles(NamedTuple):
    """L weighted samples of a state and a mode.

    Attributes:
        log_weight: -inf marks an empty slot, [L].
        state: [L, D].
        mode: [L] (int).
    """

    log_weight: Array
    state: Array
    mode: Array


def reweight(log_weight: Array, log_factor: Array) -> tuple[Array, Array]:
    """Multiplies weights that sum to one, [L], by factors, [L].

    Returns:
        The log-weights, summing to one again, and the log of the sum they had. If
        nothing is left the weights come back as they were, beside -inf.
    """
    weighed = log_weight + log_factor
    log_total = mixture.total(weighed)
    weighed = jnp.where(log_total > -jnp.inf, weighed, log_weight)
    return mixture.log_normalise(weighed), log_total


def effective_size(log_weight: Array) -> Array:
    """Returns how many equally weighted particles as many weights [L] are worth.

    It is 1 / sum(w^2) for weights that sum to one (Kong, Liu and Wong, 1994), from 1 to
    the number of filled slots; 0 if all are empty.
    """
    highest = log_weight.max()
    some = highest > -jnp.inf
    weight = jnp.exp(log_weight - jnp.where(some, highest, 0.0))
    square = jnp.where(some, (weight * weight).sum(), 1.0)
    return weight.sum() ** 2 / square


def moments(particles: Particles) -> Gaussian:
    """Returns mean [D] and covariance [D, D] of particles over all modes."""
    weight = mixture.normalise(particles.log_weight)
    return _moments(weight, particles.state)


def mode_prob(particles: Particles, num_modes: int) -> Array:
    """Returns the share of each mode in the weight, [M]."""
    weight = mixture.normalise(particles.log_weight)
    return _in_mode(particles.mode, num_modes, weight).sum(1)


def regularise(
    key: Array, particles: Particles, num_modes: int, scale: float | Array = 1.0
) -> Particles:
    """Moves each particle at random within its mode's cloud, so that no two are one.

    The kernel is Gaussian with the cloud's covariance times h^2, h the bandwidth that
    is best for a Gaussian cloud of as many effective particles. Before, the particles
    are drawn towards the mean by sqrt(1 - h^2), so that mean and covariance of each
    mode stay, in expectation; where the cloud is Gaussian so does its density.

    Args:
        key: Random key.
        particles: L.
        num_modes: M.
        scale: Factor on the bandwidth.

    Returns:
        The particles, weights and modes as they were.
    """
    weight = mixture.normalise(particles.log_weight)
    each = _in_mode(particles.mode, num_modes, weight)
    total = each.sum(1)
    some = total > 0
    share = each / jnp.where(some, total, 1.0)[:, None]
    cloud = jax.vmap(_moments, (0, None))(share, particles.state)
    size = 1 / jnp.where(some, (share * share).sum(1), 1.0)
    width = jnp.minimum(scale * bandwidth(size, particles.state.shape[1]), 1.0)
    noise = normals(key, particles.state)

    def moved(cloud: Gaussian, width: Array) -> Array:
        lower = linalg.root(cloud.cov)
        gap = particles.state - cloud.mean[None]
        return cloud.mean[None] + jnp.sqrt(1 - width**2) * gap + width * noise @ lower.T

    every = jax.vmap(moved)(cloud, width)  # [M, L, D]
    state = pick(every, particles.mode)
    return particles._replace(state=state)


def normals(key: Array, state: Array) -> Array:
    """Draws standard normal numbers like the states of L particles, [L, D].

    Component by component, which takes half the time that particle by particle does.
    """
    return jax.random.normal(key, state.shape[::-1], state.dtype).T


def bandwidth(size: Array, dim: int) -> Array:
    """Returns the optimal bandwidth for a Gaussian kernel and a Gaussian cloud.

    It is (4 / (D + 2))^(1 / (D + 4)) n^(-1 / (D + 4)), in standard deviations of the
    cloud (Silverman 1986, section 4.3).

    Args:
        size: Number of particles n.
        dim: D.
    """
    return (4 / (dim + 2) / size) ** (1 / (dim + 4))


def move(
    key: Array,
    state: Array,
    propose: Callable[[Array], Array],
    log_likelihood: Callable[[Array], Array],
) -> tuple[Array, Array]:
    """Makes one Metropolis-Hastings step with each particle.

    The proposal is the prior of the step, whatever the state, so that only likelihoods
    decide; it leaves the posterior invariant (Gilks and Berzuini 2001).

    Args:
        key: Random key.
        state: [L, D].
        propose: key -> states drawn anew from the prior, [L, D].
        log_likelihood: Of states [L, D], [L].

    Returns:
        The states [L, D], and which were replaced, [L] (bool).
    """
    draw_key, accept_key = jax.random.split(key)
    other = propose(draw_key)
    now, then = log_likelihood(state), log_likelihood(other)
    level = jnp.log1p(-jax.random.uniform(accept_key, now.shape, now.dtype))
    # From where nothing is likely any step goes; -inf - -inf is not asked for.
    stuck = now == -jnp.inf
    gain = then - jnp.where(stuck, 0.0, now)
    accepted = (then > -jnp.inf) & (stuck | (level <= gain))
    return jnp.where(accepted[:, None], other, state), accepted


def pick(every: Sequence[Array] | Array, mode: Array) -> Array:
    """Returns for each of L particles what its own mode has, M of [L, ...] -> [L, ...].

    By comparisons, which XLA on CPU fuses, and not by a gather.
    """
    chosen = every[0]
    for number in range(1, len(every)):
        own = (mode == number).reshape(mode.shape + (1,) * (chosen.ndim - 1))
        chosen = jnp.where(own, every[number], chosen)
    return chosen


def _in_mode(mode: Array, num_modes: int, weight: Array) -> Array:
    """Returns the weights of L particles in their own mode and 0 elsewhere, [M, L]."""
    own = mode[None] == jnp.arange(num_modes)[:, None]
    return jnp.where(own, weight[None], 0.0)


def _moments(weight: Array, state: Array) -> Gaussian:
    """Returns the weighted mean and covariance of states [L, D]."""
    mean = jnp.matmul(weight, state, precision=jax.lax.Precision.HIGHEST)
    gap = state - mean[None]
    weighed = (weight[:, None] * gap).T
    cov = jnp.matmul(weighed, gap, precision=jax.lax.Precision.HIGHEST)
    return Gaussian(mean, linalg.symmetrize(cov))
