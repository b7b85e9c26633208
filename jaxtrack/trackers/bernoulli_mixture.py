"""Mixtures of multi-Bernoullis: the scan of `pmbm`, `mbm` and `mbm01`.

A global hypothesis says of every detection so far which track it belongs to, and given
that the targets of its tracks are there or not independently of each other: it is a
multi-Bernoulli. What hypotheses have in common is kept once, as trees of tracks: a leaf
is a Bernoulli, with a probability that the target exists and a belief about it. One
scan is

    trees, hidden = predict(trees, hidden)
    scores, firsts = look(trees, hidden, scan)
    hypotheses = heaviest children of all of them
    trees = correct(the leaves that these need), and a new one for each detection
    prune and merge

What the three have each in their own way is how targets come to be known. With a
Poisson number of births a target is undetected, part of an intensity, until a detection
begins its track. That it does is no hypothesis of its own: the detection that no old
track has is the first of a target with probability e / (e + c), for e expected first
detections there and clutter of density c, and weighs 1 + e / c against clutter. With
multi-Bernoulli births a track begins with the birth, and what no track has is clutter.

    >>> from jaxtrack.trackers import bernoulli_mixture
    >>> bernoulli_mixture.State._fields
    ('trees', 'hypotheses', 'undetected', 'next_label', 'key')

References: see `pmbm`.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.assign.k_best_of_many import Found, k_best_of_many
from jaxtrack.assign.sample_of_many import sample_of_many
from jaxtrack.trackers import (
    arrivals,
    association,
    estimators,
    forest,
    global_hypotheses,
    offspring,
    thinning,
    undetected,
    verdict,
)
from jaxtrack.trackers.arrivals import Met
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.global_hypotheses import Hypotheses
from jaxtrack.trackers.offspring import Offspring
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, Scan, Target, Tracker


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        trees: N trees with L leaves.
        hypotheses: H.
        undetected: U components; none with multi-Bernoulli births.
        next_label: The first free label.
        key: Random key.
    """

    trees: Forest
    hypotheses: Hypotheses
    undetected: Undetected
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments; see `pmbm`.

    `hides` says that targets are undetected until a detection begins their track, and
    `certain` that every hypothesis says of each target whether it is there. With
    `num_sweeps` above 0 children are found by so many sweeps of Gibbs sampling.
    """

    target: Target
    hides: bool
    certain: bool
    max_hypotheses: int
    max_children: int
    max_leaves: int
    max_undetected: int
    max_contested: int | None
    gating: association.Gating
    thinning: thinning.Thinning
    recycle_threshold: float
    estimator: str
    report_threshold: float
    num_sweeps: int = 0


def make(settings: Settings) -> Tracker:
    """Makes a tracker.

    Raises:
        ValueError: A setting that makes no sense.
    """
    sizes = {
        name: getattr(settings, name)
        for name in ("max_hypotheses", "max_children", "max_leaves", "max_undetected")
    }
    sizes["max_tracks"] = settings.thinning.max_tracks
    if settings.max_contested is not None:
        sizes["max_contested"] = settings.max_contested
    thinning.check_sizes(sizes)
    if settings.max_children < settings.max_hypotheses:
        raise ValueError(
            f"max_children is {settings.max_children}; give at least max_hypotheses, "
            f"{settings.max_hypotheses}"
        )
    thinning.check(settings.thinning)
    thinning.check_share("report_threshold", settings.report_threshold)
    thinning.check_share("recycle_threshold", settings.recycle_threshold)
    estimators.check(settings.estimator)
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with one hypothesis: of all known targets, each with its probability."""
    arrivals.check(params, settings.hides, settings.recycle_threshold > 0)
    keys, target = jax.random.split(key, 3), settings.target
    shape = settings.thinning.max_tracks, settings.max_leaves, 1
    trees = forest.begin(target, params, shape, keys[1])
    if settings.hides:
        hidden = undetected.begin(target, params, settings.max_undetected, keys[0])
    else:
        belief = jax.tree.map(lambda x: x[:0, 0], trees.belief)
        hidden = Undetected(trees.log_score[:0, 0], belief)
    known = trees.label >= 0
    dtype = trees.log_score.dtype
    hypotheses = global_hypotheses.first(settings.max_hypotheses, known, dtype)
    return State(trees, hypotheses, hidden, known.sum(), keys[2])


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, verdict.Estimate]:
    """Predicts, scores, follows all hypotheses by their events, keeps the heaviest."""
    target, scan = settings.target, association.filled(scan)
    key, seed, drawing = jax.random.split(state.key, 3)
    met = _meet(settings, params, state, scan, seed)
    born = len(met.trees.label) - len(state.trees.label)
    leaf = jnp.pad(state.hypotheses.leaf, ((0, 0), (0, born)))
    parents = state.hypotheses._replace(leaf=leaf)
    children = offspring.follow(
        parents,
        met.sight.log_score,
        met.log_absent,
        met.log_new,
        settings.max_children,
        settings.max_contested,
        _finder(settings, drawing),
    )
    trees, hypotheses, label = _grow(settings, params, parents, met, children, scan)
    proposed = jnp.logaddexp(children.log_total, children.log_left)
    share = mixture.total(hypotheses.log_weight) - proposed
    hidden = state.undetected if met.firsts is None else met.firsts.missed
    if settings.recycle_threshold:
        hypotheses, hidden = _recycle(settings, trees, hypotheses, hidden)
    trees, hypotheses, lost = thinning.thin(
        target, settings.thinning, trees, hypotheses
    )
    hidden, unseen = undetected.reduce(hidden, settings.max_undetected)
    log_evidence = children.log_total + met.log_new.sum() + met.log_constant
    dropped = lost + unseen + children.dropped
    estimate = _report(settings, trees, hypotheses, hidden, log_evidence, dropped)
    missing = -jnp.expm1(jnp.minimum(share, 0.0)) * estimate.num_mean
    estimate = estimate._replace(
        dropped=dropped + missing, log_loss=children.log_loss.astype(dropped.dtype)
    )
    return State(trees, hypotheses, hidden, label, key), estimate


def _finder(settings: Settings, key: Array) -> Callable[..., Found]:
    """Returns how children are found: the heaviest of all, or of those drawn."""
    if not settings.num_sweeps:
        return k_best_of_many
    return functools.partial(sample_of_many, key, num_sweeps=settings.num_sweeps)


def _meet(
    settings: Settings, params: Params, state: State, scan: Scan, key: Array
) -> Met:
    """Lets all that is there meet the scan."""
    known = settings.gating, settings.target, params, state.trees
    rest = scan, state.next_label, key
    if settings.hides:
        return arrivals.hidden(*known, state.undetected, *rest)
    return arrivals.born(*known, settings.certain, *rest)


def _report(
    settings: Settings,
    trees: Forest,
    hypotheses: Hypotheses,
    hidden: Undetected,
    log_evidence: Array,
    dropped: Array,
) -> verdict.Estimate:
    """Reports what the estimator chooses."""
    prob = jnp.exp(hypotheses.log_weight)
    there = verdict.exists(trees, hypotheses.leaf)
    return verdict.report(
        settings.target,
        trees,
        verdict.joint(hypotheses.leaf, hypotheses.log_weight),
        prob,
        hidden.expected,
        settings.report_threshold,
        log_evidence=log_evidence,
        dropped=dropped,
        choice=estimators.choose(
            settings.estimator, prob, there, settings.report_threshold
        ),
    )


def _grow(
    settings: Settings,
    params: Params,
    parents: Hypotheses,
    met: Met,
    children: Offspring,
    scan: Scan,
) -> tuple[Forest, Hypotheses, Array]:
    """Corrects the leaves that the children need, and begins trees."""
    kept = jax.tree.map(
        lambda x: x[: settings.max_hypotheses],
        (children.log_weight, children.parent, children.column, children.taken),
    )
    log_weight, parent, column, taken = kept
    columns = len(scan.valid) + 1
    old = parents.leaf[parent]
    code = jnp.where((old >= 0) & (column < columns), old * columns + column, -1)
    wanted = global_hypotheses.distinct(
        Hypotheses(log_weight, code), settings.max_leaves, settings.max_leaves * columns
    )
    parent, column = jnp.divmod(jnp.maximum(wanted.code, 0), columns)
    trees = forest.follow(
        settings.target,
        params.target,
        met.trees,
        met.sight,
        scan,
        parent,
        column,
        wanted.code >= 0,
    )
    if met.firsts is None:
        return trees, wanted.hypotheses, met.next_label
    first = met.firsts.log_score
    firsts = met.firsts._replace(
        log_score=jnp.where(first > -jnp.inf, met.log_new, -jnp.inf)
    )
    trees, label = forest.plant(trees, firsts, met.next_label, jax.nn.sigmoid(first))
    new = jnp.where(taken | (first == -jnp.inf)[None], -1, 0).astype(jnp.int32)
    leaf = jnp.concatenate([wanted.hypotheses.leaf, new], axis=1)
    return trees, wanted.hypotheses._replace(leaf=leaf), label


def _recycle(
    settings: Settings, trees: Forest, hypotheses: Hypotheses, hidden: Undetected
) -> tuple[Hypotheses, Undetected]:
    """Takes leaves whose target hardly exists for undetected targets."""
    exists, (_, size) = trees.existence_prob, trees.log_score.shape
    weak = (exists > 0) & (exists < settings.recycle_threshold)
    prob = mixture.normalise(hypotheses.log_weight)
    has = hypotheses.leaf[:, :, None] == jnp.arange(size)[None, None]
    weight = jnp.where(has, prob[:, None, None], 0.0).sum(0)
    number = jnp.where(weak, weight * exists, 0.0)
    belief = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), trees.belief)
    hidden = undetected.add(hidden, number.ravel(), belief)
    tree = jnp.arange(len(weak))[None]
    gone = weak[tree, jnp.maximum(hypotheses.leaf, 0)]
    return hypotheses._replace(leaf=jnp.where(gone, -1, hypotheses.leaf)), hidden
