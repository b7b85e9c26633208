"""One scan for tracks that may exist: the balanced update, and the one by claims.

The balanced update (CBMeMBer) lets each detection be claimed by all tracks at once, and
a track by all detections: cheap, and too many where several detections compete for a
track. `claims` divides them instead: each track has at most one detection and each
detection at most one track, by the marginal probabilities of all joint events. Then the
expected number of targets is exact, and what is left of the approximation is that the
tracks are independent again after the scan.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import multi_bernoulli
    >>> log_hit = jnp.log(jnp.array([[8.0, 8.0]]))  # one target, two detections
    >>> log_none = jnp.log(jnp.array([0.1]))
    >>> found = multi_bernoulli.divide(log_hit, log_none)
    >>> print(found.hit_prob.round(3), found.none_prob.round(3))
    [[0.497 0.497]] [0.006]

References: Vo, Vo and Cantoni, "The cardinality balanced multi-target multi-Bernoulli
filter and its implementations", IEEE Trans. Signal Processing 57(2), 2009; Williams,
"Marginal multi-Bernoulli filters: RFS derivation of MHT, JIPDA, and association-based
MeMBer", IEEE Trans. Aerospace and Electronic Systems 51(3), 2015, whose measurement-
oriented form `claims` is, without the Poisson part.
"""

import functools
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate, mixture
from jaxtrack.assign.marginals import marginals
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import association, bernoulli
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.types import Array, PyTree, Scan, Target

Balance = Literal["paper", "claims"]

# Less likely than this beside a miss, and a track does not claim a detection: few
# tracks then share detections, and the joint events of each group are summed exactly.
NEGLIGIBLE = 1e-9
MAX_CLUSTER = 6  # tracks summed over exactly; larger groups by belief propagation


class Settings(NamedTuple):
    """The arguments of `cbmember.cbmember`."""

    target: Target
    max_tracks: int
    max_births: int
    max_parents: int
    max_updated: int
    prune_threshold: float
    report_threshold: float
    merge_threshold: float
    split_threshold: float
    balance: Balance
    max_scored: int | None = None


class Update(NamedTuple):
    """How likely each legacy and each updated track exists.

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


class Seen(NamedTuple):
    """A scan as N tracks see it.

    Attributes:
        missed: Beliefs if missed, [N, ...].
        views: The tracks as the sensor sees them, [N, ...].
        prob: Existence probabilities, a rounding below one at most, [N].
        log_miss: Probability that a target of the track was missed, [N].
        log_score: Density of its detection, times the probability of one, [N, K].
        log_clutter: Density of a false detection, [K].
    """

    missed: PyTree
    views: PyTree
    prob: Array
    log_miss: Array
    log_score: Array
    log_clutter: Array


class Claims(NamedTuple):
    """Whose the detections are, by the marginals of all joint events.

    Attributes:
        hit_prob: Probability that track n caused detection k, [N, K].
        none_prob: Probability that it caused none, [N].
        log_norm: Log of the summed weight of all joint events.
    """

    hit_prob: Array
    none_prob: Array
    log_norm: Array


def update(
    balance: Balance,
    target: Target,
    params: Any,
    tracks: Tracks,
    scan: Scan,
    max_scored: int | None = None,
) -> Update:
    """Says how likely each track exists after a scan; keeps and drops nothing.

    Args:
        balance: "paper" or "claims", see `cbmember.cbmember`.
        target: How one target is filtered.
        params: The tracker's `Params`: target and clutter.
        tracks: N, predicted, with the newborn.
        scan: K detections.
        max_scored: Of them scored in full by each track, see `gate.scores`.
    """
    weigh = balanced if balance == "paper" else claimed
    seen = see(target, params, tracks, scan, max_scored)
    return weigh(seen, scan.valid, params.clutter.rate)


def see(
    target: Target,
    params: Any,
    tracks: Tracks,
    scan: Scan,
    max_scored: int | None = None,
) -> Seen:
    """Asks each of N tracks what it thinks of K detections.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`: target and clutter.
        tracks: N, predicted.
        scan: K detections.
        max_scored: See `gate.scores`.
    """
    missed, log_miss = jax.vmap(target.miss, (None, 0))(params.target, tracks.belief)
    views = jax.vmap(target.look, (None, 0))(params.target, tracks.belief)
    score = gate.scores(target, params.target, views, log_miss, scan, max_scored)
    # 1 / (1 - r) must stay finite; nothing else is clipped.
    tiny = jnp.finfo(tracks.existence_prob.dtype).eps
    prob = jnp.minimum(tracks.existence_prob, 1 - tiny)
    clutter = jax.vmap(params.clutter.log_density)(scan.detections)
    return Seen(missed, views, prob, log_miss, score, clutter)


def balanced(seen: Seen, valid: Array, clutter_rate: Array) -> Update:
    """Updates by equation 34 of Yuan 2013, in logarithms.

    Args:
        seen: What N tracks see of K detections.
        valid: Which detections are there, [K].
        clutter_rate: Expected number of false ones.
    """
    prob = seen.prob
    empty_prob = 1 - prob + prob * jnp.exp(seen.log_miss)  # 1 - r <p, p_D>
    absent_given_empty = (1 - prob) / empty_prob

    log_hit = safe_log(prob / empty_prob)[:, None] + seen.log_score  # [N, K]
    log_all = jnp.concatenate([log_hit, seen.log_clutter[None]])
    log_all = jnp.where(valid[None], log_all, -jnp.inf)
    log_total = mixture.total(log_all)  # [K]
    possible = log_total > -jnp.inf
    share = jnp.exp(log_all - jnp.where(possible, log_total, 0.0)[None])

    return Update(
        missed=seen.missed,
        views=seen.views,
        legacy_prob=prob * jnp.exp(seen.log_miss) / empty_prob,
        updated_prob=(share[:-1] * absent_given_empty[:, None]).sum(0),
        log_weight=safe_log(prob / (1 - prob))[:, None] + seen.log_score,
        unexplained_prob=jnp.where(possible, share[-1], 1.0),
        log_evidence=jnp.where(valid, log_total, 0.0).sum()
        + jnp.log(empty_prob).sum()
        - clutter_rate,
    )


def claimed(seen: Seen, valid: Array, clutter_rate: Array) -> Update:
    """Updates by who claims what: expected number and evidence are exact.

    Args:
        seen: What N tracks see of K detections.
        valid: Which detections are there, [K].
        clutter_rate: Expected number of false ones.
    """
    claims, log_clutter, exists_if_none = claim(seen, valid)
    updated_prob = claims.hit_prob.sum(0)
    return Update(
        missed=seen.missed,
        views=seen.views,
        legacy_prob=claims.none_prob * exists_if_none,
        updated_prob=updated_prob,
        log_weight=safe_log(claims.hit_prob),
        unexplained_prob=jnp.clip(1 - updated_prob, 0.0, 1.0),
        log_evidence=claims.log_norm + log_clutter.sum() - clutter_rate,
    )


def claim(seen: Seen, valid: Array) -> tuple[Claims, Array, Array]:
    """Divides the detections of a scan among clutter and N tracks.

    Args:
        seen: What N tracks see of K detections.
        valid: Which detections are there, [K].

    Returns:
        The claims; the log-density of clutter, at least that of a miracle and 0 where
        not valid, [K]; and the probability that a track exists if no detection is its,
        [N].
    """
    log_clutter = jnp.maximum(seen.log_clutter, association.LEAST_LOG_WEIGHT)
    log_clutter = jnp.where(valid, log_clutter, 0.0)
    log_exists = safe_log(seen.prob)
    log_hit = log_exists[:, None] + seen.log_score - log_clutter[None]
    log_none = association.log_absent_or_missed(log_exists, seen.log_miss)
    claims = divide(jnp.where(valid[None], log_hit, -jnp.inf), log_none)
    return claims, log_clutter, jnp.exp(log_exists + seen.log_miss - log_none)


def divide(log_hit: Array, log_none: Array) -> Claims:
    """Finds the probabilities of all pairs from their weights beside clutter.

    Args:
        log_hit: Weight of track n having caused detection k, against clutter, [N, K].
        log_none: Weight of its having caused none, [N].
    """
    light = log_hit < log_none[:, None] + jnp.log(NEGLIGIBLE)
    log_hit = jnp.where(light, -jnp.inf, log_hit)
    log_score = jnp.concatenate([log_hit, log_none[:, None]], axis=1)
    found = marginals(log_score, max_cluster=MAX_CLUSTER)
    return Claims(found.prob[:, :-1], found.prob[:, -1], found.log_norm)


def keep(
    settings: Settings, params: Any, tracks: Tracks, scan: Scan, update: Update
) -> tuple[Tracks, Array]:
    """Prunes and caps the tracks; only the likeliest detections make updated tracks.

    Args:
        settings: How many.
        params: The target's `Params`.
        tracks: The N tracks that were updated.
        scan: K detections.
        update: What became of them.

    Returns:
        The survivors, likeliest first, and the expected number of targets dropped.
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
