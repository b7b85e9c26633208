"""Tracks that may or may not exist: what the multi-Bernoulli trackers share.

N independent tracks, each with a probability that it exists, a belief about its target
and a label. Births append tracks, `inherit` keeps labels apart, `report` is the
estimate. The target algebra is any of `jaxtrack.targets`.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers.bernoulli import Tracks, inherit
    >>> twins = Tracks(jnp.array([0.9, 0.8, 0.1]), None, jnp.array([7, 7, 7]))
    >>> tracks, next_label = inherit(twins, jnp.array(12), threshold=0.5)
    >>> print(tracks.label, next_label)
    [ 7 12  7] 13

Reference for births from detections: Reuter, Vo, Vo and Dietmayer, "The labeled multi-
Bernoulli filter", IEEE Trans. Signal Processing 62(12), 2014.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth
from jaxtrack.types import Array, Gaussian, PyTree, Scan, Target


class Tracks(NamedTuple):
    """N slots: existence_prob [N] (0 = empty), belief [N, ...], label [N]."""

    existence_prob: Array
    belief: PyTree
    label: Array


class Estimate(NamedTuple):
    """What a scan taught, for the user; the likeliest tracks come first.

    Attributes: mean: [N, D]. cov: [N, D, D]. label: Which target it is, [N] (int).
        exists: Report this one, [N] (bool). existence_prob: [N]; its sum is the
        expected number of targets. mode_prob: [N, M]. log_evidence: Log-density of the
        scan given the past; the tracker says how exact. dropped: Expected number of
        targets that the capacities threw away.
    """

    mean: Array
    cov: Array
    label: Array
    exists: Array
    existence_prob: Array
    mode_prob: Array
    log_evidence: Array
    dropped: Array


def nobody(
    target: Target, params: Any, mode_prob: Array, size: int, key: Array
) -> Tracks:
    """Makes empty slots.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        mode_prob: Any mode probabilities, [M]; they say how many modes there are.
        size: Number of slots N.
        key: Random key.

    Returns:
        N tracks that do not exist, with label -1 and finite beliefs.
    """
    dim, dtype = params.layout.dim, mode_prob.dtype
    origin = Gaussian(jnp.zeros(dim, dtype), jnp.eye(dim, dtype=dtype))
    belief = target.begin(params, origin, mode_prob, key)
    return Tracks(
        existence_prob=jnp.zeros(size, dtype),
        belief=jax.tree.map(lambda x: jnp.broadcast_to(x, (size, *x.shape)), belief),
        label=jnp.full(size, -1),
    )


def predict(target: Target, params: Any, tracks: Tracks, interval: Array) -> Tracks:
    """Lets each track survive with its probability, and move.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        tracks: N tracks.
        interval: Seconds.

    Returns:
        The predicted tracks.
    """
    belief, log_survive = jax.vmap(target.predict, (None, 0, None))(
        params, tracks.belief, interval
    )
    survived = tracks.existence_prob * jnp.exp(log_survive)
    return tracks._replace(existence_prob=survived, belief=belief)


def begin(
    target: Target,
    params: Any,
    births: MultiBernoulliBirth,
    next_label: Array,
    key: Array,
) -> Tracks:
    """Makes the newborn tracks, each under a label of its own.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        births: B places.
        next_label: The first free label.
        key: Random key.

    Returns:
        B tracks.
    """
    size = births.existence_prob.size
    belief = jax.vmap(target.begin, (None, 0, 0, 0))(
        params,
        Gaussian(births.mean, births.cov),
        births.mode_prob,
        jax.random.split(key, size),
    )
    return Tracks(births.existence_prob, belief, next_label + jnp.arange(size))


def append(tracks: Tracks, born: Tracks) -> Tracks:
    """Joins N and B tracks into N + B."""
    return jax.tree.map(lambda old, new: jnp.concatenate([old, new]), tracks, born)


def from_unexplained(
    birth: DetectionBirth,
    params: Any,
    scan: Scan,
    unexplained_prob: Array,
    max_births: int,
) -> tuple[MultiBernoulliBirth, Array]:
    """Proposes births where detections are unexplained.

    Args:
        birth: How likely, and how fast.
        params: The target's `Params`.
        scan: K detections.
        unexplained_prob: Probability that no track caused the detection, [K].
        max_births: Places kept, the likeliest.

    Returns:
        `max_births` places, and the expected number of births that found no room.
    """
    births = birth.propose(
        params.sensor,
        params.layout,
        scan.detections,
        scan.valid,
        unexplained_prob,
        scan.interval,
    )
    prob = births.existence_prob
    if (short := max_births - prob.size) > 0:
        prob = jnp.concatenate([prob, jnp.zeros(short, prob.dtype)])
    likely, kept = jax.lax.top_k(prob, max_births)
    places = jax.tree.map(
        lambda x: x[jnp.minimum(kept, births.existence_prob.size - 1)], births
    )
    return places._replace(existence_prob=likely), prob.sum() - likely.sum()


def inherit(
    tracks: Tracks, next_label: Array, threshold: float
) -> tuple[Tracks, Array]:
    """Keeps the labels of reported tracks apart.

    Of the tracks that exist with more than the threshold under one label, the likeliest
    is the heir; each other starts a new label, for good.

    Args:
        tracks: N tracks, likeliest first.
        next_label: The first free label.
        threshold: Existence probability above which a track is reported.

    Returns:
        The tracks, and the next free label.
    """
    exists = tracks.existence_prob > threshold
    same = (
        (tracks.label[:, None] == tracks.label[None]) & exists[:, None] & exists[None]
    )
    slot = jnp.arange(exists.size)
    rival = (same & (slot[:, None] < slot[None])).any(0)
    label = jnp.where(rival, next_label + jnp.cumsum(rival) - 1, tracks.label)
    return tracks._replace(label=label), next_label + rival.sum()


def report(
    target: Target,
    tracks: Tracks,
    threshold: float,
    log_evidence: Array,
    dropped: Array,
) -> Estimate:
    """Reports the tracks that exist with more than the threshold, at their means.

    Args:
        target: How one target is filtered.
        tracks: N tracks.
        threshold: Existence probability above which a track is reported.
        log_evidence: Log-density of the scan.
        dropped: Expected number of targets that the capacities threw away.

    Returns:
        The estimate (Yuan 2013, Algorithm 1).
    """
    belief = jax.vmap(target.moments)(tracks.belief)
    return Estimate(
        mean=belief.mean,
        cov=belief.cov,
        label=tracks.label,
        exists=tracks.existence_prob > threshold,
        existence_prob=tracks.existence_prob,
        mode_prob=jax.vmap(target.modes)(tracks.belief),
        log_evidence=log_evidence,
        dropped=dropped,
    )
