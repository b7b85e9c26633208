"""How tracks begin: at known places, at one detection, or at two of successive scans.

    >>> from jaxtrack.trackers import initiation
    >>> initiation.num_driven(None, max_births=8)
    0

Reference: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation", 2001, section 5.5.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.models.birth import (
    DetectionBirth,
    MultiBernoulliBirth,
    PoissonBirth,
    likeliest,
)
from jaxtrack.models.pairs import PairBirth
from jaxtrack.models.sensor import Timed
from jaxtrack.trackers import bernoulli, management
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.types import Array, Scan, Target

Birth = DetectionBirth | PairBirth | MultiBernoulliBirth | PoissonBirth | None


class Leftovers(NamedTuple):
    """The detections of a scan that are not known to be a target's.

    Attributes:
        detections: [K, Z].
        unexplained_prob: Probability that no track caused it; 0 for one that is not
            there, [K].
    """

    detections: Array
    unexplained_prob: Array


class Begun(NamedTuple):
    """The tracks that a scan began.

    Attributes:
        tracks: B slots.
        record: [B].
        leftovers: What this scan leaves to the next.
        dropped: Expected number of new targets that found no room.
    """

    tracks: Tracks
    record: management.Record
    leftovers: Leftovers
    dropped: Array


def num_driven(birth: Birth, max_births: int) -> int:
    """Returns how many slots are kept for tracks that detections begin."""
    return max_births if isinstance(birth, (DetectionBirth, PairBirth)) else 0


def mode_prob(birth: Birth, params: Any) -> Array:
    """Returns the mode probabilities of some newborn, [M]."""
    if birth is None:
        num_modes = len(getattr(params, "motions", (0,)))
        return jnp.full(num_modes, 1 / num_modes)
    if isinstance(birth, (DetectionBirth, PairBirth)):
        return linalg.floating(birth.mode_prob)
    return linalg.floating(birth.mode_prob)[0]


def nothing(birth: Birth, params: Any, max_births: int) -> Leftovers:
    """Returns no detections, in as many slots as two-point births look back on."""
    size = max_births if isinstance(birth, PairBirth) else 0
    sensor = params.sensor
    width = sensor.num_outputs + isinstance(sensor, Timed)
    dtype = mode_prob(birth, params).dtype
    return Leftovers(jnp.zeros((size, width), dtype), jnp.zeros(size, dtype))


def at_start(
    target: Target, params: Any, max_tracks: int, next_label: Array, key: Array
) -> tuple[Tracks, management.Record]:
    """Makes the tracks of the targets that may be there before the first scan.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`, with a `start`.
        max_tracks: Capacity.
        next_label: The first free label.
        key: Random key.

    Raises:
        ValueError: There are more than the capacity.
    """
    if len(params.start.existence_prob) > max_tracks:
        raise ValueError(
            f"start has {len(params.start.existence_prob)} targets and max_tracks is "
            f"{max_tracks}; make room for them"
        )
    known = bernoulli.begin(target, params.target, params.start, next_label, key)
    record = management.begin(known.existence_prob, num_hits=1)
    return known, record._replace(confirmed=known.existence_prob > 0.5)


def at_known_places(
    target: Target,
    weighs: bool,
    params: Any,
    tracks: Tracks,
    record: management.Record,
    next_label: Array,
    key: Array,
) -> tuple[Tracks, management.Record, Array]:
    """Appends the tracks that may be born at known places, before the update.

    Args:
        target: How one target is filtered.
        weighs: Whether the scores count the probability that a track exists.
        params: The tracker's `Params`.
        tracks: N tracks.
        record: What they have done, [N].
        next_label: The first free label.
        key: Random key.

    Returns:
        N + B tracks and their records, and the next free label.

    Raises:
        ValueError: The tracker takes tracks for certain.
    """
    birth = params.birth
    if not isinstance(birth, (MultiBernoulliBirth, PoissonBirth)):
        return tracks, record, next_label
    if not weighs:
        raise ValueError(
            f"birth is a {type(birth).__name__}, and this tracker takes every track "
            "for certain; give a DetectionBirth or PairBirth, or use an integrated "
            "tracker such as jipda"
        )
    born = bernoulli.begin(target, params.target, birth, next_label, key)
    fresh = management.begin(born.existence_prob, num_hits=0)
    record = jax.tree.map(
        lambda x, y: jnp.concatenate([x, y.astype(x.dtype)]), record, fresh
    )
    return bernoulli.append(tracks, born), record, next_label + born.label.size


def begin(
    target: Target,
    params: Any,
    max_births: int,
    scan: Scan,
    unexplained_prob: Array,
    leftovers: Leftovers,
    next_label: Array,
    key: Array,
) -> Begun:
    """Begins tracks where detections are unexplained, after the update.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        max_births: Tracks begun, the likeliest.
        scan: K detections.
        unexplained_prob: Probability that no track caused it; 0 for one that is not
            there, [K].
        leftovers: Of the scan before.
        next_label: The first free label.
        key: Random key.

    Returns:
        The tracks begun.
    """
    birth = params.birth
    if not num_driven(birth, max_births):
        nobody = bernoulli.nobody(
            target, params.target, mode_prob(birth, params.target), 0, key
        )
        record = management.begin(nobody.existence_prob, num_hits=0)
        return Begun(nobody, record, leftovers, jnp.zeros_like(unexplained_prob.sum()))
    if isinstance(birth, DetectionBirth):
        places, dropped = bernoulli.from_unexplained(
            birth, params.target, scan, unexplained_prob, max_births
        )
    else:
        detections = jnp.where(scan.valid[:, None], scan.detections, 0.0)
        now = Leftovers(detections, unexplained_prob)
        sensor, layout = params.target.sensor, params.target.layout
        proposed = birth.propose(sensor, layout, *now, *leftovers, scan.interval)
        places, dropped = likeliest(proposed, max_births)
        now = _few(
            jax.tree.map(lambda x, y: x.astype(y.dtype), now, leftovers), max_births
        )
        # A first point that found no room may have been a target's.
        lost = 1 - now.unexplained_prob.sum() / jnp.maximum(
            unexplained_prob.sum(), 1e-9
        )
        dropped = dropped + jnp.maximum(lost, 0.0) * birth.rate * scan.interval
        leftovers = now
    tracks = bernoulli.begin(target, params.target, places, next_label, key)
    hits = 1 if isinstance(birth, DetectionBirth) else 2
    record = management.begin(tracks.existence_prob, num_hits=hits)
    return Begun(tracks, record, leftovers, dropped)


def _few(leftovers: Leftovers, size: int) -> Leftovers:
    """Keeps as many detections, those least explained."""
    short = max(size - len(leftovers.unexplained_prob), 0)
    padded = Leftovers(
        jnp.pad(leftovers.detections, ((0, short), (0, 0))),
        jnp.pad(leftovers.unexplained_prob, (0, short)),
    )
    _, kept = jax.lax.top_k(padded.unexplained_prob, size)
    return jax.tree.map(lambda x: x[kept], padded)
