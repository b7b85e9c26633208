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

import functools

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

    centre = _weighted(weight[None], mean)[0]
    spread = mean - centre[None]
    return Gaussian(centre, _weighted(weight[None], cov + _outer(spread))[0])


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
    """Returns the log of the sum of [N, ...], [...]; -inf if empty, without NaN."""
    empty = jnp.all(log_weight == -jnp.inf, axis=0)
    safe = jnp.where(empty[None], 0.0, log_weight)
    return jnp.where(empty, -jnp.inf, logsumexp(safe, axis=0))


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


def clusters(
    mixture: Mixture,
    threshold: float | Array,
    max_clusters: int,
    singular: bool = False,
) -> Array:
    """Returns the cluster of each component, see `merge`.

    The loop runs once per cluster and only makes choices: no gradient passes through.

    Args:
        mixture: log_weight [N], mean [N, D], cov [N, D, D].
        threshold: Squared Mahalanobis distance.
        max_clusters: Clusters made; components that fit in none of them get -1.
        singular: Whether covariances may be, such as those of few particles; such a
            component is measured with the leader's, and joins equals if both are.

    Returns:
        Numbers from 0, in the order of the leaders, [N] (int); -1 also marks an empty
        slot.
    """
    num, dim = mixture.mean.shape
    log_weight, mean, cov = jax.tree.map(jax.lax.stop_gradient, mixture)
    slots, axes = jnp.arange(num), range(dim)
    # Vectors over the components, and nothing in the loop that could be outside.
    inverse, regular = jax.vmap(functools.partial(_inverse_factor, singular))(cov)
    factor = [[inverse[:, i, j] for j in range(i + 1)] for i in axes]
    place = [mean[:, i] for i in axes]

    def grow(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, cluster, free = carry
        leader = jnp.argmax(jnp.where(free, log_weight, -jnp.inf))
        gap = [x - x[leader] for x in place]
        own, limit = factor, threshold
        if singular:
            own = [[jnp.where(regular, x, x[leader]) for x in row] for row in factor]
            limit = jnp.where(regular | regular[leader], threshold, 0.0)
        white = [sum(row[j] * gap[j] for j in range(len(row))) for row in own]
        near = sum(x * x for x in white) <= limit
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
    inside, mine = cluster >= 0, jnp.maximum(cluster, 0)
    heaviest = jnp.where(member, mixture.log_weight[None], -jnp.inf).max(1)
    filled = heaviest > -jnp.inf
    heaviest = jax.lax.stop_gradient(jnp.where(filled, heaviest, 0.0))

    # Relative to its cluster's heaviest no weight is above one, and one is one.
    log_weight = jnp.where(inside, mixture.log_weight - heaviest[mine], -jnp.inf)
    weight = jnp.where(member, jnp.exp(log_weight)[None], 0.0)
    total = jnp.where(filled, weight.sum(1), 1.0)
    weight = weight / total[:, None]
    centre = _weighted(weight, mixture.mean)
    spread = mixture.mean - centre[mine]
    within = _weighted(weight, mixture.cov + _outer(spread))
    return Mixture(
        jnp.where(filled, heaviest + jnp.log(total), -jnp.inf),
        jnp.where(filled[:, None], centre, mixture.mean[:1]),
        jnp.where(filled[:, None, None], within, mixture.cov[:1]),
    )


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
    return join(mixture, cluster, max_components)


def join(mixture: Mixture, cluster: Array, num_clusters: int) -> tuple[Mixture, Array]:
    """Merges clusters of components as `merge_clusters`, but keeps the total weight.

    Returns:
        The mixture with a slot for each cluster, and the share of the weight that
        belongs to none.
    """
    merged = merge_clusters(mixture, cluster, num_clusters)
    before, after = total(mixture.log_weight), total(merged.log_weight)
    lost = jnp.where(before > -jnp.inf, -jnp.expm1(_difference(after, before)), 0.0)
    log_weight = merged.log_weight + _difference(before, after)
    return merged._replace(log_weight=log_weight), jnp.maximum(lost, 0.0)


def _weighted(weight: Array, values: Array) -> Array:
    """Returns weighted sums of N arrays: weight [L, N], values [N, ...] -> [L, ...].

    As one product of matrices, which is several times faster than summing products.
    """
    flat = values.reshape(len(values), -1)
    summed = jnp.matmul(weight, flat, precision=jax.lax.Precision.HIGHEST)
    return summed.reshape(len(weight), *values.shape[1:])


def _outer(spread: Array) -> Array:
    """Returns the squares of N vectors, [N, D] -> [N, D, D]."""
    return spread[:, :, None] * spread[:, None, :]


def _inverse_factor(singular: bool, cov: Array) -> tuple[Array, Array]:
    """Inverts a covariance's lower factor [D, D], and says if that can be done."""
    unit = jnp.eye(len(cov), dtype=cov.dtype)
    lower = linalg.root(cov) if singular else linalg.cholesky(cov)
    regular = jnp.array(not singular) | (jnp.diagonal(lower) > 0).all()
    return linalg.solve_lower(jnp.where(regular, lower, unit), unit), regular


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
