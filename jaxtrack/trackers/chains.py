"""Chains of causes: a track's hypotheses over the scans of several sensors.

A chain is a track, and for each sensor so far a miss or one of its detections. What is
known of a sensor alone multiplies it (`factors`), and so does how well its causes fit
one target. At the end all chains with the same detections are one track again.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import chains
    >>> claimed, alone = jnp.array([0.9, 0.0]), jnp.array([0.3, 0.0])
    >>> print(jnp.exp(chains.ratio(jnp.log(claimed), jnp.log(alone))).round(6))
    [3. 0.]

Reference: see `several_cbmember`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import multi_bernoulli
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.trackers.multi_bernoulli import Settings
from jaxtrack.types import Array, PyTree, Scan, Target


class Chains(NamedTuple):
    """H hypotheses of N tracks.

    Attributes:
        log_weight: Beside the absence of the track, [H].
        belief: [H, ...].
        track: Whose, [H] (int).
        causes: Number of the detections, digit by digit; 0 for none, [H] (int).
    """

    log_weight: Array
    belief: PyTree
    track: Array
    causes: Array


class Alone(NamedTuple):
    """What one sensor says about N tracks.

    Attributes:
        log_miss: Factor of a chain whose target it missed, [N].
        log_hit: Factor of a chain whose target caused its detection k, [N, K].
        log_absent: Factor of the track's absence, [N].
        unexplained_prob: Probability that no track caused the detection, [K].
        log_evidence: Log-density of its scan.
    """

    log_miss: Array
    log_hit: Array
    log_absent: Array
    unexplained_prob: Array
    log_evidence: Array


def start(tracks: Tracks) -> Chains:
    """Makes a chain without causes of each of N predicted tracks."""
    num = jnp.arange(tracks.label.size)
    log_exists = safe_log(tracks.existence_prob)
    return Chains(log_exists, tracks.belief, num, jnp.zeros_like(num))


def ratio(log_prob: Array, log_alone: Array) -> Array:
    """Returns log_prob - log_alone, and -inf where either is."""
    known = (log_prob > -jnp.inf) & (log_alone > -jnp.inf)
    gap = jnp.where(known, log_prob, 0.0) - jnp.where(known, log_alone, 0.0)
    return jnp.where(known, gap, -jnp.inf)


def factors(target: Target, params: Any, tracks: Tracks, scan: Scan) -> Alone:
    """Works out what one sensor says, by the claims of `multi_bernoulli`.

    Args:
        target: How one target is filtered.
        params: Of a tracker with this sensor only.
        tracks: N, predicted.
        scan: K detections.
    """
    seen = multi_bernoulli.see(target, params, tracks, scan)
    claims, log_clutter, exists_if_none = multi_bernoulli.claim(seen, scan.valid)
    log_exists = safe_log(seen.prob)
    missed = safe_log(claims.none_prob * exists_if_none)
    absent = safe_log(claims.none_prob * (1 - exists_if_none))
    log_score = log_exists[:, None] + seen.log_score
    return Alone(
        log_miss=ratio(missed, log_exists + seen.log_miss),
        log_hit=ratio(safe_log(claims.hit_prob), log_score),
        log_absent=ratio(absent, safe_log(1 - seen.prob)),
        unexplained_prob=jnp.clip(1 - claims.hit_prob.sum(0), 0.0, 1.0),
        log_evidence=claims.log_norm + log_clutter.sum() - params.clutter.rate,
    )


def grow(
    max_updated: int,
    target: Target,
    params: Any,
    alone: Alone,
    chains: Chains,
    scan: Scan,
) -> tuple[Chains, Array]:
    """Lets one sensor more miss or detect the targets of H chains.

    Args:
        max_updated: U, chains with one of its detections that are kept, the heaviest.
        target: How one target is filtered.
        params: Of a tracker with this sensor only.
        alone: What the sensor says by itself.
        chains: H.
        scan: K detections.

    Returns:
        H + U chains, and the share of the weight that found no room.
    """
    missed, log_miss = jax.vmap(target.miss, (None, 0))(params.target, chains.belief)
    views = jax.vmap(target.look, (None, 0))(params.target, chains.belief)
    score = jax.vmap(target.score, (None, 0, None))(
        params.target, views, scan.detections
    )
    log_hit = chains.log_weight[:, None] + score + alone.log_hit[chains.track]
    log_hit = jnp.where(scan.valid[None], log_hit, -jnp.inf)
    num, most = scan.valid.size, min(max_updated, log_hit.size)
    heaviest, pair = jax.lax.top_k(log_hit.ravel(), most)
    parent, detection = pair // num, pair % num
    belief = jax.vmap(target.correct, (None, 0, 0))(
        params.target,
        jax.tree.map(lambda x: x[parent], views),
        scan.detections[detection],
    )
    shifted = chains.causes * (num + 1)
    hits = Chains(
        heaviest, belief, chains.track[parent], shifted[parent] + 1 + detection
    )
    log_weight = chains.log_weight + log_miss + alone.log_miss[chains.track]
    legacy = Chains(log_weight, missed, chains.track, shifted)
    grown = jax.tree.map(lambda x, y: jnp.concatenate([x, y]), legacy, hits)
    every = mixture.total(jnp.append(log_weight, log_hit))
    kept = mixture.total(grown.log_weight)
    share = jnp.exp(jnp.where(every > -jnp.inf, kept - every, 0.0))
    return grown, jnp.maximum(1 - share, 0.0)


def gather(
    settings: Settings, params: Any, tracks: Tracks, chains: Chains, log_absent: Array
) -> tuple[Tracks, Array, Array]:
    """Makes one track of all chains with the same detections, or of the same misses.

    Args:
        settings: How many tracks to keep.
        params: The target's `Params`.
        tracks: The N tracks from which the chains started.
        chains: H, after all sensors.
        log_absent: Weight of the absence of each track, [N].

    Returns:
        The likeliest tracks first; the log of the weight of everything; and the
        expected number of targets that found no room.
    """
    target, num = settings.target, tracks.label.size
    mine = chains.track[None] == jnp.arange(num)[:, None]
    weights = jnp.where(mine, chains.log_weight[None], -jnp.inf)
    every = jnp.concatenate([weights, log_absent[:, None]], axis=1)
    log_norm = jax.vmap(mixture.total)(every)  # [N]
    safe = jnp.where(log_norm > -jnp.inf, log_norm, 0.0)
    log_prob = chains.log_weight - safe[chains.track]

    name = jnp.where(chains.causes == 0, chains.track, num + chains.causes)
    member = jnp.where(name[:, None] == name[None], log_prob[None], -jnp.inf)
    leads = jnp.argmax(member, axis=1) == jnp.arange(name.size)
    prob = jnp.exp(jax.vmap(mixture.total)(member))
    listed = jnp.where(leads & (prob >= settings.prune_threshold), prob, 0.0)
    kept_prob, kept = jax.lax.top_k(listed, min(settings.max_tracks, prob.size))
    heaviest, slot = jax.lax.top_k(member[kept], min(settings.max_parents, name.size))
    some = jax.tree.map(lambda x: x[slot], chains.belief)
    belief = jax.vmap(target.collapse)(heaviest, some)
    kept_prob = jnp.minimum(kept_prob, 1.0)
    belief = jax.vmap(target.adapt, (None, 0, 0))(params, belief, kept_prob)
    origin = chains.track[kept]
    survivors = Tracks(kept_prob, belief, tracks.label[origin], tracks.alias[origin])
    return survivors, log_norm.sum(), jnp.maximum(listed.sum() - kept_prob.sum(), 0.0)
