"""Multiple hypothesis tracking, hypothesis by hypothesis: Reid's algorithm.

A hypothesis says of every detection so far which target caused it, or that it is false.
Each is followed by its likeliest joint events (Murty), and of all that come out the
heaviest stay. What they have in common is kept once, as trees of tracks. One scan is

    trees, hidden = predict(trees, hidden)
    scores, firsts = look(trees, hidden, scan)
    hypotheses = heaviest(children(hypotheses, scores))
    trees = correct(the leaves that these need)
    merge leaves that are alike, and then hypotheses; prune

`hypothesis_mht(target=imm())` is IMM-MHT. `mht` is the same by tracks, and looks back
over several scans.

`log_evidence` is the log-density of the scan given the hypotheses that were kept,
summed over the joint events that were proposed: exact while there is room for all.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import hypothesis_mht
    >>> tracker = hypothesis_mht.hypothesis_mht(targets.single.single())

References: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979; Cox and Hingorani, "An efficient implementation of Reid's multiple
hypothesis tracking algorithm", IEEE Trans. Pattern Analysis and Machine Intelligence
18(2), 1996; Chong, Mori and Reid, "Forty years of multiple hypothesis tracking",
Journal of Advances in Information Fusion 14(2), 2019.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate, mixture
from jaxtrack.trackers import (
    association,
    forest,
    global_hypotheses,
    meeting,
    thinning,
    undetected,
    verdict,
)
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.global_hypotheses import Hypotheses
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, Scan, Target, Tracker


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        trees: N trees with L leaves.
        hypotheses: H.
        undetected: U components.
        next_label: The first free label.
        key: Random key.
    """

    trees: Forest
    hypotheses: Hypotheses
    undetected: Undetected
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    max_hypotheses: int
    max_children: int
    max_leaves: int
    max_undetected: int
    gating: association.Gating
    thinning: thinning.Thinning
    report_threshold: float


@functools.cache
def hypothesis_mht(
    target: Target,
    max_hypotheses: int = 100,
    max_children: int = 10,
    max_tracks: int = 32,
    max_leaves: int = 8,
    max_undetected: int = 16,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-5,
    exist_threshold: float = 1e-4,
    merge_threshold: float = 0.0,
    report_threshold: float = 0.5,
) -> Tracker:
    """Makes a hypothesis-oriented multiple hypothesis tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_hypotheses: Hypotheses kept after a scan, the heaviest.
        max_children: Joint events by which each is followed, the likeliest.
        max_tracks: Trees kept, those most likely to be a target that is still there.
        max_leaves: Different histories kept of each, the likeliest.
        max_undetected: Components kept of the intensity of undetected targets.
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Hypotheses of less probability go.
        exist_threshold: A track goes from a hypothesis where its target exists with
            less probability.
        merge_threshold: Histories of one target become one where the squared
            Mahalanobis distance of their states is less; 0 for never.
        report_threshold: A track of the best hypothesis is reported where its target
            exists with more probability.

    Raises:
        ValueError: A setting that makes no sense.
    """
    sizes = {
        "max_hypotheses": max_hypotheses,
        "max_children": max_children,
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
    thinning.check_share("report_threshold", report_threshold)
    gating = association.Gating(gate_prob, in_missed=False, counts_clutter=False)
    settings = Settings(
        target=target,
        max_hypotheses=max_hypotheses,
        max_children=max_children,
        max_leaves=max_leaves,
        max_undetected=max_undetected,
        gating=gating,
        thinning=limits,
        report_threshold=report_threshold,
    )
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with one hypothesis."""
    keys, target = jax.random.split(key, 3), settings.target
    hidden = undetected.begin(target, params, settings.max_undetected, keys[0])
    shape = settings.thinning.max_tracks, settings.max_leaves, 1
    trees = forest.begin(target, params, shape, keys[1])
    known = trees.label >= 0
    dtype = trees.log_score.dtype
    hypotheses = global_hypotheses.first(settings.max_hypotheses, known, dtype)
    return State(trees, hypotheses, hidden, known.sum(), keys[2])


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, verdict.Estimate]:
    """Predicts, scores, follows each hypothesis by its events, keeps the heaviest."""
    target, scan = settings.target, association.filled(scan)
    key, seed = jax.random.split(state.key)
    met = meeting.meet(
        settings.gating, target, params, state.trees, state.undetected, scan, seed
    )
    scores = global_hypotheses.score(
        state.hypotheses, met.sight.log_score, met.firsts.log_score
    )
    children = global_hypotheses.follow(state.hypotheses, scores, settings.max_children)
    trees, hypotheses, label = _grow(settings, params, state, met, children, scan)
    share = mixture.total(hypotheses.log_weight) - children.log_total
    trees, hypotheses, lost = thinning.thin(
        target, settings.thinning, trees, hypotheses
    )
    hidden, unseen = undetected.reduce(met.firsts.missed, settings.max_undetected)
    estimate = verdict.report(
        target,
        trees,
        verdict.joint(hypotheses.leaf, hypotheses.log_weight),
        jnp.exp(hypotheses.log_weight),
        hidden.expected,
        settings.report_threshold,
        log_evidence=children.log_total + met.log_constant,
        dropped=lost + unseen,
    )
    missing = -jnp.expm1(jnp.minimum(share, 0.0)) * estimate.num_mean
    estimate = estimate._replace(dropped=estimate.dropped + missing)
    return State(trees, hypotheses, hidden, label, key), estimate


def _grow(
    settings: Settings,
    params: Params,
    state: State,
    met: meeting.Meeting,
    children: global_hypotheses.Children,
    scan: Scan,
) -> tuple[Forest, Hypotheses, Array]:
    """Corrects the leaves that the children need, and begins trees."""
    num, columns = settings.thinning.max_tracks, len(scan.valid) + 1
    wanted = _leaves(settings, state.hypotheses, children, columns)
    code = wanted.code[:num]
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
    trees, label = forest.plant(trees, met.firsts, state.next_label)
    return trees, wanted.hypotheses, label


def _leaves(
    settings: Settings,
    before: Hypotheses,
    children: global_hypotheses.Children,
    columns: int,
) -> global_hypotheses.Leaves:
    """Finds which leaves the children need: an old one and a column make a code."""
    num = settings.thinning.max_tracks
    old = before.leaf[children.parent]  # [H, N]
    again = old * columns + children.column[:, :num]
    new = jnp.where(children.column[:, num:] < columns - 1, 0, -1)
    code = jnp.concatenate([jnp.where(old >= 0, again, -1), new], axis=1)
    return global_hypotheses.distinct(
        Hypotheses(children.log_weight, code),
        settings.max_leaves,
        settings.max_leaves * columns,
    )
