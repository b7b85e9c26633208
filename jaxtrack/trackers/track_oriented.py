"""Track-oriented trackers: the scan of `mht`, `tpmbm` and `tmbm`.

Trees of track hypotheses, of which an assignment over the last scans makes hypotheses
about all targets when they are needed. One scan is

    trees, hidden = predict(trees, hidden)
    scores, firsts = look(trees, hidden, scan)
    trees = each leaf followed by the detections in its gate, the likeliest kept
    hypotheses = assign(trees)                    # over num_scans + 1 scans
    trees = those that agree with the best hypothesis, num_scans ago

What each has in its own way is what a track's first leaf says. For `mht` there is a
target, and that there is none is another hypothesis. For the others it is a Bernoulli,
which says how likely there is one: with a Poisson number of births (`hides`) it begins
with a detection that nobody else has; with multi-Bernoulli births it begins with the
birth, and what no track has is clutter.

    >>> from jaxtrack.trackers import track_oriented
    >>> track_oriented.State._fields[:3]
    ('trees', 'best', 'sure')

References: see `mht` and `tpmbm`.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate
from jaxtrack.trackers import (
    arrivals,
    association,
    deciding,
    forest,
    growing,
    multiscan_choice,
    remembering,
    retrodiction,
    thinning,
    trajectories,
    undetected,
    verdict,
)
from jaxtrack.trackers.arrivals import Met
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
        undetected: U components; none with multi-Bernoulli births.
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
    history: remembering.History | None = None


class Settings(NamedTuple):
    """The maker's arguments; see `mht` and `tpmbm`.

    `bernoulli` says that tracks are, `hides` that targets are undetected until a
    detection begins their track, and `certain` that every leaf says whether its target
    is there. With `trajectories` "alive" those that ended are forgotten.
    """

    target: Target
    solver: str
    max_hypotheses: int
    max_leaves: int
    max_undetected: int
    num_scans: int
    gating: association.Gating
    thinning: thinning.Thinning
    report_threshold: float
    delay: int | None
    bernoulli: bool = False
    hides: bool = True
    certain: bool = False
    max_begun: int | None = None
    trajectories: str = "all"
    num_birth_times: int = 0

    @property
    def alive_only(self) -> bool:
        """Tells whether only targets that are there now are followed."""
        return self.trajectories == "alive"


def make(settings: Settings) -> Tracker:
    """Makes a tracker.

    Raises:
        ValueError: A setting that makes no sense.
    """
    limits = settings.thinning
    sizes = {
        name: getattr(settings, name)
        for name in ("max_hypotheses", "max_leaves", "max_undetected")
    }
    if settings.max_begun is not None:
        sizes["max_begun"] = settings.max_begun
    thinning.check_sizes({**sizes, "max_tracks": limits.max_tracks})
    if settings.max_leaves == 1:
        raise ValueError("max_leaves is 1; give at least 2, one for a miss")
    if settings.num_scans < 0:
        raise ValueError(f"num_scans is {settings.num_scans}; give 0 or more")
    if settings.trajectories not in ("all", "alive"):
        raise ValueError(
            f"trajectories is {settings.trajectories!r}; give 'all' or 'alive'"
        )
    gate.check(settings.gating.prob)
    thinning.check(limits)
    thinning.check_share("report_threshold", settings.report_threshold)
    retrodiction.check(settings.delay, settings.num_scans, settings.target)
    _chooser(settings)
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _chooser(settings: Settings) -> multiscan_choice.Chooser:
    """Returns what finds the hypotheses."""
    return multiscan_choice.chooser(
        settings.solver, settings.max_hypotheses, settings.bernoulli and settings.hides
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with the known targets."""
    if settings.bernoulli:
        arrivals.check(params, settings.hides, recycles=False)
    keys, target = jax.random.split(key, 3), settings.target
    shape = settings.thinning.max_tracks, settings.max_leaves, settings.num_scans + 1
    trees = forest.begin(target, params, shape, keys[1])
    if settings.hides:
        room = settings.max_undetected
        hidden = undetected.begin(
            target, params, room, keys[0], settings.num_birth_times
        )
    else:
        belief = jax.tree.map(lambda x: x[:0, 0], trees.belief)
        hidden = Undetected(trees.log_score[:0, 0], belief)
    zero = jnp.zeros((), trees.log_score.dtype)
    known = trees.label >= 0
    best = jnp.where(known, 0, -1).astype(jnp.int32)
    history = None
    if settings.delay is not None:
        times = settings.num_birth_times
        history = remembering.begin(trees, settings.delay, times)
    return State(trees, best, known, zero, hidden, known.sum(), keys[2], history)


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, verdict.Estimate]:
    """Predicts, scores, grows the trees, finds the hypotheses, decides and prunes."""
    target, scan = settings.target, association.filled(scan)
    key, seed = jax.random.split(state.key)
    met = _meet(settings, params, state, scan, seed)
    grown, sure, held, label, unbegun = _grow(settings, params, state, met, scan)
    trees, history, num = grown.trees, state.history, len(state.best)
    if history is not None:
        before = met.trees.log_score[:num], trees, grown.parent[:num]
        births = None if met.firsts is None else met.firsts.birth_prob
        history = remembering.remember(history, *before, scan.interval, births)
    found = _chooser(settings)(trees, sure, held, len(scan.valid))
    missed = state.undetected if met.firsts is None else met.firsts.missed
    hidden, unseen = undetected.reduce(missed, settings.max_undetected)
    estimate = verdict.report(
        target,
        trees,
        found.views,
        jnp.exp(found.log_joint - found.log_total),
        hidden.expected,
        settings.report_threshold,
        log_evidence=found.log_total - state.log_total + met.log_constant,
        dropped=unseen + unbegun,
        log_loss=found.log_loss,
    )
    leaf = verdict.leaves(trees, found.views)
    limits, window, awaited = settings.thinning, settings.num_scans, False
    if history is not None and not settings.alive_only:
        least = limits.exist_threshold
        awaited = retrodiction.awaited(history, leaf[0], trees.age, least)
    pruned = deciding.decide(
        limits, window, trees, sure, found, len(scan.valid), awaited
    )
    estimate = _some(estimate, pruned.kept, grown.lost)
    if history is not None:
        history = remembering.keep(history, pruned.kept)
        here = leaf[0][pruned.kept], leaf[1][pruned.kept]
        estimate = _look_back(settings, params, history, pruned.trees, here, estimate)
    return State(*pruned[:4], hidden, label, key, history), estimate


def _meet(
    settings: Settings, params: Params, state: State, scan: Scan, key: Array
) -> Met:
    """Lets all that is there meet the scan."""
    known = settings.gating, settings.target, params, state.trees
    rest = scan, state.next_label, key
    if settings.hides:
        return arrivals.hidden(*known, state.undetected, *rest)
    return arrivals.born(*known, settings.certain, *rest)


def _grow(
    settings: Settings, params: Params, state: State, met: Met, scan: Scan
) -> tuple[growing.Grown, Array, Array, Array, Array]:
    """Follows the leaves and begins trees.

    Returns:
        All N trees; which are sure, and which have a first leaf that is possible at any
        rate, [N] (bool); the next free label; and the expected number of targets that
        got no tree.
    """
    born = len(met.trees.label) - len(state.best)
    best, sure = jnp.pad(state.best, (0, born)), jnp.pad(state.sure, (0, born))
    sure = sure.at[len(state.best) :].set(met.trees.label[len(state.best) :] >= 0)
    grown = growing.grow(
        settings.target,
        params.target,
        settings.thinning.prune_threshold,
        met.trees,
        met.sight,
        scan,
        best,
        sure,
        met.log_absent,
    )
    if met.firsts is None:
        new = jnp.arange(sure.size) >= len(state.best)
        age = jnp.where(new & sure, 1, grown.trees.age)
        trees, label = grown.trees._replace(age=age), met.next_label
        if settings.certain and settings.alive_only:
            trees = growing.forget_ends(trees)
        unbegun = jnp.zeros_like(met.log_constant)
    else:
        limits = settings.bernoulli, settings.max_begun
        trees, label, unbegun = growing.plant(
            *limits, grown.trees, met.firsts, met.next_label
        )
    begun = len(trees.label) - sure.size
    sure = jnp.pad(sure, (0, begun))
    held = sure
    if settings.bernoulli:
        held = jnp.concatenate([best >= 0, trees.label[best.size :] >= 0])
    return grown._replace(trees=trees), sure, held, label, unbegun


def _look_back(
    settings: Settings,
    params: Params,
    history: remembering.History,
    trees: Forest,
    leaf: tuple[Array, Array],
    estimate: verdict.Estimate,
) -> verdict.Estimate:
    """Adds where targets were: some scans ago, or in all of the last ones."""
    about = settings.target, params.target, history, trees, leaf
    threshold = settings.report_threshold
    if settings.bernoulli:
        paths = trajectories.paths(*about, threshold, settings.alive_only)
        return estimate._replace(paths=paths)
    past = retrodiction.retrodict(*about, threshold)
    return estimate._replace(retrodicted=past)


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
