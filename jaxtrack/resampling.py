"""Resampling: equally weighted particles from weighted ones.

A scheme is `(key, particles [P], size, num) -> particles [size]`: of the new slots the
first `num` are filled, with equal weights that sum to one, and the rest are empty.
Sizes are static, `num` may be traced.

    systematic     one uniform number for all strata
    stratified     a uniform number for each stratum
    residual       the whole parts of num * weight, the rest multinomial
    multinomial    independent draws; the reference for the others

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import resampling
    >>> from jaxtrack.particle import Particles
    >>> two = Particles(jnp.log(jnp.array([0.75, 0.25])), jnp.array([[1.0], [2.0]]),
    ...                 jnp.zeros(2, int))
    >>> new = resampling.systematic(jax.random.key(0), two, size=4, num=4)
    >>> print(new.state[:, 0], jnp.exp(new.log_weight))
    [1. 1. 1. 2.] [0.25 0.25 0.25 0.25]

An index is found in O(P + size): each particle's share of the strata ends somewhere,
and the ends, counted and summed up, say which particle holds a stratum.

References: Kitagawa, "Monte Carlo filter and smoother for non-Gaussian nonlinear state
space models", J. Computational and Graphical Statistics 5(1), 1996; Liu and Chen,
"Sequential Monte Carlo methods for dynamic systems", J. American Statistical
Association 93, 1998 (residual).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.particle import Particles
from jaxtrack.types import Array

Scheme = Callable[[Array, Particles, int, Any], Particles]
Indices = Callable[[Array, Array, int, Any], Array]


def systematic(key: Array, particles: Particles, size: int, num: Any) -> Particles:
    """Resamples with one uniform number for all strata.

    Args:
        key: Random key.
        particles: P; weights need not be normalised. If all slots are empty they stay.
        size: Slots made.
        num: Of them filled, from 1 to size; may be traced.

    Returns:
        The new particles, in the order of the old.
    """
    return _gather(systematic_index, key, particles, size, num)


def stratified(key: Array, particles: Particles, size: int, num: Any) -> Particles:
    """Resamples with a uniform number for each stratum; see `systematic`."""
    return _gather(stratified_index, key, particles, size, num)


def residual(key: Array, particles: Particles, size: int, num: Any) -> Particles:
    """Keeps whole parts of num * weight, draws the rest; see `systematic`."""
    return _gather(residual_index, key, particles, size, num)


def multinomial(key: Array, particles: Particles, size: int, num: Any) -> Particles:
    """Draws each particle on its own; see `systematic`."""
    return _gather(multinomial_index, key, particles, size, num)


def systematic_index(key: Array, log_weight: Array, size: int, num: Any) -> Array:
    """Returns which of P particles each new slot takes, [size] (int), ascending.

    Args:
        key: Random key.
        log_weight: [P].
        size: Slots made.
        num: Of them filled; what the others hold is of no account.
    """
    start = jax.random.uniform(key, (), log_weight.dtype)
    cdf = _cdf(log_weight)
    return _owners(_ends(jnp.ceil(cdf * num - start), cdf, num), size)


def stratified_index(key: Array, log_weight: Array, size: int, num: Any) -> Array:
    """Returns which of P particles each new slot takes; see `systematic_index`."""
    cdf = _cdf(log_weight)
    point = jax.random.uniform(key, (size,), log_weight.dtype)
    stratum = jnp.clip(jnp.floor(cdf * num), 0, size - 1)
    within = point[stratum.astype(jnp.int32)] < cdf * num - stratum
    return _owners(_ends(stratum + within, cdf, num), size)


def multinomial_index(key: Array, log_weight: Array, size: int, num: Any) -> Array:
    """Returns which of P particles each new slot takes; see `systematic_index`."""
    return _search(_cdf(log_weight), _ordered(key, size, num, log_weight.dtype))


def residual_index(key: Array, log_weight: Array, size: int, num: Any) -> Array:
    """Returns which of P particles each new slot takes; see `systematic_index`."""
    share = mixture.normalise(jax.lax.stop_gradient(log_weight)) * num
    whole = jnp.floor(share)
    rest = num - whole.sum()
    cdf = jnp.cumsum(share - whole)
    cdf = cdf / jnp.where(cdf[-1] > 0, cdf[-1], 1.0)
    drawn = _search(cdf, _ordered(key, size, rest, share.dtype))
    more = jnp.zeros_like(share).at[drawn].add(jnp.arange(size) < rest)
    ends = jnp.cumsum(whole + more)
    return _owners(ends.astype(jnp.int32), size)


def _gather(
    indices: Indices, key: Array, particles: Particles, size: int, num: Any
) -> Particles:
    index = indices(key, jax.lax.stop_gradient(particles.log_weight), size, num)
    # Rounding may hit an empty slot at the edge of a stratum: it stays empty.
    filled = (jnp.arange(size) < num) & (particles.log_weight[index] > -jnp.inf)
    return Particles(
        log_weight=even(filled, particles.log_weight.dtype),
        state=particles.state[index],
        mode=particles.mode[index],
    )


def even(filled: Array, dtype: Any) -> Array:
    """Returns equal log-weights that sum to one over the filled of L slots, [L]."""
    count = jnp.maximum(filled.sum(), 1).astype(dtype)
    return jnp.where(filled, -jnp.log(count), -jnp.inf)


def _cdf(log_weight: Array) -> Array:
    """Returns the summed shares of the weight, the last 1, [P]."""
    cdf = jnp.cumsum(mixture.normalise(jax.lax.stop_gradient(log_weight)))
    return cdf / cdf[-1]


def _ends(end: Array, cdf: Array, num: Any) -> Array:
    """Returns where each particle's strata end, the last filled at `num`, [P]."""
    end = jnp.where(cdf >= 1, num, jnp.clip(end, 0, num))
    return end.astype(jnp.int32)


def _owners(ends: Array, size: int) -> Array:
    """Returns the first particle whose strata end beyond each slot, [size].

    As many as end at or before it, so that ends need not even be in order.
    """
    ended = jnp.zeros(size + 1, jnp.int32).at[ends].add(1, mode="drop")
    return jnp.minimum(jnp.cumsum(ended[:size]), len(ends) - 1)


def _ordered(key: Array, size: int, num: Any, dtype: Any) -> Array:
    """Draws `num` uniform numbers in order, [size]; those after them are above 1."""
    gap = jax.random.exponential(key, (size + 1,), dtype)
    total = jnp.cumsum(gap)
    last = jnp.clip(jnp.asarray(num, jnp.int32), 0, size)
    return total[:size] / total[last]


def _search(cdf: Array, point: Array) -> Array:
    """Returns the first particle whose summed share is beyond each point."""
    index = jnp.searchsorted(cdf, point, side="right")
    return jnp.minimum(index, len(cdf) - 1)
