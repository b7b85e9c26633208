"""One scan of hypotheses that are kept cluster by cluster: join, follow, put back.

Clusters into whose gates the same detections fell become one and are searched for
their likeliest joint events, side by side, each in matrices of its own small size. What
has no detection, and detections in nobody's gate, need no search.

    >>> from jaxtrack.trackers import cluster_search
    >>> cluster_search.Found._fields
    ('views', 'begun', 'log_total', 'log_share', 'cut')

Reference: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979, section V.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.assign import clusters
from jaxtrack.assign.k_best_of_many import k_best_of_many
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import global_hypotheses, hypothesis_clusters
from jaxtrack.trackers.verdict import Views
from jaxtrack.types import Array


class Room(NamedTuple):
    """How much is searched.

    Attributes:
        max_children: Children found of a cluster's hypotheses, the heaviest; no fewer
            than stay.
        max_clusters: C, clusters with detections.
        max_members: Trees of each.
        max_detections: Detections of each.
    """

    max_children: int
    max_clusters: int
    max_members: int
    max_detections: int


class Plan(NamedTuple):
    """Which clusters are searched.

    Attributes:
        tree: Their trees in ascending order, N for none, [C, n].
        item: Their detections, K for none, [C, k].
        of_tree: The first tree of each tree's new cluster, [N].
        of_item: The same of each detection; N + its own place if it is in no cluster,
            [K].
        cut: How many detections of targets are expected that found no room.
    """

    tree: Array
    item: Array
    of_tree: Array
    of_item: Array
    cut: Array


class Found(NamedTuple):
    """The hypotheses after a scan.

    Attributes:
        views: Of N trees, a leaf told by its code: the old one times K + 1, plus the
            column of the detection. Weights are not normalised.
        begun: The same of K trees begun now, whose only leaf is 0.
        log_total: Log-weight of all that was proposed in a tree's cluster, [N + K].
        log_share: What joining clusters kept of the weight, its log, [N + K].
        cut: See `Plan`.
    """

    views: Views
    begun: Views
    log_total: Array
    log_share: Array
    cut: Array


class _Columns(NamedTuple):
    """What the hypotheses of a tree's cluster are, of N trees.

    Attributes:
        log_weight: [H, N]; of a single cluster [H].
        leaf: [H, N].
        log_total: [N]; of a single cluster a scalar.
        log_share: The same.
    """

    log_weight: Array
    leaf: Array
    log_total: Array
    log_share: Array


def search(room: Room, views: Views, log_score: Array, log_first: Array) -> Found:
    """Follows the hypotheses of all clusters.

    Args:
        room: How much.
        views: What may be, the likeliest rows first.
        log_score: Of every leaf, [N, L, K + 1].
        log_first: Of a target detected for the first time, [K].
    """
    planned = plan(room, views, log_score)

    def follow(tree: Array, item: Array) -> tuple[_Columns, _Columns]:
        return _follow(room.max_children, views, log_score, log_first, tree, item)

    followed, begun = jax.vmap(follow)(planned.tree, planned.item)
    old = _put(_missed(views, log_score), planned.tree, followed)
    new = _put(_alone(log_first, len(views.leaf)), planned.item, begun)
    return Found(
        views=Views(old.leaf, old.log_weight, planned.of_tree),
        begun=Views(new.leaf, new.log_weight, planned.of_item),
        log_total=jnp.concatenate([old.log_total, new.log_total]),
        log_share=jnp.concatenate([old.log_share, new.log_share]),
        cut=planned.cut,
    )


def plan(room: Room, views: Views, log_score: Array) -> Plan:
    """Finds which clusters are to be joined and searched.

    Where they are too large for the room, their least likely detections are cut; where
    there are too many, those that expect the fewest detections are taken for missed.

    Args:
        room: How much.
        views: What may be.
        log_score: Of every leaf, [N, L, K + 1].
    """
    num, _, columns = log_score.shape
    likely = jax.lax.stop_gradient(_likely(views, log_score))  # [N, K]
    same = views.label[:, None] == views.label[None]
    strength = jnp.where(same[:, :, None], likely[None], 0.0).max(1)
    linked, label = hypothesis_clusters.fit(
        strength, 0.0, room.max_members, room.max_detections
    )
    worth = jnp.zeros(num).at[label].add(jnp.where(linked, likely, 0.0).sum(1))
    worth, lead = jax.lax.top_k(worth, min(room.max_clusters, num))
    lead = jnp.where(worth > 0, lead, -1)
    chosen = (label[:, None] == lead[None]).any(1)
    linked = linked & chosen[:, None]
    label = jnp.where(chosen, label, views.label)
    of_item = clusters.of_items(linked[..., None], label[:, None])[:, 0]

    def members(lead: Array) -> tuple[Array, Array]:
        tree = jnp.nonzero(label == lead, size=room.max_members, fill_value=num)[0]
        item = jnp.nonzero(
            of_item == lead, size=room.max_detections, fill_value=columns - 1
        )[0]
        return tree, item

    tree, item = jax.vmap(members)(lead)
    own = num + jnp.arange(columns - 1)
    of_item = jnp.where(of_item < num, of_item, own)
    cut = jnp.where(label[:, None] == of_item[None], 0.0, likely).sum()
    return Plan(tree, item, label, of_item, cut)


def _likely(views: Views, log_score: Array) -> Array:
    """Returns how likely each tree has each detection if all others are false, [N, K].

    What is possible is never 0.
    """
    leaves = jnp.arange(log_score.shape[1])
    has = views.leaf[..., None] == leaves[None, None]
    prob = jnp.where(has, jnp.exp(views.log_prob)[..., None], 0.0).sum(0)  # [N, L]
    each = safe_log(prob)[..., None] + log_score
    odds = jax.vmap(mixture.total)(each)
    absent = safe_log(jnp.maximum(1 - prob.sum(1), 0.0))
    none = jnp.logaddexp(odds[:, -1], absent)
    odds = odds[:, :-1]
    most = jnp.concatenate([odds, none[:, None]], 1).max(1, keepdims=True)
    weight = jnp.exp(odds - most)
    share = weight / (weight.sum(1, keepdims=True) + jnp.exp(none[:, None] - most))
    least = jnp.finfo(share.dtype).tiny
    return jnp.where(odds > -jnp.inf, jnp.maximum(share, least), 0.0)


def _put(into: _Columns, at: Array, found: _Columns) -> _Columns:
    """Puts what C clusters found into the columns of their trees, [C, n]."""

    def rows(values: Array) -> Array:
        return jnp.moveaxis(values, 1, 0).reshape(values.shape[1], -1)

    place, size = at.ravel(), at.shape[1]
    weight = jnp.broadcast_to(found.log_weight[..., None], found.leaf.shape)
    leaf = rows(found.leaf).astype(into.leaf.dtype)
    total, share = (jnp.repeat(x, size) for x in found[2:])
    return _Columns(
        into.log_weight.at[:, place].set(rows(weight), mode="drop"),
        into.leaf.at[:, place].set(leaf, mode="drop"),
        into.log_total.at[place].set(total, mode="drop"),
        into.log_share.at[place].set(share, mode="drop"),
    )


def _missed(views: Views, log_score: Array) -> _Columns:
    """Returns the hypotheses if nobody is detected; leaves by their codes."""
    last = log_score.shape[2] - 1
    tree = jnp.arange(len(log_score))[None]
    there = views.leaf >= 0
    miss = log_score[tree, jnp.maximum(views.leaf, 0), last]
    miss = jnp.where(there, miss, 0.0)
    same = views.label[:, None] == views.label[None]
    weight = views.log_prob + jnp.where(same[None], miss[:, :, None], 0.0).sum(1)
    code = jnp.where(there, views.leaf * (last + 1) + last, -1)
    total = mixture.total(weight)
    return _Columns(weight, code, total, jnp.zeros_like(total))


def _alone(log_first: Array, size: int) -> _Columns:
    """Returns H hypotheses about each detection alone: it is new, or it is false."""
    zero = jnp.zeros_like(log_first)
    new = log_first >= 0
    row = jnp.arange(size)[:, None]
    begins = jnp.where(new[None], row == 0, row == 1)
    weight = jnp.where(begins, log_first[None], zero[None])
    weight = jnp.where(row < 2, weight, -jnp.inf)
    total = jax.vmap(mixture.total)(jnp.stack([log_first, zero], axis=1))
    leaf = jnp.where(begins, 0, -1)
    return _Columns(weight, leaf, total, jnp.zeros_like(total))


def _follow(
    max_children: int,
    views: Views,
    log_score: Array,
    log_first: Array,
    tree: Array,
    item: Array,
) -> tuple[_Columns, _Columns]:
    """Follows the hypotheses of one cluster.

    Args:
        max_children: See `Room`.
        views: What may be.
        log_score: Of every leaf, [N, L, K + 1].
        log_first: Of a target detected for the first time, [K].
        tree: The cluster's trees, N for none, [n].
        item: Its detections, K for none, [k].

    Returns:
        What becomes of its n trees, leaves by their codes, and of k new ones.
    """
    num, _, columns = log_score.shape
    hypotheses, share = hypothesis_clusters.join(views, tree)
    column = jnp.append(item, columns - 1)
    here = jnp.minimum(item, columns - 2)
    own = log_score[jnp.minimum(tree, num - 1)][:, :, column]
    real = jnp.append(item < columns - 1, jnp.array(True))
    own = jnp.where(real[None, None], own, -jnp.inf)
    new = jnp.where(item < columns - 1, log_first[here], -jnp.inf)
    scores = global_hypotheses.score(hypotheses, own, new)
    size = hypotheses.log_weight.size
    number = max(max_children, size)
    found = k_best_of_many(scores, hypotheses.log_weight, number, number)
    total = mixture.total(found.log_weight)
    weight, parent, to = (x[:size] for x in found[:3])
    leaf = hypotheses.leaf[parent]
    code = jnp.where(leaf >= 0, leaf * columns + column[to[:, : tree.size]], -1)
    begun = jnp.where(to[:, tree.size :] < item.size, 0, -1)
    return (
        _Columns(weight, code, total, share),
        _Columns(weight, begun, total, share),
    )
