"""Clusters of track trees that know nothing of each other, and their hypotheses.

Two groups of targets with three hypotheses each have nine together, but six in two
lists. Clusters are split where trees have become independent, and joined where a
detection may be of either:

    views, lost = split(views, ...)       # after a scan
    together = join(views, trees)         # before a search

Each tree has a column in a table of H rows, and those of a cluster's trees belong
together, row by row (`verdict.Views`). A tree whose leaf is certain is a cluster of its
own with a single row.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import hypothesis_clusters
    >>> halves = jnp.log(jnp.array([[0.5, 0.5, 0.0, 0.0], [0.9, 0.1, 0.0, 0.0]]))
    >>> log_weight, row = hypothesis_clusters.product(halves)
    >>> print(jnp.exp(log_weight).round(3), row[:, 0])
    [0.45 0.45 0.05 0.05] [0 1 0 1]

Reference: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979, section V (clusters).
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import mixture
from jaxtrack.assign import clusters
from jaxtrack.linalg import safe_log
from jaxtrack.trackers.global_hypotheses import Hypotheses
from jaxtrack.trackers.verdict import Views
from jaxtrack.types import Array

FAINT, PLAIN = 1e-6, 1e-2  # links so weak are cut together, and so strong one by one
NEARLY = 100.0  # rounding errors of a sum


def first(num_rows: int, known: Array, dtype: jnp.dtype) -> Views:
    """Returns clusters of one tree and one row: the trees [N] (bool) have a leaf."""
    num = known.size
    row = jnp.arange(num_rows)[:, None] == 0
    log_prob = jnp.broadcast_to(jnp.where(row, 0.0, -jnp.inf), (num_rows, num))
    leaf = jnp.where(row & known[None], 0, -1)
    label = jnp.arange(num, dtype=jnp.int32)
    return Views(leaf.astype(jnp.int32), log_prob.astype(dtype), label)


def leads(views: Views) -> Array:
    """Returns which trees are the first of their cluster, [N] (bool)."""
    return views.label == jnp.arange(views.label.size)


def fit(
    strength: Array, least: float, max_trees: int, max_items: int
) -> tuple[Array, Array]:
    """Finds clusters that are small enough; where they are not, weak links are cut.

    In a cluster that is too large the weakest links go, one after another, until what
    is left fits; very weak ones go together.

    Args:
        strength: Of the link between a tree and an item, up to 1; inf for one that may
            not be cut, 0 for none, [N, M].
        least: Links of no more strength are none.
        max_trees: Trees in a cluster, at least 1.
        max_items: Items in a cluster.

    Returns:
        Which links are left, [N, M] (bool), and the first tree of each tree's cluster,
        [N].
    """

    def look(level: Array) -> tuple[Array, Array, Array, Array]:
        kept = strength > level[:, None]
        label = clusters.label(kept[..., None])
        item = clusters.of_items(kept[..., None], label)[:, 0]
        label = label[:, 0]
        trees = (label[:, None] == label[None]).sum(1)
        items = (label[:, None] == item[None]).sum(1)
        return level, kept, label, (trees > max_trees) | (items > max_items)

    def cut(found: tuple[Array, Array, Array, Array]) -> tuple:
        level, kept, label, large = found
        weakest = jnp.where(kept, strength, jnp.inf).min(1, initial=jnp.inf)
        weakest = jnp.full_like(level, jnp.inf).at[label].min(weakest)[label]
        faint = jnp.clip(2 * level, FAINT, PLAIN)
        return look(jnp.where(large, jnp.maximum(weakest, faint), level))

    level = jnp.full(len(strength), least, strength.dtype)
    found = jax.lax.while_loop(lambda found: found[3].any(), cut, look(level))
    return found[1], found[2]


def ties(views: Views, num_leaves: int) -> Array:
    """Returns how much trees tell of each other, [N, N]; inf of themselves.

    It is the largest difference, over their leaves, between the probability of a pair
    and that of its parts multiplied.

    Args:
        views: What may be.
        num_leaves: L.
    """
    prob = jnp.exp(views.log_prob)[..., None]
    has = views.leaf[..., None] == jnp.arange(num_leaves)[None, None]
    mine = jnp.where(has, prob, 0.0)  # [H, N, L]
    both = jnp.einsum(
        "hia,hjb->iajb", mine, has.astype(mine.dtype), precision="highest"
    )
    alone = mine.sum(0)
    apart = alone[:, :, None, None] * alone[None, None]
    gap = jnp.abs(both - apart).max((1, 3))
    same = views.label[:, None] == views.label[None]
    return jnp.where(jnp.eye(len(gap), dtype=bool), jnp.inf, jnp.where(same, gap, 0.0))


def split(
    views: Views, num_leaves: int, threshold: float, max_trees: int
) -> tuple[Views, Array]:
    """Splits clusters into parts that tell nothing of each other.

    Args:
        views: What may be.
        num_leaves: L.
        threshold: Trees whose `ties` are no stronger are independent.
        max_trees: Larger clusters are split at their weakest ties all the same.

    Returns:
        The smaller clusters, the likeliest rows first, and the strength of the ties cut
        for want of room.
    """
    strength = jax.lax.stop_gradient(ties(views, num_leaves))
    num = len(strength)
    least = threshold + NEARLY * float(jnp.finfo(strength.dtype).eps)
    _, label = fit(strength, least, max_trees, num)
    apart = (label[:, None] != label[None]) & (strength > least)
    return marginal(views, label), jnp.where(apart, strength, 0.0).sum() / 2


def marginal(views: Views, label: Array) -> Views:
    """Returns the hypotheses about parts of the clusters, the likeliest first.

    Args:
        views: What may be.
        label: The first tree of each tree's part, [N].
    """
    leaf, prob = views.leaf.T, jnp.exp(views.log_prob).T  # [N, H]
    row = jnp.arange(leaf.shape[1])
    differs = leaf[:, :, None] != leaf[:, None]
    differs = jnp.zeros(differs.shape, jnp.int32).at[label].add(differs)
    equal = differs == 0  # in the whole part, by its first tree
    again = (equal & (row[None, None] < row[None, :, None])).any(2)
    total = jnp.where(equal, prob[:, None], 0.0).sum(2)
    log_prob = safe_log(jnp.where(again, 0.0, total))
    order = jnp.argsort(-log_prob, axis=1)
    log_prob = jnp.take_along_axis(log_prob, order, axis=1)
    leaf = jnp.take_along_axis(leaf, order[label], axis=1)
    return Views(leaf.T, log_prob[label].T, label)


def join(views: Views, trees: Array) -> tuple[Hypotheses, Array]:
    """Makes one cluster of some: each row a row of all, the heaviest kept.

    Args:
        views: What may be, the likeliest rows first.
        trees: All trees of these clusters in ascending order, N for none, [n].

    Returns:
        H hypotheses about the n trees, normalised, and the log-share of the weight
        that they had before.
    """
    there, at = trees < views.label.size, jnp.minimum(trees, views.label.size - 1)
    label = views.label[at]
    lead = there & (label == at)
    rows = jnp.where(lead[None], views.log_prob[:, at], _certain(views)[:, None])
    log_weight, row = product(rows.T)
    place = jnp.argmax(lead[:, None] & (label[None] == at[:, None]), axis=0)
    leaf = jnp.where(there[None], views.leaf[row[:, place], at[None]], -1)
    log_share = jnp.minimum(mixture.total(log_weight), 0.0)
    return Hypotheses(mixture.log_normalise(log_weight), leaf), log_share


def likeliest(views: Views) -> Array:
    """Returns the log-probabilities of the likeliest H hypotheses about all trees."""
    rows = jnp.where(leads(views)[None], views.log_prob, _certain(views)[:, None])
    return product(rows.T)[0]


def product(log_weight: Array) -> tuple[Array, Array]:
    """Returns the H heaviest ways to take a row from each of n lists.

    Args:
        log_weight: Lists of H rows, the heaviest first, [n, H].

    Returns:
        Their log-weights [H], the heaviest first, and their rows [H, n].
    """
    num, size = log_weight.shape
    one, other = _pairs(size)
    row = jnp.arange(size) == 0
    start = jnp.where(row, 0.0, -jnp.inf).astype(log_weight.dtype)

    def take(held: tuple[Array, Array], given: tuple[Array, Array]) -> tuple:
        log_weight, place = given
        both, at = jax.lax.top_k(held[0][one] + log_weight[other], size)
        rows = held[1][jnp.asarray(one)[at]]
        return (both, rows.at[:, place].set(jnp.asarray(other)[at])), None

    rows = jnp.zeros((size, num), jnp.int32)
    given = log_weight, jnp.arange(num)
    return jax.lax.scan(take, (start, rows), given)[0]


@functools.cache
def _pairs(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the pairs of places in two sorted lists that may be among the heaviest.

    The pair (a, b) has no fewer than (a + 1) (b + 1) - 1 others ahead of it.
    """
    place = np.arange(1, size + 1)
    one, other = np.nonzero(place[:, None] * place[None] <= size)
    return one.astype(np.int32), other.astype(np.int32)


def _certain(views: Views) -> Array:
    """Returns a list of a single row, which changes nothing in a product, [H]."""
    row = jnp.arange(len(views.log_prob))
    return jnp.where(row == 0, 0.0, -jnp.inf).astype(views.log_prob.dtype)
