"""Projects all joint events on one belief a track: what `pmb` and `lmb` share.

After a scan a track is a mixture over what it may have been given, and not independent
of the others, with which it competes. Kept is how likely each exists, and the belief
about it summed over the mixture; that is the set of independent tracks nearest to the
truth, by the Kullback-Leibler divergence, among those that know who is who.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import projection
    >>> from jaxtrack.trackers.bernoulli import Tracks
    >>> label, alias = jnp.arange(3), jnp.full(3, -1)
    >>> tracks = Tracks(jnp.array([0.3, 0.9, 0.2]), jnp.zeros((3, 1)), label, alias)
    >>> kept, lost = projection.keep(tracks, size=2, threshold=0.25)
    >>> print(kept.existence_prob, kept.label, lost.round(3))
    [0.9 0.3] [1 0] 0.2

Reference: Williams, "An efficient, variational approximation of the best fitting
multi-Bernoulli filter", IEEE Trans. Signal Processing 63(1), 2015, section II.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack.trackers import association, bernoulli
from jaxtrack.trackers.association import Association, Sighting
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.trackers.undetected import Params
from jaxtrack.types import Array, Scan, Target


def begin(target: Target, params: Params, empty: Tracks, key: Array) -> Tracks:
    """Puts the targets that may be known before the first scan into empty slots.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        empty: N slots.
        key: Random key.

    Raises:
        ValueError: There are more than the capacity.
    """
    if params.start is None:
        return empty
    known = bernoulli.begin(target, params.target, params.start, jnp.array(0), key)
    if (room := len(empty.label) - len(known.label)) < 0:
        raise ValueError(
            f"start has {len(known.label)} targets and max_tracks is "
            f"{len(empty.label)}; make room for them"
        )
    return bernoulli.append(known, jax.tree.map(lambda x: x[:room], empty))


def update(
    target: Target,
    params: Any,
    tracks: Tracks,
    sight: Sighting,
    answer: Association,
    scan: Scan,
) -> Tracks:
    """Returns the tracks, each over all that it may have been given.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        tracks: N predicted tracks.
        sight: The scan as they see it; the scores count existence.
        answer: Whose the detections are.
        scan: K detections.
    """
    exists = association.existence(tracks, sight, answer)
    belief = association.blend(target, params, sight, answer, scan)
    adapt = jax.vmap(target.adapt, (None, 0, 0))
    return tracks._replace(existence_prob=exists, belief=adapt(params, belief, exists))


def keep(tracks: Tracks, size: int, threshold: float) -> tuple[Tracks, Array]:
    """Keeps the likeliest tracks.

    Args:
        tracks: N tracks.
        size: How many.
        threshold: A track goes where its target exists with less probability.

    Returns:
        `size` tracks, likeliest first, and the expected number of targets in the
        others.
    """
    prob = tracks.existence_prob
    kept = jnp.where(prob > threshold, prob, 0.0)
    likely, slot = jax.lax.top_k(kept, size)
    some = jax.tree.map(lambda x: x[slot], tracks)
    label = jnp.where(likely > 0, some.label, -1)
    lost = jnp.maximum(prob.sum() - likely.sum(), 0.0)
    return some._replace(existence_prob=likely, label=label), lost
