"""The cardinality balanced multi-target multi-Bernoulli filter, for any target.

The belief about all targets is a set of independent tracks, each with a probability
that it exists. One scan is

    tracks = predict(tracks) + births               # each may die, new ones may appear
    for each track:      a legacy track             # it was missed
    for each detection:  an updated track           # it was caused, by whomever
    keep the likeliest tracks, report those that exist with more than even odds

`cbmember(target=mixture(...))` with several modes is the GM-MM-CBMeMBer filter, with
one mode the GM-CBMeMBer filter; with a nonlinear model and `linearize.taylor` or
`unscented` it is the EK or UK form; `cbmember(target=imm())` keeps one Gaussian a mode.

Labels (left open by the paper) follow ancestry: a legacy track keeps its label, an
updated track takes that of the track that explains its detection best, a newborn gets a
new one. Where two reported tracks share a label, the likelier is the heir and the other
is reported under an alias (`bernoulli.tell_apart`).

The log-evidence of a scan is that of a product form, in which several detections may
stem from one track: exact for a single detection or where no two detections compete for
a track. It is the normaliser that the filter's own update uses. A detection that
neither a track nor clutter can explain makes it -inf: keep the clutter's box wide and
its rate above zero.

How far off it is: with one detection the expected number of targets and the evidence
are exact, for any number of tracks; but a track that exists almost surely passes only
(1 - r) / (1 - r p_D) of its existence on to its detection, so p_D should be near one.
Two targets so close that they compete for two detections are overcounted by 0.11 on
average, one target with three detections in reach by 0.56 (p_D 0.9 to 0.99, heavy
clutter, 300 random scenes of `tests/test_cbmember.py` against brute force).

    >>> from jaxtrack import targets, trackers
    >>> trackers.cbmember.cbmember(targets.imm.imm(), max_tracks=16)._fields
    ('init', 'step')

References: Yuan, Lian and Han, "Multiple-model cardinality balanced multitarget multi-
Bernoulli filter for tracking maneuvering targets", 2013, equations 6 to 13 and 30 to
36, Algorithm 1; Vo, Vo and Cantoni, "The cardinality balanced multi-target
multi-Bernoulli filter and its implementations", IEEE Trans. Signal Processing 57(2),
2009, whose denominators hold where the paper's print slips.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.linalg import safe_log
from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.trackers import alternatives, bernoulli
from jaxtrack.trackers.bernoulli import Estimate, Tracks
from jaxtrack.types import Array, PyTree, Scan, Target, Tracker


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        target: The `Params` of the target.
        birth: `models.birth.MultiBernoulliBirth` or `PoissonBirth` (known places, after
            the prediction; at most one a place), or `DetectionBirth` (where the last
            scan left detections unexplained).
        clutter: Of `models.clutter`.
    """

    target: Any
    birth: MultiBernoulliBirth | PoissonBirth | DetectionBirth
    clutter: Any


class State(NamedTuple):
    """What the next scan needs: the tracks, the next free label, a random key."""

    tracks: Tracks
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    max_tracks: int
    max_births: int
    max_parents: int
    max_updated: int
    prune_threshold: float
    report_threshold: float
    merge_threshold: float
    split_threshold: float


class Update(NamedTuple):
    """Equation 34: how likely each legacy and each updated track exists.

    Attributes:
        missed: Beliefs of the legacy tracks, [N, ...].
        views: All tracks as the sensor sees them, [N, ...].
        legacy_prob: [N].
        updated_prob: [K].
        log_weight: Share of track n in the updated track of detection k, [N, K],
            not normalised.
        unexplained_prob: Probability that no known track caused the detection, [K].
        log_evidence: Log-density of the scan.
    """

    missed: PyTree
    views: PyTree
    legacy_prob: Array
    updated_prob: Array
    log_weight: Array
    unexplained_prob: Array
    log_evidence: Array


@functools.cache
def cbmember(
    target: Target,
    max_tracks: int = 32,
    max_births: int = 16,
    max_parents: int = 8,
    max_updated: int | None = None,
    prune_threshold: float = 1e-3,
    report_threshold: float = 0.5,
    merge_threshold: float = 0.0,
    split_threshold: float = 0.8,
) -> Tracker:
    """Makes a CBMeMBer filter.

    Args:
        target: How one target is filtered, e.g. `targets.imm.imm()`.
        max_tracks: Tracks kept after a scan; the least likely go first.
        max_births: Newborn tracks of `DetectionBirth` kept after a scan.
        max_parents: Tracks that may share in one detection's updated track.
        max_updated: Updated tracks kept after a scan; by default `max_tracks`.
        prune_threshold: Tracks that exist with less probability go.
        report_threshold: Tracks that exist with more probability are reported.
        merge_threshold: Squared Mahalanobis distance within which tracks under one
            label merge; then a label counts as a whole when it is reported. With 0
            nothing merges and each track counts for itself.
        split_threshold: Where tracks merge, a track beside a likelier one under its
            label starts its own if it exists with more probability than this.

    Raises:
        ValueError: A size or threshold that makes no sense.
    """
    updated = max_tracks if max_updated is None else max_updated
    sizes = {"max_tracks": max_tracks, "max_births": max_births}
    sizes = {**sizes, "max_parents": max_parents, "max_updated": updated}
    for name, size in sizes.items():
        if size < 1:
            raise ValueError(f"{name} is {size}; give at least 1")
    given = prune_threshold, report_threshold, split_threshold
    for name, value in zip(("prune", "report", "split"), given, strict=True):
        if not 0 <= value < 1:
            message = f"{name}_threshold is {value}; give a probability from 0 up to 1"
            raise ValueError(message)
    if not merge_threshold >= 0:
        raise ValueError(
            f"merge_threshold is {merge_threshold}; give a squared distance, e.g. 4"
        )
    settings = Settings(
        target,
        max_tracks,
        max_births,
        max_parents,
        updated,
        prune_threshold,
        report_threshold,
        merge_threshold,
        split_threshold,
    )
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts without targets."""
    driven = isinstance(params.birth, DetectionBirth)
    mode_prob = params.birth.mode_prob if driven else params.birth.mode_prob[0]
    size = settings.max_tracks + (settings.max_births if driven else 0)
    tracks = bernoulli.nobody(settings.target, params.target, mode_prob, size, key)
    return State(tracks, jnp.zeros((), int), key)


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Predicts, adds births, updates, keeps the likeliest and reports."""
    target, threshold = settings.target, settings.report_threshold
    key, birth_key = jax.random.split(state.key)
    label = state.next_label

    tracks = bernoulli.predict(target, params.target, state.tracks, scan.interval)
    if not isinstance(params.birth, DetectionBirth):
        born = bernoulli.begin(target, params.target, params.birth, label, birth_key)
        tracks, label = bernoulli.append(tracks, born), label + born.label.size

    update = _update(target, params, tracks, scan)
    tracks, dropped = _keep(settings, params.target, tracks, scan, update)
    merging = settings.merge_threshold > 0
    if merging:
        tracks = alternatives.merge(target, tracks, settings.merge_threshold)
    apart = settings.split_threshold if merging else threshold
    tracks, shown, label = bernoulli.tell_apart(tracks, label, apart)
    if merging:  # a label is one target, so a rival has its own for good
        tracks = tracks._replace(label=shown, alias=jnp.full_like(shown, -1))

    if not isinstance(params.birth, DetectionBirth):
        following = tracks
    else:
        births, lost = bernoulli.from_unexplained(
            params.birth,
            params.target,
            scan,
            update.unexplained_prob,
            settings.max_births,
        )
        born = bernoulli.begin(target, params.target, births, label, birth_key)
        following, label = bernoulli.append(tracks, born), label + born.label.size
        dropped = dropped + lost
    estimate = bernoulli.report(
        target, tracks, shown, threshold, update.log_evidence, dropped
    )
    if merging:
        estimate = estimate._replace(exists=alternatives.heirs(tracks, threshold))
    return State(following, label, key), estimate


def _update(target: Target, params: Params, tracks: Tracks, scan: Scan) -> Update:
    """Equation 34, in logarithms."""
    missed, log_miss = jax.vmap(target.miss, (None, 0))(params.target, tracks.belief)
    views = jax.vmap(target.look, (None, 0))(params.target, tracks.belief)
    score = jax.vmap(target.score, (None, 0, None))(
        params.target, views, scan.detections
    )
    clutter = jax.vmap(params.clutter.log_density)(scan.detections)

    # 1 / (1 - r) must stay finite; nothing else is clipped.
    tiny = jnp.finfo(tracks.existence_prob.dtype).eps
    prob = jnp.minimum(tracks.existence_prob, 1 - tiny)
    empty_prob = 1 - prob + prob * jnp.exp(log_miss)  # 1 - r <p, p_D>
    absent_given_empty = (1 - prob) / empty_prob

    log_hit = safe_log(prob / empty_prob)[:, None] + score  # [N, K]
    log_all = jnp.concatenate([log_hit, clutter[None]])
    log_all = jnp.where(scan.valid[None], log_all, -jnp.inf)
    log_total = jax.vmap(mixture.total, 1)(log_all)  # [K]
    possible = log_total > -jnp.inf
    share = jnp.exp(log_all - jnp.where(possible, log_total, 0.0)[None])

    return Update(
        missed=missed,
        views=views,
        legacy_prob=prob * jnp.exp(log_miss) / empty_prob,
        updated_prob=(share[:-1] * absent_given_empty[:, None]).sum(0),
        log_weight=safe_log(prob / (1 - prob))[:, None] + score,
        unexplained_prob=jnp.where(possible, share[-1], 1.0),
        log_evidence=jnp.where(scan.valid, log_total, 0.0).sum()
        + jnp.log(empty_prob).sum()
        - params.clutter.rate,
    )


def _keep(
    settings: Settings, params: Any, tracks: Tracks, scan: Scan, update: Update
) -> tuple[Tracks, Array]:
    """Prunes and caps the tracks; only the likeliest detections make updated tracks.

    Returns the survivors, likeliest first, and the expected number of targets dropped.
    """
    target, threshold = settings.target, settings.prune_threshold
    legacy_prob = jnp.where(update.legacy_prob >= threshold, update.legacy_prob, 0.0)
    updated_prob = jnp.where(update.updated_prob >= threshold, update.updated_prob, 0.0)
    most = min(settings.max_updated, updated_prob.size)
    hit_prob, detection = jax.lax.top_k(updated_prob, most)
    absorb = functools.partial(
        bernoulli.absorb, target, params, update.views, settings.max_parents
    )
    hits, ancestor, lost = jax.vmap(absorb)(
        update.log_weight[:, detection].T, scan.detections[detection]
    )

    prob = jnp.concatenate([legacy_prob, hit_prob])
    kept_prob, kept = jax.lax.top_k(prob, min(settings.max_tracks, prob.size))
    lost = jnp.concatenate([jax.vmap(target.lost)(update.missed), lost])
    dropped = legacy_prob.sum() + updated_prob.sum() - kept_prob.sum()
    dropped = dropped + (kept_prob * lost[kept]).sum()
    survivors = bernoulli.append(
        tracks._replace(existence_prob=legacy_prob, belief=update.missed),
        Tracks(hit_prob, hits, tracks.label[ancestor], tracks.alias[ancestor]),
    )
    survivors = jax.tree.map(lambda x: x[kept], survivors)
    belief = jax.vmap(target.adapt, (None, 0, 0))(params, survivors.belief, kept_prob)
    # Nothing dropped can come out as minus one rounding.
    return survivors._replace(belief=belief), jnp.maximum(dropped, 0.0)
