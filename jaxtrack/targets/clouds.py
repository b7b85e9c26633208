"""A belief made of particles that carries its own randomness.

The key is kept as numbers, so that a belief is arrays only and can be stacked, gathered
and chosen from. Where a belief comes of a detection the detection's own digits are
folded into the key, not its place in the scan: what is drawn depends neither on the
order of the detections nor on padding, and two detections make different draws.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack.targets import clouds
    >>> key = clouds.numbers(jax.random.key(0))
    >>> one, other = (clouds.fold(key, jnp.array([x, 2.0])) for x in (1.0, 1.5))
    >>> print(key.shape, (one == other).all())
    (2,) False
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture, particle
from jaxtrack.particle import Particles
from jaxtrack.resampling import Scheme
from jaxtrack.types import Array, Mixture

MISSED = 1  # what is folded into the key where there is no detection
BLENDED = 2
COLLAPSED = 3


class Belief(NamedTuple):
    """L particles; their weights sum to one.

    Attributes:
        log_weight: -inf marks an empty slot, [L].
        state: [L, D].
        mode: [L] (int).
        carried: What goes along with each particle, or None: the state before the last
            noise (`cloud_moves`), the covariance (`rao_blackwell`), [L, E].
        root: Factor of that noise's covariance in each mode, [M, D, D]; zero where it
            is of no use any more.
        distinct: Share of the particles that are no copies: below 1 where they were
            drawn from fewer since the last motion (a scalar).
        num: Particles to be made at the next resampling (an int scalar).
        key: Random key as numbers, [2] (uint32).
    """

    log_weight: Array
    state: Array
    mode: Array
    carried: Any
    root: Array
    distinct: Array
    num: Array
    key: Array

    @property
    def particles(self) -> Particles:
        """Returns weights, states and modes."""
        return Particles(self.log_weight, self.state, self.mode)

    @property
    def effective_size(self) -> Array:
        """Returns how many equally weighted particles these are worth, no copies."""
        return particle.effective_size(self.log_weight) * self.distinct


def check(ess_threshold: float) -> None:
    """Raises a ValueError for a threshold of the effective size that is no share."""
    if not 0 < ess_threshold <= 1:
        raise ValueError(
            f"ess_threshold is {ess_threshold}; give a share above 0 and up to 1"
        )


def parts(belief: Belief) -> Mixture:
    """Returns the particles as Gaussians without covariance."""
    size, dim = belief.state.shape
    none = jnp.zeros((size, dim, dim), belief.state.dtype)
    return Mixture(belief.log_weight, belief.state, none)


def numbers(key: Array) -> Array:
    """Returns a random key as numbers, [2] (uint32), whatever its kind."""
    return jax.random.bits(key, (2,), jnp.uint32)


def split(key: Array, num: int) -> tuple[Array, Array]:
    """Returns the numbers of the next key, [2], and `num` random keys to use up."""
    keys = jax.random.split(_key(key), num + 1)
    return jax.random.key_data(keys[0]), keys[1:]


def fold(key: Array, value: Array | int) -> Array:
    """Folds a whole number, or all digits of an array, into a key's numbers [2]."""
    if isinstance(value, int):
        return jax.random.key_data(jax.random.fold_in(_key(key), value))
    bits = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(value), jnp.uint32)
    folded = _key(key)
    for digits in bits.ravel():
        folded = jax.random.fold_in(folded, digits)
    return jax.random.key_data(folded)


def _key(numbers: Array) -> Array:
    return jax.random.wrap_key_data(numbers, impl="threefry2x32")


def reweighted(belief: Belief, log_factor: Array) -> tuple[Belief, Array]:
    """Multiplies the weights by factors [L]; returns the log of their sum, too."""
    log_weight, log_total = particle.reweight(belief.log_weight, log_factor)
    return belief._replace(log_weight=log_weight), log_total


def one_of(
    scheme: Scheme, log_weight: Array, beliefs: Belief, log_factor: Array, key: Array
) -> Belief:
    """Resamples one belief from N weighted ones.

    Where one of them has all the weight it comes back as it is.

    Args:
        scheme: Of `resampling`.
        log_weight: Of each belief, any scale, [N]; if all are empty the first counts.
        beliefs: [N, ...].
        log_factor: On the particles' own weights, which then sum to one again, [N, L].
        key: Of what comes out, as numbers.

    Returns:
        The belief.
    """
    beliefs, _ = jax.vmap(reweighted)(beliefs, log_factor)
    share = mixture.log_normalise(log_weight)
    heaviest = jnp.argmax(share)
    whole = jax.tree.map(lambda x: x[heaviest], beliefs)
    following, keys = split(key, 1)
    if len(share) == 1:
        return whole._replace(key=following)
    log_pool = (share[:, None] + beliefs.log_weight).ravel()
    pool = Particles(log_pool, _flat(_wide(beliefs)), _flat(beliefs.mode))
    num = beliefs.num.max()
    drawn = scheme(keys[0], pool, beliefs.mode.shape[1], num)
    each = jax.vmap(lambda x: x.effective_size)(beliefs)
    worth = 1 / (jnp.exp(2 * share) / each).sum()
    new = _narrow(whole, drawn)._replace(distinct=jnp.minimum(worth / num, 1.0))
    alone = share[heaviest] >= 0
    chosen = jax.tree.map(lambda x, y: jnp.where(alone, x, y), whole, new)
    return chosen._replace(num=num, key=following)


def renewed(scheme: Scheme, threshold: float, belief: Belief, key: Array) -> Belief:
    """Resamples where a belief is worth too few particles, or has too many.

    Args:
        scheme: Of `resampling`.
        threshold: Share of `num` that the effective size must reach; with 1 all is
            resampled always.
        belief: L particles.
        key: Random key.
    """
    some = Particles(belief.log_weight, _wide(belief), belief.mode)
    size = belief.mode.shape[0]
    new = _narrow(belief, scheme(key, some, size, belief.num))
    new = new._replace(distinct=jnp.minimum(belief.effective_size / belief.num, 1.0))
    if threshold >= 1:
        return new
    filled = (belief.log_weight > -jnp.inf).sum()
    good = particle.effective_size(belief.log_weight) >= threshold * belief.num
    keep = good & (filled <= belief.num)
    return jax.tree.map(lambda x, y: jnp.where(keep, x, y), belief, new)


def _wide(belief: Belief) -> Array:
    """Returns the states, and what goes along beside them, [..., D + E]."""
    if belief.carried is None:
        return belief.state
    return jnp.concatenate([belief.state, belief.carried], axis=-1)


def _narrow(belief: Belief, drawn: Particles) -> Belief:
    """Puts drawn particles in the place of a belief's."""
    dim = belief.state.shape[-1]
    return belief._replace(
        log_weight=drawn.log_weight,
        state=drawn.state[:, :dim],
        mode=drawn.mode,
        carried=None if belief.carried is None else drawn.state[:, dim:],
    )


def _flat(many: Array) -> Array:
    return many.reshape(-1, *many.shape[2:])


def choose(
    key: Array, detections: Array, log_weight: Array, numbers: Array
) -> tuple[Array, Array]:
    """Draws for each particle which of K detections was its own, or none.

    The choice is the largest of log-weights with Gumbel noise of each detection's own,
    so that it depends neither on their order nor on padding.

    Args:
        key: Random key, for none.
        detections: [K, Z].
        log_weight: Of each detection and, last, of none, for each particle, [K + 1, L].
        numbers: Those of a key, for the detections, [2].

    Returns:
        Which one, [L] (int), K for none; and that detection, any for none, [L, Z].
    """
    shape, dtype = log_weight.shape[1:], log_weight.dtype

    def one(detection: Array) -> Array:
        _, keys = split(fold(numbers, detection), 1)
        return jax.random.gumbel(keys[0], shape, dtype)

    none = jax.random.gumbel(key, shape, dtype)
    noise = jnp.concatenate([jax.vmap(one)(detections), none[None]])
    choice = jnp.argmax(log_weight + noise, axis=0)
    own = jnp.take(detections, jnp.minimum(choice, len(detections) - 1), axis=0)
    return choice, own


def prob(model: Any, belief: Belief, interval: Array | float = 0.0) -> Array:
    """Evaluates a probability at each particle, [L]."""
    return jax.vmap(model.prob, (0, 0, None))(belief.mode, belief.state, interval)
