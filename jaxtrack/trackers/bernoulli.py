"""Tracks that may or may not exist: what the multi-Bernoulli trackers share.

N independent tracks, each with a probability that it exists, a belief about its target
and a label. Births append tracks, `tell_apart` keeps reported labels apart, `report` is
the estimate. The target algebra is any of `jaxtrack.targets`.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers.bernoulli import Tracks, tell_apart
    >>> label, alias = jnp.full(3, 7), jnp.full(3, -1)
    >>> twins = Tracks(jnp.array([0.9, 0.8, 0.1]), None, label, alias)
    >>> tracks, shown, next_label = tell_apart(twins, jnp.array(12), threshold=0.5)
    >>> print(shown, tracks.label, tracks.alias, next_label)
    [ 7 12  7] [7 7 7] [-1 12 -1] 13

Reference for births from detections: Reuter, Vo, Vo and Dietmayer, "The labeled multi-
Bernoulli filter", IEEE Trans. Signal Processing 62(12), 2014.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.models.birth import (
    DetectionBirth,
    MultiBernoulliBirth,
    PoissonBirth,
    likeliest,
)
from jaxtrack.types import Array, Gaussian, PyTree, Scan, Target


class Tracks(NamedTuple):
    """N slots.

    Attributes:
        existence_prob: 0 marks an empty slot, [N].
        belief: [N, ...].
        label: Which target it is, by ancestry, [N] (int).
        alias: What it was last reported as while a likelier track had its label, or -1,
            [N] (int).
    """

    existence_prob: Array
    belief: PyTree
    label: Array
    alias: Array


class Estimate(NamedTuple):
    """What a scan taught, for the user; the likeliest tracks come first.

    Attributes:
        mean: [N, D].
        cov: [N, D, D].
        label: Which target it is, [N] (int).
        exists: Report this one, [N] (bool).
        existence_prob: [N].
        mode_prob: [N, M].
        effective_size: How many equally weighted particles each belief is worth; 0
            where it is no sample, [N].
        num_mean: Expected number of targets.
        num_var: Variance of the number of targets, as far as the tracker knows.
        log_evidence: Log-density of the scan given the past; trackers say how exact.
        dropped: Expected number of targets, or of the parts of their mixtures, that the
            capacities threw away.
    """

    mean: Array
    cov: Array
    label: Array
    exists: Array
    existence_prob: Array
    mode_prob: Array
    effective_size: Array
    num_mean: Array
    num_var: Array
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
        label=jnp.full(size, -1, int),
        alias=jnp.full(size, -1, int),
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
    births: MultiBernoulliBirth | PoissonBirth,
    next_label: Array,
    key: Array,
) -> Tracks:
    """Makes the newborn tracks, each under a label of its own.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        births: B places; at most one target is born at each.
        next_label: The first free label.
        key: Random key.

    Returns:
        B tracks.
    """
    if isinstance(births, PoissonBirth):
        births = births.at_most_one()
    size = births.existence_prob.size
    belief = jax.vmap(target.begin, (None, 0, 0, 0))(
        params,
        Gaussian(births.mean, births.cov),
        births.mode_prob,
        jax.random.split(key, size),
    )
    label = next_label + jnp.arange(size)
    return Tracks(births.existence_prob, belief, label, jnp.full_like(label, -1))


def append(tracks: Tracks, born: Tracks) -> Tracks:
    """Joins N and B tracks into N + B."""
    return jax.tree.map(lambda old, new: jnp.concatenate([old, new]), tracks, born)


def absorb(
    target: Target,
    params: Any,
    views: PyTree,
    max_parents: int,
    log_weight: Array,
    detection: Array,
) -> tuple[PyTree, Array, Array]:
    """Makes the belief of the track that a detection updates.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        views: N tracks as the sensor sees them, [N, ...].
        max_parents: Tracks that may share in the belief, the heaviest.
        log_weight: Share of each track, not normalised, [N].
        detection: [Z].

    Returns:
        The belief, the slot of the heaviest track, and the share of the belief that the
        capacities threw away.
    """
    heaviest, parents = jax.lax.top_k(log_weight, min(max_parents, log_weight.size))
    some = jax.tree.map(lambda x: x[parents], views)
    belief = target.absorb(params, heaviest, some, detection)
    everyone = mixture.total(log_weight)
    known = everyone > -jnp.inf
    lost = 1 - jnp.exp(mixture.total(heaviest) - jnp.where(known, everyone, 0.0))
    lost = jnp.where(known, lost + (1 - lost) * target.lost(belief), 0.0)
    # Not parents[0]: XLA on CPU sorts in full if the best k are not used whole.
    return belief, jnp.argmax(log_weight), lost


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
    return likeliest(births, max_births)


def tell_apart(
    tracks: Tracks, next_label: Array, threshold: float
) -> tuple[Tracks, Array, Array]:
    """Finds the labels under which to report, no two of them alike.

    Of the tracks that exist with more than the threshold under one label, the likeliest
    is the heir and is reported under it. A rival is reported under an alias, which it
    keeps and hands on, but its label stays that of its ancestors: most rivals are a
    second track of the same target, and one of the two soon goes. Who has an alias is
    heir only where nobody without one is.

    Args:
        tracks: N tracks, likeliest first.
        next_label: The first free label.
        threshold: Existence probability above which a track is reported.

    Returns:
        The tracks with the aliases of the rivals, the labels to report [N], and the
        next free label.
    """
    exists = tracks.existence_prob > threshold
    slot = jnp.arange(exists.size)
    rank = jnp.where(tracks.alias >= 0, slot + slot.size, slot)
    rival = repeats(tracks.label, exists, rank)
    known = rival & (tracks.alias >= 0)
    named = known & ~repeats(tracks.alias, known, slot)
    fresh = next_label + jnp.cumsum(rival & ~named) - 1
    alias = jnp.where(rival & ~named, fresh, tracks.alias)
    shown = jnp.where(rival, alias, tracks.label)
    return tracks._replace(alias=alias), shown, next_label + (rival & ~named).sum()


def repeats(name: Array, among: Array, rank: Array) -> Array:
    """Tells which of some slots have the name of one of lower rank, [N] (bool)."""
    same = (name[:, None] == name[None]) & among[:, None] & among[None]
    return (same & (rank[:, None] < rank[None])).any(0)


def report(
    target: Target,
    tracks: Tracks,
    shown: Array,
    threshold: float,
    log_evidence: Array,
    dropped: Array,
) -> Estimate:
    """Reports the tracks that exist with more than the threshold, at their means.

    Args:
        target: How one target is filtered.
        tracks: N tracks.
        shown: Labels to report, [N]; see `tell_apart`.
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
        label=shown,
        exists=tracks.existence_prob > threshold,
        existence_prob=tracks.existence_prob,
        mode_prob=jax.vmap(target.modes)(tracks.belief),
        effective_size=jax.vmap(target.effective_size)(tracks.belief),
        num_mean=tracks.existence_prob.sum(),
        num_var=(tracks.existence_prob * (1 - tracks.existence_prob)).sum(),
        log_evidence=log_evidence,
        dropped=dropped,
    )
