"""Gaussian mixtures: moment matching, and reduction by pruning, merging and capping.

    mixture = prune(mixture, threshold)          # drop components of little weight
    mixture = merge(mixture, threshold)          # join components that are close
    mixture, lost = cap(mixture, max_components) # keep the heaviest

`reduce` is the three in a row. Sizes stay fixed: an empty slot has log-weight -inf.

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
        The mixture, same shapes; each cluster stands in its leader's slot and the
        slots of the others are empty.
    """
    leader = jax.lax.stop_gradient(leaders(mixture, threshold))
    member = leader[None] == jnp.arange(leader.size)[:, None]  # [cluster, member]
    return merge_clusters(mixture, member)


def leaders(mixture: Mixture, threshold: float | Array) -> Array:
    """Returns the slot of the component that each one is merged into, [N] (int).

    Empty slots get -1. The loop runs once per cluster, and only over booleans: no
    gradient passes through the choice.
    """
    num = mixture.log_weight.size
    mixture = jax.tree.map(jax.lax.stop_gradient, mixture)
    lower = jax.vmap(linalg.cholesky)(mixture.cov)

    def grow(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        leader, free = carry
        first = jnp.argmax(jnp.where(free, mixture.log_weight, -jnp.inf))
        gap = mixture.mean - mixture.mean[first][None]
        white = jax.vmap(linalg.solve_lower)(lower, gap)
        near = (white * white).sum(1) <= threshold
        joins = free & (near | (jnp.arange(num) == first))
        return jnp.where(joins, first, leader), free & ~joins

    free = mixture.log_weight > -jnp.inf
    start = jnp.full(num, -1), free
    return jax.lax.while_loop(lambda carry: carry[1].any(), grow, start)[0]


def merge_clusters(mixture: Mixture, member: Array) -> Mixture:
    """Moment-matches each cluster of components.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        member: member[l, n]: component n belongs to cluster l, [L, N] (bool).

    Returns:
        One component per cluster, [L]; a cluster without members has log-weight -inf
        and the moments of component 0.
    """
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
    """Prunes, merges and caps: the mixture in fewer components, same total weight.

    Equal to `cap(merge(prune(mixture)))`, but moment-matches only the clusters that
    survive the cap.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        max_components: Number of slots of the result, L.
        prune_threshold: See `prune`.
        merge_threshold: See `merge`.

    Returns:
        The mixture with L slots, heaviest first, and the share of the weight that the
        cap threw away (pruning by the threshold is not counted).
    """
    mixture = prune(mixture, prune_threshold)
    leader = leaders(mixture, merge_threshold)
    slots = jnp.arange(leader.size)
    weight = normalise(mixture.log_weight)
    heaviness = jnp.where(leader[None] == slots[:, None], weight[None], 0.0).sum(1)
    count = min(max_components, leader.size)
    _, best = jax.lax.top_k(jax.lax.stop_gradient(heaviness), count)
    merged = merge_clusters(mixture, leader[None] == best[:, None])
    if count < max_components:
        merged = _pad(merged, max_components - count)

    before = total(mixture.log_weight)
    lost = jnp.maximum(1 - heaviness[best].sum(), 0.0)
    lost = jnp.where(before > -jnp.inf, lost, 0.0)
    return merged._replace(log_weight=_rescale(merged.log_weight, before)), lost


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
