"""One scan of detections against N tracks: the scores, and what an association teaches.

What the trackers share that keep one belief a track: nearest neighbour, GNN, PDA, JPDA
and JIPDA differ only in how they turn the matrix of log-scores into the weights with
which each track takes the detections.

A track may be taken for certain, as in the textbook filters, or weighed by the
probability r that it exists, as in the integrated ones. Then it is missed with weight
1 - r + r (1 - P_D).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import association
    >>> exists, miss = jnp.log(jnp.array(0.5)), jnp.log(jnp.array(0.2))
    >>> print(jnp.exp(association.log_absent_or_missed(exists, miss)).round(6))
    0.6

References: Bar-Shalom and Fortmann, "Tracking and Data Association", 1988; Musicki and
Evans, "Joint integrated probabilistic data association: JIPDA", IEEE Trans. Aerospace
and Electronic Systems 40(3), 2004.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.types import Array, PyTree, Scan, Target

# What a model calls impossible, clutter where there is none or a miss where detection
# is sure, costs this much when it happens; no scan is infeasible.
LEAST_LOG_WEIGHT = -200.0


class Gating(NamedTuple):
    """How tracks choose the detections to look at.

    Attributes:
        prob: P_G, the probability that a target's own detection is inside; 1 for no
            gate.
        in_missed: Count what falls outside as missed: 1 - P_D P_G, not 1 - P_D.
        counts_clutter: Take the clutter's density from the detections in the gates
            (nonparametric), not from the clutter model.
    """

    prob: float
    in_missed: bool
    counts_clutter: bool


class Sighting(NamedTuple):
    """What a scan is to N tracks.

    Attributes:
        log_score: Log-likelihood ratios against clutter; last column missed (or not
            there), [N, K + 1]. An empty slot has only -inf and a last 0.
        log_exists: Log-probability that each track exists, as the scores count it, [N].
        log_miss: log(1 - P_D) of a track that exists, no less than
            `LEAST_LOG_WEIGHT`, [N].
        missed: Beliefs if missed, [N, ...].
        views: As the sensor sees them, [N, ...].
        log_clutter: Log-density of clutter at each detection; 0 where not valid, [K].
    """

    log_score: Array
    log_exists: Array
    log_miss: Array
    missed: PyTree
    views: PyTree
    log_clutter: Array


class Events(NamedTuple):
    """Joint events, in which every track has one detection or none.

    Attributes:
        column: Which column each track has, [E, N].
        log_prob: Of each event; -inf for none, [E].
    """

    column: Array
    log_prob: Array


class Association(NamedTuple):
    """Which detection is whose.

    Attributes:
        log_prob: Log-probability that each track has each detection or, last, none;
            rows sum to one, [N, K + 1].
        log_ratio: How much better the scan is explained with each track than without,
            the log of a ratio of weights, [N]: L where tracks are certain, and
            1 - r + r L where the scores count existence.
        log_norm: Log-weight of the scan: of all joint events, or of those considered.
        unexplained_prob: Probability that no track has the detection, [K].
        exact: Whether log_prob is what the method says, to rounding, [N] (bool).
        events: The joint events behind it, where the method goes by some.
    """

    log_prob: Array
    log_ratio: Array
    log_norm: Array
    unexplained_prob: Array
    exact: Array
    events: Events | None = None


def look(
    gating: Gating,
    weighs: bool,
    target: Target,
    params: Any,
    tracks: Tracks,
    scan: Scan,
) -> Sighting:
    """Scores all pairs of a track and a detection.

    Args:
        gating: Which pairs to look at.
        weighs: Whether existence probabilities count, or tracks are certain.
        target: How one target is filtered.
        params: The tracker's `Params`: target and clutter.
        tracks: N predicted tracks.
        scan: K detections.

    Returns:
        The scores and what the update needs.
    """
    each = jax.vmap(target.miss, (None, 0))
    missed, log_miss = each(params.target, tracks.belief)
    views = jax.vmap(target.look, (None, 0))(params.target, tracks.belief)
    score = jax.vmap(target.score, (None, 0, None))(
        params.target, views, scan.detections
    )
    there = tracks.existence_prob > 0
    gates = gate.validate(target, params.target, views, scan, gating.prob)
    inside = gates.inside & there[:, None]
    if gating.in_missed:
        log_miss = gate.log_missed(log_miss, gating.prob)
    log_miss = jnp.maximum(log_miss, LEAST_LOG_WEIGHT)
    if gating.counts_clutter:
        volume = jnp.where(there, gates.log_volume, -jnp.inf)
        density = gate.log_clutter_density(gate.Gates(inside, volume))
        log_clutter = jnp.full(scan.valid.shape, density)
    else:
        log_clutter = jax.vmap(params.clutter.log_density)(scan.detections)
        log_clutter = jnp.maximum(log_clutter, LEAST_LOG_WEIGHT)

    prob = tracks.existence_prob if weighs else there.astype(log_miss.dtype)
    log_exists = safe_log(prob)
    hit = jnp.where(inside, score - log_clutter[None], -jnp.inf) + log_exists[:, None]
    none = log_absent_or_missed(log_exists, log_miss)
    return Sighting(
        log_score=jnp.concatenate([hit, none[:, None]], axis=1),
        log_exists=log_exists,
        log_miss=log_miss,
        missed=missed,
        views=views,
        log_clutter=jnp.where(scan.valid, log_clutter, 0.0),
    )


def log_absent_or_missed(log_exists: Array, log_miss: Array) -> Array:
    """Returns log(1 - r + r (1 - P_D)) for log r and log(1 - P_D)."""
    absent = safe_log(-jnp.expm1(log_exists))
    return jnp.logaddexp(absent, log_exists + log_miss)


def filled(scan: Scan) -> Scan:
    """Returns a scan with a slot at least, and zeros where nothing was detected."""
    short = 0 if scan.valid.size else 1
    detections = jnp.where(scan.valid[:, None], scan.detections, 0.0)
    return scan._replace(
        detections=jnp.pad(detections, ((0, short), (0, 0))),
        valid=jnp.pad(scan.valid, (0, short)),
    )


def hard(log_score: Array, column: Array, log_norm: Array) -> Association:
    """Makes the association in which each track has one detection, or none.

    Args:
        log_score: [N, K + 1].
        column: Which column each track has, [N].
        log_norm: Log-weight of this joint event.
    """
    num_columns = log_score.shape[1]
    taken = column[:, None] == jnp.arange(num_columns)[None]
    chosen = jnp.where(taken, log_score, 0.0).sum(1)
    return Association(
        log_prob=jnp.where(taken, 0.0, -jnp.inf).astype(log_score.dtype),
        log_ratio=chosen,
        log_norm=log_norm,
        unexplained_prob=1 - taken[:, :-1].any(0).astype(log_score.dtype),
        exact=jnp.ones(len(column), bool),
    )


def soft(
    log_score: Array, log_prob: Array, log_norm: Array, exact: Array
) -> Association:
    """Makes the association with given probabilities.

    Without track n the scan weighs Z_n, and Z_n times its weight of a miss is the
    weight of all events in which it is missed. So the miss's probability tells how much
    better the scan is explained with the track, its rivals for detections counted.

    Args:
        log_score: [N, K + 1].
        log_prob: Rows sum to one, [N, K + 1].
        log_norm: Log-weight of the scan.
        exact: Whether the probabilities are, [N] (bool).
    """
    none, log_none = log_score[:, -1], log_prob[:, -1]
    # Where a miss has no probability left there is no telling; the row must do.
    known = (none > -jnp.inf) & (log_none > -jnp.inf)
    ratio = jnp.where(known, none, 0.0) - jnp.where(known, log_none, 0.0)
    alone = jax.vmap(mixture.total)(log_score)
    unexplained = 1 - jnp.exp(log_prob[:, :-1]).sum(0)
    return Association(
        log_prob=log_prob,
        log_ratio=jnp.where(known, ratio, alone),
        log_norm=log_norm,
        unexplained_prob=jnp.clip(unexplained, 0.0, 1.0),
        exact=exact,
    )


def existence(tracks: Tracks, sighting: Sighting, answer: Association) -> Array:
    """Returns the probability that each track exists, after the scan, [N].

    Args:
        tracks: N predicted tracks.
        sighting: The scores.
        answer: The association of those scores.

    Returns:
        r L / (1 - r + r L), L the likelihood ratio. Rounding makes nobody immortal, and
        no track that was taken for certain vanish: that is for the rule to say.
    """
    prob = tracks.existence_prob
    weighed = sighting.log_exists < 0
    log_absent = safe_log(1 - prob) - jnp.where(
        weighed, answer.log_ratio, _log_row(prob, answer.log_ratio)
    )
    info, after = jnp.finfo(prob.dtype), -jnp.expm1(jnp.minimum(log_absent, 0.0))
    most = jnp.where(prob < 1, 1 - info.eps, 1.0)
    least = jnp.where(weighed, 0.0, 1e6 * info.tiny)
    return jnp.where(prob > 0, jnp.clip(after, least, most), 0.0)


def log_ratio(tracks: Tracks, sighting: Sighting, answer: Association) -> Array:
    """Returns the log-likelihood ratio L of each track against none, [N].

    Args:
        tracks: N predicted tracks.
        sighting: The scores.
        answer: The association of those scores.
    """
    ratio, prob = answer.log_ratio, tracks.existence_prob
    weighed = (prob > 0) & (sighting.log_exists < 0)
    safe = jnp.where(weighed, prob, 1.0)
    # 1 + (x - 1) / r for x = 1 - r + r L, which for large x is x / r.
    large = ratio > 30.0
    some = 1 + jnp.expm1(jnp.where(large, 0.0, ratio)) / safe
    small = jnp.log(jnp.maximum(some, jnp.finfo(prob.dtype).tiny))
    recovered = jnp.where(large, ratio - jnp.log(safe), small)
    return jnp.where(weighed, recovered, ratio)


def _log_row(prob: Array, log_ratio: Array) -> Array:
    """Returns log(1 - r + r L)."""
    return jnp.logaddexp(safe_log(1 - prob), safe_log(prob) + log_ratio)


def blend(
    target: Target, params: Any, sighting: Sighting, answer: Association, scan: Scan
) -> PyTree:
    """Updates each track by its own mixture of detections, given that it exists.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        sighting: The tracks, as the sensor sees them.
        answer: Whose the detections are.
        scan: K detections.

    Returns:
        N beliefs.
    """
    exists_if_none = sighting.log_exists + sighting.log_miss
    none = sighting.log_score[:, -1]
    known = none > -jnp.inf
    share = jnp.where(known, exists_if_none - jnp.where(known, none, 0.0), 0.0)
    log_weight = answer.log_prob.at[:, -1].add(share)
    return jax.vmap(target.blend, (None, 0, 0, 0, None))(
        params, sighting.views, sighting.missed, log_weight, scan.detections
    )
