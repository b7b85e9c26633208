"""The belief of a jump Markov target: Gaussian components in every mode, kept few.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.targets import components
    >>> one = components.Belief(
    ...     log_weight=jnp.log(jnp.array([[0.5, 0.5]])),
    ...     mean=jnp.array([[[0.0], [4.0]]]), cov=jnp.ones((1, 2, 1, 1)), lost=0.0)
    >>> print(components.moments(one).mean)
    [2.]

Reference: Pasha, Vo, Tuan and Ma, "A Gaussian mixture PHD filter for jump Markov system
models", IEEE Trans. Aerospace and Electronic Systems 45(3), 2009.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.types import Array, Gaussian, Mixture


class Belief(NamedTuple):
    """N components in each of M modes; the weights of all M N sum to one.

    Attributes:
        log_weight: -inf marks an empty slot, [M, N].
        mean: [M, N, D].
        cov: [M, N, D, D].
        lost: Share of the weight that the cap threw away at the last reduction.
    """

    log_weight: Array
    mean: Array
    cov: Array
    lost: Array


class Reduction(NamedTuple):
    """How a mixture is kept small; see `jaxtrack.mixture.reduce`."""

    max_components: int
    prune_threshold: float
    merge_threshold: float


def check(reduction: Reduction) -> None:
    """Raises a ValueError for a size or threshold that makes no sense."""
    if reduction.max_components < 1:
        raise ValueError(
            f"max_components is {reduction.max_components}; a mode needs at least 1"
        )
    if not 0 <= reduction.prune_threshold < 1:
        raise ValueError(
            f"prune_threshold is {reduction.prune_threshold}; give a share of the "
            "weight from 0 up to 1, e.g. 1e-5"
        )
    if not reduction.merge_threshold >= 0:
        raise ValueError(
            f"merge_threshold is {reduction.merge_threshold}; give a squared distance "
            "of 0 or more, e.g. 4"
        )


def reweight(belief: Belief, log_factor: Array) -> Belief:
    """Multiplies the weights by a factor that broadcasts against [M, N]."""
    return belief._replace(log_weight=belief.log_weight + log_factor)


def normalised(belief: Belief) -> Belief:
    """Scales the weights so that they add up to one over all modes."""
    flat = mixture.log_normalise(belief.log_weight.ravel())
    return belief._replace(log_weight=flat.reshape(belief.log_weight.shape))


def moments(belief: Belief) -> Gaussian:
    """Returns the mean [D] and covariance [D, D] over all modes."""
    return mixture.collapse(parts(belief))


def parts(belief: Belief) -> Mixture:
    """Returns all components of all modes in a row, M N of them."""
    return Mixture(*(x.reshape(-1, *x.shape[2:]) for x in belief[:3]))


def collapse(reduction: Reduction, log_weight: Array, beliefs: Belief) -> Belief:
    """Pools the components of N weighted beliefs, mode by mode, and reduces them."""
    share, pooled = pool(log_weight, beliefs)
    return lose(reduce(reduction, *pooled), (share * beliefs.lost).sum())


def pool(log_weight: Array, beliefs: Belief) -> tuple[Array, Mixture]:
    """Returns the shares of N beliefs, and all components of a mode in a row."""
    share = mixture.log_normalise(log_weight)
    weighted = reweight(beliefs, share[:, None, None])
    return jnp.exp(share), Mixture(
        *(
            jnp.moveaxis(x, 0, 1).reshape(x.shape[1], -1, *x.shape[3:])
            for x in (weighted.log_weight, weighted.mean, weighted.cov)
        )
    )


def lose(belief: Belief, earlier: Array) -> Belief:
    """Adds a share that was lost before the last reduction."""
    return belief._replace(lost=belief.lost + (1 - belief.lost) * earlier)


def reduce(reduction: Reduction, log_weight: Array, mean: Array, cov: Array) -> Belief:
    """Reduces each mode's components; weights are pruned over all modes together.

    Args:
        reduction: How many stay.
        log_weight: Weights that sum to one over all modes, [M, C].
        mean: [M, C, D], or [C, D] where the modes share the components.
        cov: [M, C, D, D] or [C, D, D].

    Returns:
        The belief, with the share that found no room in `lost`.
    """
    size, threshold = reduction.max_components, reduction.merge_threshold
    heavy = jnp.exp(log_weight) >= reduction.prune_threshold
    pruned = jnp.where(heavy, log_weight, -jnp.inf)
    pruned = mixture.log_normalise(pruned.ravel()).reshape(pruned.shape)

    def in_mode(log_weight: Array, mean: Array, cov: Array) -> tuple[Mixture, Array]:
        some = Mixture(log_weight, mean, cov)
        return mixture.join(some, mixture.clusters(some, threshold, size), size)

    # Each mode makes clusters of its own even where they share the components: common
    # ones are a tenth faster and a little worse.
    shared = None if mean.ndim == 2 else 0
    kept, lost = jax.vmap(in_mode, (0, shared, shared))(pruned, mean, cov)
    weight = jnp.exp(jax.vmap(mixture.total)(kept.log_weight))
    return Belief(*kept, lost=(weight * lost).sum())
