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

import functools
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
    flat = (x.reshape(-1, *x.shape[2:]) for x in belief[:3])
    return mixture.collapse(Mixture(*flat))


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
        mean: [M, C, D].
        cov: [M, C, D, D].

    Returns:
        The belief, with the share that found no room in `lost`.
    """
    pruned = _prune(reduction, log_weight)
    modes = Mixture(pruned, mean, cov)
    cluster = jax.vmap(functools.partial(_clusters, reduction))(modes)
    return _join(reduction, modes, cluster, 0)


def mix(reduction: Reduction, log_weight: Array, mean: Array, cov: Array) -> Belief:
    """Reduces components that all modes share, with a weight for each mode.

    They are clustered once, by their weight over all modes, and each mode merges the
    clusters by its own weights: its N components are those of N common clusters.

    Args:
        reduction: How many stay.
        log_weight: Weights that sum to one over all modes, [M, C].
        mean: [C, D].
        cov: [C, D, D].

    Returns:
        As `reduce`.
    """
    pruned = _prune(reduction, log_weight)
    everywhere = jax.vmap(mixture.total, 1)(pruned)
    cluster = _clusters(reduction, Mixture(everywhere, mean, cov))
    return _join(reduction, Mixture(pruned, mean, cov), cluster, None)


def _prune(reduction: Reduction, log_weight: Array) -> Array:
    heavy = jnp.exp(log_weight) >= reduction.prune_threshold
    pruned = jnp.where(heavy, log_weight, -jnp.inf)
    return mixture.log_normalise(pruned.ravel()).reshape(pruned.shape)


def _clusters(reduction: Reduction, some: Mixture) -> Array:
    size, threshold = reduction.max_components, reduction.merge_threshold
    return mixture.clusters(some, threshold, size)


def _join(
    reduction: Reduction, modes: Mixture, cluster: Array, axis: int | None
) -> Belief:
    """Merges clusters mode by mode; with axis None the modes share all but weights."""

    def in_mode(log_weight: Array, *rest: Array) -> tuple[Mixture, Array]:
        *moments, cluster = rest
        some = Mixture(log_weight, *moments)
        return mixture.join(some, cluster, reduction.max_components)

    kept, lost = jax.vmap(in_mode, (0, axis, axis, axis))(*modes, cluster)
    weight = jnp.exp(jax.vmap(mixture.total)(kept.log_weight))
    return Belief(*kept, lost=(weight * lost).sum())
