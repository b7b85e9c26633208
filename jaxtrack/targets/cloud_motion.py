"""How a belief made of particles changes its modes and moves.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import linalg
    >>> from jaxtrack.targets import cloud_motion
    >>> root = linalg.root(jnp.array([[4.0, 2.0], [2.0, 1.0]]))  # of rank one
    >>> print(cloud_motion.times(root, jnp.array([[1.0, 5.0]])))
    [[2. 1.]]

Reference: Yuan, Lian and Han 2013, equations 16 and 17, see `targets.particles`.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack import linalg, particle
from jaxtrack.entries import dense
from jaxtrack.targets.clouds import Belief
from jaxtrack.types import Array

ModeProposal = Callable[[Array], Array]


def switch(
    proposal: ModeProposal | None,
    params: Any,
    belief: Belief,
    interval: Array,
    key: Array,
) -> Belief:
    """Draws the mode that each particle enters, and weighs it by h / alpha.

    Args:
        proposal: log h [M, M] -> log alpha [M, M], rows on any scale; None where alpha
            is h.
        params: A target's `Params`, with M motions.
        belief: L particles.
        interval: Seconds.
        key: Random key.
    """
    if len(params.motions) == 1:
        return belief
    log_h = params.switching.log_transition(interval)
    log_alpha = log_h
    if proposal is not None:
        log_alpha = jax.nn.log_softmax(proposal(log_h), axis=1)
    level = jax.random.uniform(key, belief.mode.shape, belief.log_weight.dtype)
    edge = jnp.cumsum(jnp.exp(log_alpha), axis=1)
    edge = edge / edge[:, -1:]
    # The first mode whose edge lies beyond: one of no probability is never entered.
    entered = jnp.zeros_like(belief.mode)
    for column in edge.T[:-1]:
        entered = entered + (level >= _of(column, belief.mode))
    if proposal is None:
        return belief._replace(mode=entered)
    log_ratio = (log_h - jnp.where(log_alpha > -jnp.inf, log_alpha, 0.0)).T
    rows = [_of(row, belief.mode) for row in log_ratio]
    log_weight, _ = particle.reweight(belief.log_weight, particle.pick(rows, entered))
    return belief._replace(mode=entered, log_weight=log_weight)


def _of(values: Array, mode: Array) -> Array:
    """Returns for each of L particles the value of its mode, of [M]."""
    return particle.pick([jnp.broadcast_to(x, mode.shape) for x in values], mode)


def move(params: Any, belief: Belief, interval: Array) -> Array:
    """Moves each particle by the motion of its mode, without noise.

    Args:
        params: A target's `Params`.
        belief: L particles.
        interval: Seconds.

    Returns:
        The states, [L, D].
    """

    def moved(motion: Any) -> Array:
        return jax.vmap(motion.move, (0, None))(belief.state, interval)

    return particle.pick([moved(x) for x in params.motions], belief.mode)


def roots(params: Any, interval: Array) -> list[Any]:
    """Returns a factor of the covariance of each mode's noise, M of [D, D]."""
    return [linalg.root(motion.noise(interval)) for motion in params.motions]


def push(roots: Sequence[Any], mode: Array, noise: Array) -> Array:
    """Returns root @ e for each of L vectors e by the root of its mode, [L, D]."""
    return particle.pick([times(root, noise) for root in roots], mode)


def times(root: Any, noise: Array) -> Array:
    """Returns root @ e for each of L vectors e, [L, D].

    As one product of matrices: written out, XLA on CPU would draw the noise anew for
    each entry of the result.
    """
    return jnp.matmul(noise, dense(root).T, precision=jax.lax.Precision.HIGHEST)
