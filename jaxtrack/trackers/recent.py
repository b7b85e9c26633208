"""The last plain scans, in a window of fixed size.

>>> import jax.numpy as jnp
>>> from jaxtrack.trackers import recent
>>> from jaxtrack.types import Scan
>>> before = recent.begin(num_scans=1, max_detections=2, like=jnp.zeros(3))
>>> scan = Scan(jnp.ones((4, 3)), jnp.array([True, False, True, True]), jnp.array(1.0))
>>> window, lost = recent.push(before, scan)
>>> print(window.scans.valid.sum(1), window.looked, lost)
[0 2] [False  True] 1
>>> print(recent.pop(window).looked)
[ True]
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.types import Array, Scan


class Recent(NamedTuple):
    """T scans.

    Attributes:
        scans: Of K slots each, the oldest first; zeros where nothing was detected.
        looked: Whether there was such a scan, [T] (bool); those before the first are
            empty and take no time.
    """

    scans: Scan
    looked: Array


def begin(num_scans: int, max_detections: int, like: Array) -> Recent:
    """Makes the scans before the first one, in which nobody looked.

    Args:
        num_scans: How many.
        max_detections: Room in a scan, K.
        like: Any detection [Z] of the wanted kind.
    """
    shape = num_scans, max_detections
    scans = Scan(
        detections=jnp.zeros((*shape, like.size), like.dtype),
        valid=jnp.zeros(shape, bool),
        interval=jnp.zeros(num_scans, like.dtype),
    )
    return Recent(scans, jnp.zeros(num_scans, bool))


def push(window: Recent, scan: Scan) -> tuple[Recent, Array]:
    """Adds a scan; returns how many of its detections found no room, too.

    Args:
        window: T - 1 scans.
        scan: Any number of detections.
    """
    like, room = window.scans, window.scans.valid.shape[1]
    first = jnp.argsort(~scan.valid, stable=True)[:room]
    short = room - len(first)
    valid = jnp.pad(scan.valid[first], (0, short))
    detections = jnp.pad(scan.detections[first], ((0, short), (0, 0)))
    detections = jnp.where(valid[:, None], detections, 0.0)
    interval = jnp.asarray(scan.interval, like.interval.dtype)
    new = Scan(detections.astype(like.detections.dtype), valid, interval)
    longer = jax.tree.map(
        lambda x, y: jnp.concatenate([x, y[None]]), window, Recent(new, jnp.array(True))
    )
    return longer, scan.valid.sum() - valid.sum()


def pop(window: Recent) -> Recent:
    """Lets the oldest scan go."""
    return jax.tree.map(lambda x: x[1:], window)
