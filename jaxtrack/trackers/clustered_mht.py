"""Multiple hypothesis tracking, hypothesis by hypothesis, in clusters: all of Reid's.

`hypothesis_mht` keeps a single list of hypotheses about all targets, and must hold each
doubt about one together with each about another. Here groups of tracks that share no
detections have lists of their own: they are joined when a detection falls into the
gates of two, and split when they have become independent. One scan is

    trees, hidden = predict(trees, hidden)
    scores, firsts = look(trees, hidden, scan)
    clusters = heaviest(children(join(clusters, scores)))
    trees = correct(the leaves that these need)
    merge leaves that are alike; prune; split the clusters

`log_evidence` is the sum over the clusters, each as in `hypothesis_mht`: exact while
there is room for all and what is split is independent.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import clustered_mht
    >>> tracker = clustered_mht.clustered_mht(targets.single.single(), max_members=4)

Reference: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979, section V.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate, mixture
from jaxtrack.trackers import (
    association,
    cluster_search,
    forest,
    global_hypotheses,
    hypothesis_clusters,
    meeting,
    thinning,
    undetected,
    verdict,
)
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.global_hypotheses import Hypotheses
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.trackers.verdict import Views
from jaxtrack.types import Array, Scan, Target, Tracker


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        trees: N trees with L leaves.
        views: The hypotheses, cluster by cluster, the likeliest rows first.
        undetected: U components.
        next_label: The first free label.
        key: Random key.
    """

    trees: Forest
    views: Views
    undetected: Undetected
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    max_hypotheses: int
    max_leaves: int
    max_undetected: int
    room: cluster_search.Room
    gating: association.Gating
    thinning: thinning.Thinning
    split_threshold: float
    report_threshold: float


@functools.cache
def clustered_mht(
    target: Target,
    max_hypotheses: int = 32,
    max_children: int = 128,
    max_clusters: int = 16,
    max_members: int = 6,
    max_detections: int = 8,
    max_tracks: int = 32,
    max_leaves: int = 8,
    max_undetected: int = 16,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-5,
    exist_threshold: float = 1e-4,
    merge_threshold: float = 0.0,
    split_threshold: float = 1e-5,
    report_threshold: float = 0.5,
) -> Tracker:
    """Makes a hypothesis-oriented multiple hypothesis tracker with clusters.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_hypotheses: Hypotheses kept of each cluster after a scan, the heaviest.
        max_children: Found of all hypotheses of a cluster together, the heaviest.
        max_clusters: Clusters that may have detections in a scan; in others all is
            missed.
        max_members: Trees in a cluster. One that would be larger stays divided where
            that matters least, and what is cut counts as `dropped`.
        max_detections: Detections in a cluster's gates, likewise.
        max_tracks: Trees kept, those most likely to be a target that is still there.
        max_leaves: Different histories kept of each, the likeliest.
        max_undetected: Components kept of the intensity of undetected targets.
        gate_prob: P_G; 1 for no gate, and then all tracks are one cluster.
        prune_threshold: Hypotheses of less probability go.
        exist_threshold: A track goes from a hypothesis where its target exists with
            less probability.
        merge_threshold: Histories of one target become one where the squared
            Mahalanobis distance of their states is less; 0 for never.
        split_threshold: Two tracks are independent if no pair of their histories is
            more or less probable by more than this than if they were.
        report_threshold: A track of the best hypothesis is reported where its target
            exists with more probability.

    Raises:
        ValueError: A setting that makes no sense.
    """
    room = cluster_search.Room(max_children, max_clusters, max_members, max_detections)
    sizes = {
        "max_hypotheses": max_hypotheses,
        **room._asdict(),
        "max_tracks": max_tracks,
        "max_leaves": max_leaves,
        "max_undetected": max_undetected,
    }
    thinning.check_sizes(sizes)
    gate.check(gate_prob)
    limits = thinning.Thinning(
        max_tracks, prune_threshold, exist_threshold, merge_threshold
    )
    thinning.check(limits)
    thinning.check_share("split_threshold", split_threshold)
    thinning.check_share("report_threshold", report_threshold)
    settings = Settings(
        target=target,
        max_hypotheses=max_hypotheses,
        max_leaves=max_leaves,
        max_undetected=max_undetected,
        room=room,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        thinning=limits,
        split_threshold=split_threshold,
        report_threshold=report_threshold,
    )
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with one hypothesis, each known target a cluster."""
    keys, target = jax.random.split(key, 3), settings.target
    hidden = undetected.begin(target, params, settings.max_undetected, keys[0])
    shape = settings.thinning.max_tracks, settings.max_leaves, 1
    trees = forest.begin(target, params, shape, keys[1])
    known, dtype = trees.label >= 0, trees.log_score.dtype
    views = hypothesis_clusters.first(settings.max_hypotheses, known, dtype)
    return State(trees, views, hidden, known.sum(), keys[2])


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, verdict.Estimate]:
    """Predicts, scores, follows each hypothesis by its events, keeps the heaviest."""
    target, scan = settings.target, association.filled(scan)
    key, seed = jax.random.split(state.key)
    met = meeting.meet(
        settings.gating, target, params, state.trees, state.undetected, scan, seed
    )
    found = cluster_search.search(
        settings.room, state.views, met.sight.log_score, met.firsts.log_score
    )
    trees, views, label = _grow(settings, params, state, met, found, scan)
    lead = hypothesis_clusters.leads(views)
    log_evidence = jnp.where(lead, found.log_total, 0.0).sum() + met.log_constant
    kept = mixture.total(views.log_prob) - found.log_total
    missing = -jnp.expm1(jnp.minimum(kept + found.log_share, 0.0))
    trees, views, lost = _thin(settings, trees, views, missing)
    hidden, unseen = undetected.reduce(met.firsts.missed, settings.max_undetected)
    estimate = verdict.report(
        target,
        trees,
        views,
        jnp.exp(hypothesis_clusters.likeliest(views)),
        hidden.expected,
        settings.report_threshold,
        log_evidence=log_evidence,
        dropped=lost + unseen + found.cut,
    )
    return State(trees, views, hidden, label, key), estimate


def _grow(
    settings: Settings,
    params: Params,
    state: State,
    met: meeting.Meeting,
    found: cluster_search.Found,
    scan: Scan,
) -> tuple[Forest, Views, Array]:
    """Corrects the leaves that the hypotheses need, and begins trees."""
    columns = len(scan.valid) + 1

    def tree(log_weight: Array, code: Array) -> tuple[Array, Array, Array]:
        wanted = global_hypotheses.distinct(
            Hypotheses(log_weight, code[:, None]),
            settings.max_leaves,
            settings.max_leaves * columns,
        )
        lost = (wanted.hypotheses.log_weight == -jnp.inf) & (log_weight > -jnp.inf)
        return wanted.code[0], wanted.hypotheses.leaf[:, 0], lost

    old, new = found.views, found.begun
    code, leaf, lost = jax.vmap(tree, 1, (0, 1, 1))(old.log_prob, old.leaf)
    parent, column = jnp.divmod(jnp.maximum(code, 0), columns)
    trees = forest.follow(
        settings.target,
        params.target,
        met.trees,
        met.sight,
        scan,
        parent,
        column,
        code >= 0,
    )
    trees, next_label = forest.plant(trees, met.firsts, state.next_label)
    both = jax.tree.map(lambda x, y: jnp.concatenate([x, y], -1), old, new)
    # A row goes from all trees of the cluster if one of them has lost its leaf.
    same = old.label[:, None] == both.label[None]
    gone = (lost[:, :, None] & same[None]).any(1)
    log_prob = jnp.where(gone, -jnp.inf, both.log_prob)
    leaf = jnp.concatenate([leaf, new.leaf.astype(leaf.dtype)], 1)
    return trees, Views(leaf, log_prob, both.label), next_label


def _thin(
    settings: Settings, trees: Forest, views: Views, missing: Array
) -> tuple[Forest, Views, Array]:
    """Drops what is unlikely, merges what is alike, and splits the clusters.

    Args:
        settings: The maker's arguments.
        trees: N + K.
        views: What may be; weights are not normalised.
        missing: Which share of the weight is not there, [N + K].

    Returns:
        N trees, the hypotheses, and the expected number of targets that went.
    """
    limits = settings.thinning

    def prune(log_weight: Array) -> Array:
        rows = Hypotheses(log_weight, jnp.zeros((log_weight.size, 0), int))
        return global_hypotheses.prune(rows, limits.prune_threshold).log_weight

    log_prob, leaf = jax.vmap(prune, 1, 1)(views.log_prob), views.leaf
    if limits.merge_threshold:
        trees, leaf = _merge(settings.target, limits, trees, leaf, log_prob)
    prob = jnp.exp(log_prob)
    number = (prob * verdict.exists(trees, leaf)).sum(0)
    trees, leaf, kept, lost = thinning.strongest(limits, trees, leaf, prob)
    label = views.label[kept]
    label = jnp.argmax(label[:, None] == label[None], axis=1)  # the first of those kept
    views, cut = hypothesis_clusters.split(
        Views(leaf, log_prob[:, kept], label),
        settings.max_leaves,
        settings.split_threshold,
        settings.room.max_members,
    )
    return trees, views, lost + cut + (missing * number).sum()


def _merge(
    target: Target,
    limits: thinning.Thinning,
    trees: Forest,
    leaf: Array,
    log_prob: Array,
) -> tuple[Forest, Array]:
    """Makes one of the leaves of a tree whose states are alike."""

    def tree(one: Forest, leaf: Array, log_prob: Array) -> tuple[Forest, Array]:
        alone = jax.tree.map(lambda x: x[None], one)
        rows = Hypotheses(log_prob, leaf[:, None])
        merged, rows = thinning.merge_leaves(
            target, limits.merge_threshold, alone, rows
        )
        return jax.tree.map(lambda x: x[0], merged), rows.leaf[:, 0]

    return jax.vmap(tree, (0, 1, 1), (0, 1))(trees, leaf, log_prob)
