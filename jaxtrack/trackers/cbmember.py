"""The cardinality balanced multi-target multi-Bernoulli filter, for any target.

The belief about all targets is a set of independent tracks, each with a probability
that it exists. One scan is

    tracks = predict(tracks) + births               # each may die, new ones may appear
    for each track:      a legacy track             # it was missed
    for each detection:  an updated track           # it caused the detection, whoever it is
    keep the likeliest tracks, report those that exist with more than even odds

`cbmember(target=mixture(...))` with several modes is the GM-MM-CBMeMBer filter, with one
mode the GM-CBMeMBer filter; with a nonlinear model and `linearize.taylor` or `unscented`
it is the EK or UK form; `cbmember(target=imm())` keeps one Gaussian a mode.

Labels (left open by the paper) follow ancestry: a legacy track keeps its label, an
updated track takes that of the track that explains its detection best, a newborn gets a
new one. Where two reported tracks would share a label, the likelier is the heir and the
other starts a new label, for good.

The log-evidence of a scan is that of a product form, in which several detections may
stem from one track: exact for a single detection or where no two detections compete for
a track. It is the normaliser that the filter's own update uses.

The approximation wants a probability of detection near one: a track that exists almost
surely passes only (1 - r) / (1 - r p_D) of its existence on to its detection.

References: Yuan, Lian and Han, "Multiple-model cardinality balanced multitarget multi-
Bernoulli filter for tracking maneuvering targets", 2013, equations 6 to 13 and 30 to 36,
Algorithm 1; Vo, Vo and Cantoni, "The cardinality balanced multi-target multi-Bernoulli
filter and its implementations", IEEE Trans. Signal Processing 57(2), 2009, whose
denominators hold where the paper's print slips.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.linalg import safe_log
from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth
from jaxtrack.types import Array, Gaussian, PyTree, Scan, Target, Tracker


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        target: The `Params` of the target.
        birth: `models.birth.MultiBernoulliBirth` (known places, after the prediction)
            or `DetectionBirth` (where the last scan left detections unexplained).
        clutter: Of `models.clutter`.
    """

    target: Any
    birth: MultiBernoulliBirth | DetectionBirth
    clutter: Any


class Tracks(NamedTuple):
    """N slots: existence_prob [N] (0 marks an empty one), belief [N, ...], label [N]."""

    existence_prob: Array
    belief: PyTree
    label: Array


class State(NamedTuple):
    """What the next scan needs: the tracks, the next free label, a random key."""

    tracks: Tracks
    next_label: Array
    key: Array


class Estimate(NamedTuple):
    """What a scan taught, for the user; slots are sorted by existence probability.

    Attributes:
        mean: [N, D].
        cov: [N, D, D].
        label: Which target it is, [N] (int).
        exists: Report this one, [N] (bool).
        existence_prob: [N]; its sum is the expected number of targets.
        mode_prob: [N, M].
        log_evidence: Log-density of the scan given the past, see the module.
        dropped: Expected number of targets that the capacities threw away.
    """

    mean: Array
    cov: Array
    label: Array
    exists: Array
    existence_prob: Array
    mode_prob: Array
    log_evidence: Array
    dropped: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    target: Target
    max_tracks: int
    max_births: int
    max_parents: int
    prune_threshold: float
    report_threshold: float


class Update(NamedTuple):
    """Equation 34: how likely each legacy and each updated track exists.

    Attributes:
        missed: Beliefs of the legacy tracks, [N, ...].
        legacy_prob: [N].
        updated_prob: [K].
        log_weight: Share of track n in the updated track of detection k, [N, K],
            not normalised.
        unexplained_prob: Probability that no known track caused the detection, [K].
        log_evidence: Log-density of the scan.
    """

    missed: PyTree
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
    prune_threshold: float = 1e-3,
    report_threshold: float = 0.5,
) -> Tracker:
    """Makes a CBMeMBer filter.

    Args:
        target: How one target is filtered, e.g. `targets.imm.imm()`.
        max_tracks: Tracks kept after a scan; the least likely go first.
        max_births: Newborn tracks of `DetectionBirth` kept after a scan.
        max_parents: Tracks that may share in one detection's updated track.
        prune_threshold: Tracks that exist with less probability go.
        report_threshold: Tracks that exist with more probability are reported.

    Raises:
        ValueError: A size or threshold that makes no sense.
    """
    sizes = {"max_tracks": max_tracks, "max_births": max_births}
    for name, size in {**sizes, "max_parents": max_parents}.items():
        if size < 1:
            raise ValueError(f"{name} is {size}; give at least 1")
    thresholds = {"prune_threshold": prune_threshold}
    for name, value in {**thresholds, "report_threshold": report_threshold}.items():
        if not 0 <= value < 1:
            raise ValueError(f"{name} is {value}; give a probability from 0 up to 1")
    settings = Settings(
        target, max_tracks, max_births, max_parents, prune_threshold, report_threshold
    )
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts without targets."""
    dim, mode_prob = params.target.layout.dim, params.birth.mode_prob
    driven = isinstance(params.birth, DetectionBirth)
    size = settings.max_tracks + (settings.max_births if driven else 0)
    nobody = settings.target.begin(
        params.target,
        Gaussian(jnp.zeros(dim), jnp.eye(dim)),
        mode_prob if driven else mode_prob[0],
        key,
    )
    tracks = Tracks(
        existence_prob=jnp.zeros(size),
        belief=jax.tree.map(lambda x: jnp.broadcast_to(x, (size, *x.shape)), nobody),
        label=jnp.full(size, -1),
    )
    return State(tracks, jnp.asarray(0), key)


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, Estimate]:
    """Predicts, adds births, updates, keeps the likeliest and reports."""
    key, birth_key = jax.random.split(state.key)
    next_label = state.next_label

    tracks = _predict(settings.target, params.target, state.tracks, scan.interval)
    if isinstance(params.birth, MultiBernoulliBirth):
        born = _begin(settings.target, params, params.birth, next_label, birth_key)
        tracks, next_label = _append(tracks, born), next_label + born.label.size

    update = _update(settings.target, params, tracks, scan)
    tracks, dropped = _keep(settings, params.target, tracks, scan, update)
    tracks, next_label = _inherit(tracks, next_label, settings.report_threshold)
    estimate = _report(settings, tracks, update.log_evidence, dropped)

    if isinstance(params.birth, DetectionBirth):
        births, lost = _unexplained(settings, params, scan, update.unexplained_prob)
        born = _begin(settings.target, params, births, next_label, birth_key)
        tracks, next_label = _append(tracks, born), next_label + born.label.size
        estimate = estimate._replace(dropped=estimate.dropped + lost)
    return State(tracks, next_label, key), estimate


def _predict(target: Target, params: Any, tracks: Tracks, interval: Array) -> Tracks:
    """Equations 31 and 32: each track survives and moves."""
    belief, log_survive = jax.vmap(target.predict, (None, 0, None))(
        params, tracks.belief, interval
    )
    survived = tracks.existence_prob * jnp.exp(log_survive)
    return tracks._replace(existence_prob=survived, belief=belief)


def _begin(
    target: Target,
    params: Params,
    births: MultiBernoulliBirth,
    next_label: Array,
    key: Array,
) -> Tracks:
    """Equation 27: the newborn, each under a label of its own."""
    size = births.existence_prob.size
    belief = jax.vmap(target.begin, (None, 0, 0, 0))(
        params.target,
        Gaussian(births.mean, births.cov),
        births.mode_prob,
        jax.random.split(key, size),
    )
    return Tracks(births.existence_prob, belief, next_label + jnp.arange(size))


def _unexplained(
    settings: Settings, params: Params, scan: Scan, unexplained_prob: Array
) -> tuple[MultiBernoulliBirth, Array]:
    """Proposes births where a detection is unexplained, and counts what found no room."""
    births = params.birth.propose(
        params.target.sensor,
        params.target.layout,
        scan.detections,
        scan.valid,
        unexplained_prob,
        scan.interval,
    )
    size = settings.max_births
    if (short := size - births.existence_prob.size) > 0:
        filler = jax.tree.map(lambda x: jnp.repeat(x[:1], short, axis=0), births)
        filler = filler._replace(existence_prob=jnp.zeros(short))
        births = jax.tree.map(lambda x, y: jnp.concatenate([x, y]), births, filler)
    _, kept = jax.lax.top_k(births.existence_prob, size)
    likeliest = jax.tree.map(lambda x: x[kept], births)
    lost = births.existence_prob.sum() - likeliest.existence_prob.sum()
    return likeliest, lost


def _append(tracks: Tracks, born: Tracks) -> Tracks:
    return jax.tree.map(lambda old, new: jnp.concatenate([old, new]), tracks, born)


def _update(target: Target, params: Params, tracks: Tracks, scan: Scan) -> Update:
    """Equation 34, in logarithms."""
    missed, log_miss = jax.vmap(target.miss, (None, 0))(params.target, tracks.belief)
    score = jax.vmap(target.score, (None, 0, None))(
        params.target, tracks.belief, scan.detections
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
        legacy_prob=prob * jnp.exp(log_miss) / empty_prob,
        updated_prob=(share[:-1] * absent_given_empty[:, None]).sum(0),
        log_weight=safe_log(prob / (1 - prob))[:, None] + score,
        unexplained_prob=share[-1],
        log_evidence=jnp.where(scan.valid, log_total, 0.0).sum()
        + jnp.log(empty_prob).sum()
        - params.clutter.rate,
    )


def _keep(
    settings: Settings, params: Any, tracks: Tracks, scan: Scan, update: Update
) -> tuple[Tracks, Array]:
    """Prunes and caps the tracks; only survivors are corrected.

    Returns the survivors, likeliest first, and the expected number of targets that the
    capacities (not the pruning threshold) threw away.
    """
    target, num = settings.target, tracks.label.size
    prob = jnp.concatenate([update.legacy_prob, update.updated_prob])
    prob = jnp.where(prob >= settings.prune_threshold, prob, 0.0)
    size = min(settings.max_tracks, prob.size)
    kept_prob, kept = jax.lax.top_k(prob, size)

    def survivor(index: Array) -> tuple[PyTree, Array, Array]:
        detection = jnp.maximum(index - num, 0)
        log_weight, parents = jax.lax.top_k(
            update.log_weight[:, detection], min(settings.max_parents, num)
        )
        before = jax.tree.map(lambda x: x[parents], tracks.belief)
        corrected = jax.vmap(target.correct, (None, 0, None))(
            params, before, scan.detections[detection]
        )
        hit = target.collapse(log_weight, corrected)
        everyone = mixture.total(update.log_weight[:, detection])
        known = everyone > -jnp.inf
        lost = 1 - jnp.exp(mixture.total(log_weight) - jnp.where(known, everyone, 0.0))
        lost = jnp.where(known, lost + (1 - lost) * target.lost(hit), 0.0)

        legacy = index < num
        missed = jax.tree.map(lambda x: x[jnp.minimum(index, num - 1)], update.missed)
        belief = jax.tree.map(functools.partial(jnp.where, legacy), missed, hit)
        label = tracks.label[jnp.where(legacy, jnp.minimum(index, num - 1), parents[0])]
        return belief, label, jnp.where(legacy, target.lost(missed), lost)

    belief, label, lost = jax.vmap(survivor)(kept)
    dropped = prob.sum() - kept_prob.sum() + (kept_prob * lost).sum()
    return Tracks(kept_prob, belief, label), dropped


def _inherit(
    tracks: Tracks, next_label: Array, threshold: float
) -> tuple[Tracks, Array]:
    """Lets the likeliest reported track of a label keep it; rivals start new ones."""
    exists = tracks.existence_prob > threshold
    same = (tracks.label[:, None] == tracks.label[None]) & exists[:, None] & exists[None]
    earlier = jnp.arange(exists.size)[:, None] < jnp.arange(exists.size)[None]
    rival = (same & earlier).any(0)  # slots are sorted, so an earlier one is likelier
    fresh = next_label + jnp.cumsum(rival) - 1
    label = jnp.where(rival, fresh, tracks.label)
    return tracks._replace(label=label), next_label + rival.sum()


def _report(
    settings: Settings, tracks: Tracks, log_evidence: Array, dropped: Array
) -> Estimate:
    """Algorithm 1: tracks that exist with more than even odds, at their means."""
    belief = jax.vmap(settings.target.moments)(tracks.belief)
    return Estimate(
        mean=belief.mean,
        cov=belief.cov,
        label=tracks.label,
        exists=tracks.existence_prob > settings.report_threshold,
        existence_prob=tracks.existence_prob,
        mode_prob=jax.vmap(settings.target.modes)(tracks.belief),
        log_evidence=log_evidence,
        dropped=dropped,
    )
