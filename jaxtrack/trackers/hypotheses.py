"""Bayes' filter for targets known to be there: the heaviest association histories.

A hypothesis says of every scan so far which detection was whose. Each keeps one belief
a target; each is followed by its likeliest joint events, and of all that come out the
heaviest stay. With room for all it is the exact filter of a fixed number of targets,
which GNN, JPDA and its kin approximate with a single set of beliefs.

The targets are those of `params.start`, and all stay. `report` says what is told of
them: the mean over hypotheses, which has the least squared error and lies between two
targets that nobody can tell apart, or the heaviest hypothesis.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import hypotheses
    >>> tracker = hypotheses.hypotheses(targets.single.single(), max_hypotheses=100)

`log_evidence` is exact, whatever was dropped before, as long as no more targets than
`assign.exact.MAX_CLUSTER` share detections; the estimate's `exact` says whether that is
so and nothing was dropped. `dropped` is the share of the weight that found no room, or
was never proposed, times the number of targets.

Reference: Singer, Sea and Housewright, "Derivation and evaluation of improved tracking
filters for use in dense multitarget environments", IEEE Trans. Information Theory
20(4), 1974; Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979.
"""

import functools
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import assign, gate, mixture
from jaxtrack.trackers import association, bernoulli, initiation
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.trackers.single_scan import Estimate, Params
from jaxtrack.types import Array, PyTree, Scan, Target, Tracker

REPORTS = ("mean", "best")


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        log_weight: Of each hypothesis; -inf marks an empty slot, [H].
        beliefs: [H, N, ...].
    """

    log_weight: Array
    beliefs: PyTree


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    max_hypotheses: int
    max_events: int
    report: str
    gate_prob: float


class Children(NamedTuple):
    """The hypotheses that stay, each a parent and a joint event.

    Attributes:
        log_weight: [H].
        parent: [H].
        column: Which detection each target has, K for none, [H, N].
        log_total: Log-weight of all events of all parents.
        exact: Whether that is, and not belief propagation's (bool).
    """

    log_weight: Array
    parent: Array
    column: Array
    log_total: Array
    exact: Array


@functools.cache
def hypotheses(
    target: Target,
    max_hypotheses: int = 200,
    max_events: int = 20,
    report: Literal["mean", "best"] = "mean",
    gate_prob: float = 1.0,
) -> Tracker:
    """Makes the filter of a fixed number of targets.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_hypotheses: Hypotheses kept after a scan, the heaviest.
        max_events: Joint events by which each is followed, the likeliest.
        report: "mean" or "best".
        gate_prob: P_G; 1 for no gate.

    Raises:
        ValueError: A setting that makes no sense.
    """
    sizes = {"max_hypotheses": max_hypotheses, "max_events": max_events}
    for name, size in sizes.items():
        if size < 1:
            raise ValueError(f"{name} is {size}; give at least 1")
    if report not in REPORTS:
        raise ValueError(f"report is {report!r}; give one of {', '.join(REPORTS)}")
    gate.check(gate_prob)
    settings = Settings(target, max_hypotheses, max_events, report, gate_prob)
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with one hypothesis."""
    if params.start is None:
        raise ValueError("start is None; give the targets that are known to be there")
    num = len(params.start.existence_prob)
    known, _ = initiation.at_start(settings.target, params, num, jnp.array(0), key)
    size = settings.max_hypotheses
    first = jnp.where(jnp.arange(size) == 0, 0.0, -jnp.inf)
    return State(
        log_weight=first.astype(known.existence_prob.dtype),
        beliefs=jax.tree.map(
            lambda x: jnp.broadcast_to(x, (size, *x.shape)), known.belief
        ),
    )


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Predicts, scores, follows each hypothesis by its events, keeps the heaviest."""
    target, options, scan = settings.target, params.target, association.filled(scan)
    each = functools.partial(jax.vmap, in_axes=(None, 0, None))
    beliefs, _ = each(each(target.predict))(options, state.beliefs, scan.interval)

    gating = association.Gating(
        settings.gate_prob, in_missed=False, counts_clutter=False
    )

    def look(belief: PyTree) -> association.Sighting:
        return association.look(gating, False, target, params, _all(belief), scan)

    sights = jax.vmap(look)(beliefs)
    children = _follow(settings, state.log_weight, sights.log_score)

    def pick(view: PyTree, missed: PyTree, column: Array) -> PyTree:
        seen = jnp.minimum(column, len(scan.valid) - 1)
        hit = target.correct(options, view, scan.detections[seen])
        gone = column == len(scan.valid)
        return jax.tree.map(lambda x, y: jnp.where(gone, x, y), missed, hit)

    views, missed = jax.tree.map(
        lambda x: x[children.parent], (sights.views, sights.missed)
    )
    beliefs = jax.vmap(jax.vmap(pick))(views, missed, children.column)
    certain = jnp.ones((), state.log_weight.dtype)
    adapt = jax.vmap(jax.vmap(target.adapt, (None, 0, None)), (None, 0, None))
    beliefs = adapt(options, beliefs, certain)

    log_clutter = sights.log_clutter[0].sum() - params.clutter.rate
    log_evidence = children.log_total + log_clutter
    log_weight = mixture.log_normalise(children.log_weight)
    following = State(log_weight, beliefs)
    lost = 1 - jnp.exp(mixture.total(children.log_weight) - children.log_total)
    # Two sums of the same weights differ by some roundings.
    lost = jnp.where(lost > 100 * jnp.finfo(lost.dtype).eps, lost, 0.0)
    estimate = _report(
        settings, following, children.column, scan, log_evidence, lost, children.exact
    )
    return following, estimate


def _all(belief: PyTree) -> Tracks:
    """Returns targets [N, ...] as tracks that are there."""
    num = len(jax.tree.leaves(belief)[0])
    label = jnp.arange(num)
    return Tracks(jnp.ones(num), belief, label, jnp.full_like(label, -1))


def _follow(settings: Settings, log_weight: Array, log_score: Array) -> Children:
    """Finds the heaviest children of H hypotheses with scores [H, N, K + 1]."""
    k_best = functools.partial(assign.k_best.k_best, k=settings.max_events)
    events = jax.vmap(k_best)(log_score)
    everyone = jax.vmap(assign.marginals.marginals)(log_score)
    candidates = log_weight[:, None] + events.log_score
    kept, index = jax.lax.top_k(candidates.ravel(), settings.max_hypotheses)
    parent, event = jnp.divmod(index, settings.max_events)
    return Children(
        log_weight=kept,
        parent=parent,
        column=events.column[parent, event],
        log_total=mixture.total(log_weight + everyone.log_norm),
        exact=(everyone.exact.all(1) | (log_weight == -jnp.inf)).all(),
    )


def _report(
    settings: Settings,
    state: State,
    column: Array,
    scan: Scan,
    log_evidence: Array,
    lost: Array,
    exact: Array,
) -> Estimate:
    """Tells of each target over all hypotheses, or in the heaviest."""
    target, weight = settings.target, state.log_weight
    if settings.report == "best":
        weight = jnp.where(jnp.arange(weight.size) == 0, 0.0, -jnp.inf)
    belief = jax.vmap(target.collapse, (None, 1))(weight, state.beliefs)
    tracks = _all(belief)
    taken = column[:, :, None] == jnp.arange(len(scan.valid) + 1)[None, None]
    share = jnp.where(taken, jnp.exp(state.log_weight)[:, None, None], 0.0).sum(0)
    dropped = lost * tracks.label.size
    told = bernoulli.report(target, tracks, tracks.label, 0.5, log_evidence, dropped)
    exact = jnp.full(tracks.label.shape, exact & (lost <= 0))
    return Estimate(**told._asdict(), association_prob=share, exact=exact)
