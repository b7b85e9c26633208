"""Gaussian mixtures: moment matching, and reduction by pruning, merging and capping.

    mixture = prune(mixture, threshold)          # drop components of little weight
    mixture = merge(mixture, threshold)          # join components that are close
    mixture, lost = cap(mixture, max_components) # keep the heaviest

`reduce` does all at once. Sizes stay fixed: an empty slot has log-weight -inf.

Reference: Vo and Ma, "The Gaussian mixture probability hypothesis density filter", IEEE
Trans. Signal Processing 54(11), 2006, Table II; with the spread of the means kept.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import mixture
    >>> from jaxtrack.types import Mixture
    >>> two = Mixture(jnp.log(jnp.array([0.5, 0.5])),
    ...               jnp.array([[0.0], [4.0]]), jnp.ones((2, 1, 1)))
    >>> print(mixture.collapse(two).cov)
    [[5.]]
"""

import chex
import jax
import jax.numpy as jnp
from jax.scipy.special import logsumexp

from jaxtrack import linalg
from jaxtrack.types import Array, Gaussian, Mixture


def moment_match(weight: Array, mean: Array, cov: Array) -> Gaussian:
    """Returns the Gaussian with the same mean and covariance as a mixture.

    Args:
        weight: Component weights, summing to one, [N].
        mean: Component means, [N, D].
        cov: Component covariances, [N, D, D].

    Returns:
        A `Gaussian`: mean [D], cov [D, D].
    """
    num, dim = mean.shape
    chex.assert_shape(weight, (num,))
    chex.assert_shape(cov, (num, dim, dim))

    centre = (weight[:, None] * mean).sum(0)
    spread = mean - centre[None]
    between = spread[:, :, None] * spread[:, None, :]
    return Gaussian(centre, (weight[:, None, None] * (cov + between)).sum(0))


def log_normalise(log_weight: Array) -> Array:
    """Returns log-weights [N] whose weights sum to one, for log-weights of any scale.

    If all are -inf the first slot gets weight one, so that values and gradients stay
    finite where nothing is there.
    """
    empty = jnp.all(log_weight == -jnp.inf)
    first = jnp.where(jnp.arange(log_weight.size) == 0, 0.0, -jnp.inf)
    return jax.nn.log_softmax(jnp.where(empty, first, log_weight))


def normalise(log_weight: Array) -> Array:
    """Returns weights [N] that sum to one; see `log_normalise`."""
    return jnp.exp(log_normalise(log_weight))


def collapse(mixture: Mixture) -> Gaussian:
    """Moment-matches a whole mixture [N]; weights need not be normalised."""
    return moment_match(normalise(mixture.log_weight), mixture.mean, mixture.cov)


def total(log_weight: Array) -> Array:
    """Returns the log of the summed weight of [N]; -inf if empty, without NaN grads."""
    empty = jnp.all(log_weight == -jnp.inf)
    safe = jnp.where(empty, 0.0, log_weight)
    return jnp.where(empty, -jnp.inf, logsumexp(safe))


def prune(mixture: Mixture, threshold: float | Array) -> Mixture:
    """Empties the components whose share of the weight is below a threshold.

    What remains is rescaled, so that the total weight is kept.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        threshold: Smallest share of the total weight that stays, e.g. 1e-5.

    Returns:
        The mixture, same shapes.
    """
    log_weight = mixture.log_weight
    heavy = normalise(log_weight) >= threshold
    kept = jnp.where(heavy, log_weight, -jnp.inf)
    return mixture._replace(log_weight=_rescale(kept, total(log_weight)))


def cap(mixture: Mixture, max_components: int) -> tuple[Mixture, Array]:
    """Keeps the heaviest components, heaviest first, and the total weight.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        max_components: Number of slots of the result, L; may exceed N.

    Returns:
        The mixture with L slots, and the share of the weight that was thrown away.
    """
    num = mixture.log_weight.size
    if num < max_components:
        mixture = _pad(mixture, max_components - num)
    log_weight, kept = jax.lax.top_k(mixture.log_weight, max_components)
    before, after = total(mixture.log_weight), total(log_weight)
    lost = jnp.where(before > -jnp.inf, -jnp.expm1(_difference(after, before)), 0.0)
    capped = Mixture(
        _rescale(log_weight, before), mixture.mean[kept], mixture.cov[kept]
    )
    return capped, jnp.maximum(lost, 0.0)


def merge(mixture: Mixture, threshold: float | Array) -> Mixture:
    """Joins each component to the heaviest one nearby, keeping the spread of means.

    The heaviest component leads; those whose squared Mahalanobis distance to its mean,
    with their own covariance, is at most the threshold are moment-matched with it; the
    heaviest of the rest leads next.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        threshold: Squared Mahalanobis distance; 0 joins equals only, inf joins all.

    Returns:
        One component per cluster, in the order of their leaders; the other of the N
        slots are empty.
    """
    num = mixture.log_weight.size
    return merge_clusters(mixture, clusters(mixture, threshold, num), num)


def clusters(mixture: Mixture, threshold: float | Array, max_clusters: int) -> Array:
    """Returns the cluster of each component, see `merge`.

    The loop runs once per cluster and only makes choices: no gradient passes through.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        threshold: Squared Mahalanobis distance.
        max_clusters: Clusters made; components that fit in none of them get -1.

    Returns:
        Numbers from 0, in the order of the leaders, [N] (int); -1 also marks an empty
        slot.
    """
    num = mixture.log_weight.size
    log_weight, mean, cov = jax.tree.map(jax.lax.stop_gradient, mixture)
    lower = jax.vmap(linalg.cholesky)(cov)
    slots = jnp.arange(num)

    def grow(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, cluster, free = carry
        leader = jnp.argmax(jnp.where(free, log_weight, -jnp.inf))
        gap = mean - mean[leader][None]
        white = jax.vmap(linalg.solve_lower)(lower, gap)
        near = (white * white).sum(1) <= threshold
        joins = free & (near | (slots == leader))
        return count + 1, jnp.where(joins, count, cluster), free & ~joins

    start = jnp.asarray(0), jnp.full(num, -1), log_weight > -jnp.inf
    return jax.lax.while_loop(
        lambda carry: (carry[0] < max_clusters) & carry[2].any(), grow, start
    )[1]


def merge_clusters(mixture: Mixture, cluster: Array, num_clusters: int) -> Mixture:
    """Moment-matches each cluster of components.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        cluster: Number of the cluster that a component belongs to, or -1, [N] (int).
        num_clusters: L.

    Returns:
        One component per cluster, [L]; a cluster without members has log-weight -inf
        and the moments of component 0.
    """
    member = cluster[None] == jnp.arange(num_clusters)[:, None]  # [cluster, member]
    log_weight = jnp.where(member, mixture.log_weight[None], -jnp.inf)
    merged = jax.vmap(moment_match, (0, None, None))(
        jax.vmap(normalise)(log_weight), mixture.mean, mixture.cov
    )
    return Mixture(jax.vmap(total)(log_weight), merged.mean, merged.cov)


def reduce(
    mixture: Mixture,
    max_components: int,
    prune_threshold: float | Array = 1e-5,
    merge_threshold: float | Array = 4.0,
) -> tuple[Mixture, Array]:
    """Prunes, and merges into at most so many components; keeps the total weight.

    As `prune` and then `merge`, but no more than `max_components` clusters are made:
    those with the heaviest leaders.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        max_components: Number of slots of the result, L; may exceed N.
        prune_threshold: See `prune`.
        merge_threshold: See `merge`.

    Returns:
        The mixture with L slots, in the order of the leaders, and the share of the
        weight that found no cluster (pruning by the threshold is not counted).
    """
    mixture = prune(mixture, prune_threshold)
    cluster = clusters(mixture, merge_threshold, max_components)
    merged = merge_clusters(mixture, cluster, max_components)
    before, after = total(mixture.log_weight), total(merged.log_weight)
    lost = jnp.where(before > -jnp.inf, -jnp.expm1(_difference(after, before)), 0.0)
    kept = merged._replace(log_weight=_rescale(merged.log_weight, before))
    return kept, jnp.maximum(lost, 0.0)


def _pad(mixture: Mixture, extra: int) -> Mixture:
    filler = jax.tree.map(lambda x: jnp.repeat(x[:1], extra, axis=0), mixture)
    filler = filler._replace(log_weight=jnp.full_like(filler.log_weight, -jnp.inf))
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y]), mixture, filler)


def _rescale(log_weight: Array, log_total: Array) -> Array:
    """Shifts log-weights so that they add up to a given total."""
    return log_weight + _difference(log_total, total(log_weight))


def _difference(left: Array, right: Array) -> Array:
    """Returns left - right, and 0 where both are -inf."""
    both = (left == -jnp.inf) & (right == -jnp.inf)
    return jnp.where(
        both, 0.0, jnp.where(both, 0.0, left) - jnp.where(both, 0.0, right)
    )
