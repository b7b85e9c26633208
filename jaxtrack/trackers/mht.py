"""Multiple hypothesis tracking, track by track: trees of track hypotheses.

Every track tree keeps the likeliest of its leaves, whichever global hypothesis they may
belong to. Hypotheses are made only when they are needed: an assignment over the last
scans gives each tree one leaf, and no detection to two. The best of them decides what
lies `num_scans` scans back: leaves that say otherwise go. One scan is

    trees, hidden = predict(trees, hidden)
    scores, firsts = look(trees, hidden, scan)
    trees = each leaf followed by the detections in its gate, the likeliest kept
    hypotheses = assign(trees)                    # over num_scans + 1 scans
    trees = those that agree with the best hypothesis, num_scans ago

With `num_scans=0` it decides at once, as global nearest neighbour does.
`mht(target=imm())` is IMM-MHT.

`log_evidence` is the log-density of the scan given the leaves that were kept, summed
over the hypotheses that were found; `log_loss` tells how much better than the best of
these another one may be.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import mht
    >>> tracker = mht.mht(targets.single.single(), num_scans=2)

References: Kurien, "Issues in the design of practical multitarget tracking algorithms",
in Multitarget-Multisensor Tracking, ed. Bar-Shalom, 1990; Poore, "Multidimensional
assignment formulation of data association problems arising from multitarget and
multisensor tracking", Computational Optimization and Applications 3, 1994; Chong, Mori
and Reid, "Forty years of multiple hypothesis tracking", Journal of Advances in
Information Fusion 14(2), 2019, section IV.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate, mixture
from jaxtrack.trackers import (
    association,
    deciding,
    forest,
    meeting,
    multiscan_choice,
    retrodiction,
    thinning,
    undetected,
    verdict,
)
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, Scan, Target, Tracker


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        trees: N trees with L leaves, of S = num_scans + 1 scans.
        best: The leaf that the best hypothesis has of each, -1 for none, [N].
        sure: Which trees are in every hypothesis, by decision, [N] (bool).
        log_total: Log-weight of all hypotheses about these trees that were found.
        undetected: U components.
        next_label: The first free label.
        key: Random key.
        history: Of the leaves, if a delayed output was asked for.
    """

    trees: Forest
    best: Array
    sure: Array
    log_total: Array
    undetected: Undetected
    next_label: Array
    key: Array
    history: retrodiction.History | None = None


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    choose: multiscan_choice.Chooser
    max_leaves: int
    max_undetected: int
    num_scans: int
    gating: association.Gating
    thinning: thinning.Thinning
    report_threshold: float
    delay: int | None


@functools.cache
def mht(
    target: Target,
    num_scans: int = 2,
    solver: str = "lagrangian",
    max_hypotheses: int = 32,
    max_tracks: int = 64,
    max_leaves: int = 10,
    max_undetected: int = 16,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-5,
    exist_threshold: float = 1e-3,
    report_threshold: float = 0.5,
    delay: int | None = None,
) -> Tracker:
    """Makes a track-oriented multiple hypothesis tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        num_scans: Scans after which the best hypothesis decides; 0 decides at once.
        solver: How that is found: "lagrangian", "decomposition", "greedy", or "exact",
            which calls SciPy's HiGHS on the host.
        max_hypotheses: Hypotheses by which probabilities are found, the likeliest; with
            1 the best is believed.
        max_tracks: Trees kept after a scan.
        max_leaves: Leaves kept of each, the likeliest; that nothing more was detected
            may always be one of them.
        max_undetected: Components kept of the intensity of undetected targets.
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Leaves of less weight than this share of their tree's go.
        exist_threshold: A tree goes where its target exists with less probability.
        report_threshold: A track of the best hypothesis is reported where its target
            exists with more probability.
        delay: Scans after which where the targets were is reported once more, smoothed;
            at least `num_scans`. None for no such output.

    Raises:
        ValueError: A setting that makes no sense.
    """
    sizes = {
        "max_hypotheses": max_hypotheses,
        "max_tracks": max_tracks,
        "max_leaves": max_leaves,
        "max_undetected": max_undetected,
    }
    thinning.check_sizes(sizes)
    if max_leaves == 1:
        raise ValueError("max_leaves is 1; give at least 2, one for a miss")
    if num_scans < 0:
        raise ValueError(f"num_scans is {num_scans}; give 0 or more")
    gate.check(gate_prob)
    limits = thinning.Thinning(max_tracks, prune_threshold, exist_threshold)
    thinning.check(limits)
    thinning.check_share("report_threshold", report_threshold)
    retrodiction.check(delay, num_scans, target)
    settings = Settings(
        target=target,
        choose=multiscan_choice.chooser(solver, max_hypotheses),
        max_leaves=max_leaves,
        max_undetected=max_undetected,
        num_scans=num_scans,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        thinning=limits,
        report_threshold=report_threshold,
        delay=delay,
    )
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with the known targets."""
    keys, target = jax.random.split(key, 3), settings.target
    hidden = undetected.begin(target, params, settings.max_undetected, keys[0])
    shape = settings.thinning.max_tracks, settings.max_leaves, settings.num_scans + 1
    trees = forest.begin(target, params, shape, keys[1])
    zero = jnp.zeros((), trees.log_score.dtype)
    known = trees.label >= 0
    best = jnp.where(known, 0, -1).astype(jnp.int32)
    history = None
    if settings.delay is not None:
        history = retrodiction.begin(trees, settings.delay)
    return State(trees, best, known, zero, hidden, known.sum(), keys[2], history)


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, verdict.Estimate]:
    """Predicts, scores, grows the trees, finds the hypotheses, decides and prunes."""
    target, scan = settings.target, association.filled(scan)
    key, seed = jax.random.split(state.key)
    before = state.trees, state.undetected
    met = meeting.meet(settings.gating, target, params, *before, scan, seed)
    trees, parent, lost_leaves = _grow(settings, params, met, state, scan)
    trees, label = forest.plant(trees, met.firsts, state.next_label)
    history = state.history
    if history is not None:
        history = retrodiction.remember(
            history, met.trees.log_score, trees, parent, scan.interval
        )
    sure = jnp.pad(state.sure, (0, len(scan.valid)))
    found = settings.choose(trees, sure, len(scan.valid))
    hidden, unseen = undetected.reduce(met.firsts.missed, settings.max_undetected)
    estimate = verdict.report(
        target,
        trees,
        found.views,
        jnp.exp(found.log_joint - found.log_total),
        hidden.expected,
        settings.report_threshold,
        log_evidence=found.log_total - state.log_total + met.log_constant,
        dropped=unseen,
        log_loss=found.log_loss,
    )
    leaf = verdict.leaves(trees, found.views)
    awaited = False if history is None else retrodiction.awaited(history, leaf[0])
    limits, number = settings.thinning, len(scan.valid)
    pruned = deciding.decide(
        limits, settings.num_scans, trees, sure, found, number, awaited
    )
    kept = pruned.kept
    estimate = _some(estimate, kept, lost_leaves)
    if history is not None:
        history = retrodiction.keep(history, kept)
        here = leaf[0][kept], leaf[1][kept]
        about = target, params.target, history, pruned.trees, here
        past = retrodiction.retrodict(*about, settings.report_threshold)
        estimate = estimate._replace(retrodicted=past)
    return State(*pruned[:4], hidden, label, key, history), estimate


def _grow(
    settings: Settings,
    params: Params,
    met: meeting.Meeting,
    state: State,
    scan: Scan,
) -> tuple[Forest, Array, Array]:
    """Follows leaves by detections; returns their old leaves and what was lost, too.

    Only the likeliest of them are corrected. That the best hypothesis goes on with
    nothing detected is always among them, so that there is one that is possible.
    """
    trees, size = met.trees, settings.max_leaves
    score = trees.log_score[:, :, None] + met.sight.log_score  # [N, L, K + 1]
    columns = score.shape[2]
    every = score.reshape(len(score), -1)
    last = state.best * columns + columns - 1
    safe = jnp.arange(every.shape[1])[None] == last[:, None]
    rank = jnp.where(safe & (every > -jnp.inf), jnp.inf, every)
    best, at = jax.lax.top_k(rank, min(size, every.shape[1]))
    nothing = jnp.where(state.sure, -jnp.inf, 0.0)
    floor = jnp.maximum(every.max(1), nothing) + jnp.log(
        settings.thinning.prune_threshold
    )
    there = (best > -jnp.inf) & (best >= floor[:, None])
    if (short := size - best.shape[1]) > 0:
        at, there = (jnp.pad(x, ((0, 0), (0, short))) for x in (at, there))
    parent, column = jnp.divmod(at, columns)
    grown = forest.follow(
        settings.target,
        params.target,
        trees,
        met.sight,
        scan,
        parent,
        column,
        there,
    )
    total = jax.vmap(mixture.total)
    held, all_of_it = total(grown.log_score), total(every)
    known = all_of_it > -jnp.inf
    share = jnp.where(known, held, 0.0) - jnp.where(known, all_of_it, 0.0)
    return grown, parent, jnp.where(known, -jnp.expm1(jnp.minimum(share, 0.0)), 0.0)


def _some(
    estimate: verdict.Estimate, kept: Array, lost_leaves: Array
) -> verdict.Estimate:
    """Returns the estimate about the trees that were kept, and adds what was not."""
    prob = estimate.existence_prob
    lost = (prob[: lost_leaves.size] * lost_leaves).sum()
    gone = jnp.maximum(prob.sum() - prob[kept].sum(), 0.0)
    estimate = estimate._replace(dropped=estimate.dropped + lost + gone)
    per_tree = {
        name: getattr(estimate, name)[kept]
        for name in ("mean", "cov", "label", "exists", "existence_prob", "mode_prob")
    }
    return estimate._replace(effective_size=estimate.effective_size[kept], **per_tree)
