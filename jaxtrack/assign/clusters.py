"""Tracks that share detections, directly or through other tracks: clusters.

Nothing is shared between clusters, so joint events factor over them. Their detections,
one cluster after another, are the steps of the dynamic programme in
`jaxtrack.assign.exact`.

All functions are for R problems, the last axis (see `jaxtrack.assign.lanes`).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import clusters
    >>> possible = jnp.array([[True, False], [False, True], [True, False]])
    >>> print(clusters.label(possible[..., None])[:, 0])
    [0 1 0]
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.types import Array


class Steps(NamedTuple):
    """The order in which detections are gone through.

    Attributes:
        item: The detection of each step, [K, R].
        used: Whether the step counts; those that do come first, [K, R] (bool).
        first: Whether a cluster begins with it, [K, R] (bool).
        last: Whether a cluster ends with it, [K, R] (bool).
        member: The track of each bit in the step's cluster, [K, C, R].
        there: Whether the cluster has that bit, [K, C, R] (bool).
        step: The step of each detection, [K, R].
        bit: The bit of each track, [N, R].
        end: The last step of each track's cluster, [N, R]; -1 or another's if it has
            none.
        shared: Whether a track has detections and fits, [N, R] (bool).
        fits: Whether a track's cluster has no more than C tracks, [N, R] (bool).
        inside: Whether a detection belongs to a cluster that fits, [K, R] (bool).
        size: Number of tracks in the largest cluster that fits, [R]; isolated tracks
            are not counted.
    """

    item: Array
    used: Array
    first: Array
    last: Array
    member: Array
    there: Array
    step: Array
    bit: Array
    end: Array
    shared: Array
    fits: Array
    inside: Array
    size: Array


def label(possible: Array) -> Array:
    """Returns the first track of each track's cluster, [N, R].

    Args:
        possible: Whether a track may have caused a detection, [N, K, R] (bool).
    """
    num_tracks, _, number = possible.shape
    own = jnp.arange(num_tracks, dtype=jnp.int32)[:, None]

    def spread(state: tuple[Array, Array]) -> tuple[Array, Array]:
        before, _ = state
        after = jnp.where(possible, of_items(possible, before)[None], num_tracks)
        after = jnp.minimum(before, after.min(1, initial=num_tracks))
        return after, (after != before).any()

    start = jnp.broadcast_to(own, (num_tracks, number))
    return jax.lax.while_loop(lambda x: x[1], spread, (start, jnp.array(True)))[0]


def of_items(possible: Array, labels: Array) -> Array:
    """Returns the label of each detection, N if no track may have caused it, [K, R]."""
    num_tracks = possible.shape[0]
    return jnp.where(possible, labels[:, None], num_tracks).min(0, initial=num_tracks)


def steps(possible: Array, max_cluster: int) -> Steps:
    """Orders detections by cluster, leaving out clusters of too many tracks.

    Args:
        possible: Whether a track may have caused a detection, [N, K, R] (bool).
        max_cluster: C.
    """
    num_tracks = possible.shape[0]
    labels = label(possible)
    same = labels[:, None] == labels[None]  # [N, N, R]
    earlier = jnp.tri(num_tracks, k=-1, dtype=bool)[..., None]
    count = same.sum(1, dtype=jnp.int32)
    bit = (same & earlier).sum(1, dtype=jnp.int32)
    fits = count <= max_cluster

    of_item = of_items(possible & fits[:, None], labels)
    item, step = _order(of_item)
    sorted_label = jnp.take_along_axis(of_item, item, axis=0)
    used = sorted_label < num_tracks
    fresh = sorted_label[1:] != sorted_label[:-1]
    edge = jnp.ones_like(used[:1])

    track, _ = _order(labels)
    before = (labels[None] < sorted_label[:, None]).sum(1, dtype=jnp.int32)  # [K, R]
    bits = jnp.arange(max_cluster, dtype=jnp.int32)[None, :, None]
    place = jnp.minimum(before[:, None] + bits, num_tracks - 1)
    member = jnp.take_along_axis(track, place.reshape(-1, place.shape[-1]), axis=0)
    member = member.reshape(place.shape)
    mine = jnp.take_along_axis(labels, member.reshape(-1, place.shape[-1]), axis=0)
    there = (mine.reshape(place.shape) == sorted_label[:, None]) & used[:, None]
    shared = possible.any(1) & fits
    return Steps(
        item=item,
        used=used,
        first=used & jnp.concatenate([edge, fresh]),
        last=used & jnp.concatenate([fresh, edge]),
        member=member,
        there=there & (before[:, None] + bits < num_tracks),
        step=step,
        bit=bit,
        end=(of_item[None] <= labels[:, None]).sum(1, dtype=jnp.int32) - 1,
        shared=shared,
        fits=fits,
        inside=of_item < num_tracks,
        size=jnp.where(shared, count, 0).max(0),
    )


def _order(key: Array) -> tuple[Array, Array]:
    """Sorts each column of integers [L, R], stably, by counting.

    Returns:
        Which entry stands at each place, and the place of each entry, both [L, R].
    """
    size = key.shape[0]
    index = jnp.arange(size, dtype=jnp.int32)
    ahead = (key[None] < key[:, None]) | (
        (key[None] == key[:, None]) & (index[None] < index[:, None])[..., None]
    )
    place = ahead.sum(1, dtype=jnp.int32)
    here = place[None] == index[:, None, None]  # [place, entry, R]
    entry = jnp.where(here, index[None, :, None], 0).sum(1, dtype=jnp.int32)
    return entry, place
