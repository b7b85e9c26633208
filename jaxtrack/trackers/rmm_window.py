"""The last scans, in a window of fixed size.

>>> import jax.numpy as jnp
>>> from jaxtrack.trackers import rmm_window
>>> from jaxtrack.trackers.rmm_leaves import Look
>>> from jaxtrack.types import Scan
>>> look = Look(None, None, None)  # of sensor, detection and clutter
>>> window = rmm_window.begin(1, 2, jnp.zeros(3), look)  # one scan, two detections
>>> scan = Scan(jnp.ones((4, 3)), jnp.array([True, False, True, True]), jnp.array(1.0))
>>> window, lost = rmm_window.push(window, scan, look)
>>> print(window.valid.sum(1), window.looked, lost)
[0 2] [False  True] 1
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack.trackers.association import LEAST_LOG_WEIGHT
from jaxtrack.trackers.rmm_leaves import Look, Window
from jaxtrack.types import Array, Scan


def begin(num_scans: int, max_detections: int, like: Array, look: Look) -> Window:
    """Makes the scans before the first one, in which no sensor looked.

    Args:
        num_scans: How many.
        max_detections: Room in a scan, K.
        like: Any detection [Z] of the wanted kind.
        look: Of the same kind as of the scans to come.
    """
    shape = num_scans, max_detections

    def repeated(x: Array) -> Array:
        return jnp.repeat(jnp.array(x)[None], num_scans, axis=0)

    return Window(
        detections=jnp.zeros((*shape, like.size), like.dtype),
        valid=jnp.zeros(shape, bool),
        interval=jnp.zeros(num_scans, like.dtype),
        looked=jnp.zeros(num_scans, bool),
        through=jax.tree.map(repeated, look),
    )


def push(window: Window, scan: Scan, look: Look) -> tuple[Window, Array]:
    """Adds a scan; returns how many of its detections found no room, too.

    Args:
        window: S - 1 scans.
        scan: Any number of detections.
        look: Through what it was seen.
    """
    room = window.valid.shape[1]
    first = jnp.argsort(~scan.valid, stable=True)[:room]
    short = room - len(first)
    valid = jnp.pad(scan.valid[first], (0, short))
    detections = jnp.pad(scan.detections[first], ((0, short), (0, 0)))
    detections = jnp.where(valid[:, None], detections, 0.0)
    new = Window(
        detections.astype(window.detections.dtype),
        valid,
        jnp.asarray(scan.interval, window.interval.dtype),
        jnp.array(True),
        jax.tree.map(lambda x: jnp.array(x), look),
    )
    longer = jax.tree.map(lambda x, y: jnp.concatenate([x, y[None]]), window, new)
    return longer, scan.valid.sum() - valid.sum()


def log_clutter(clutter: Any, scan: Scan) -> Array:
    """Returns the log-density of a scan of nothing but false detections.

    Args:
        clutter: Of `models.clutter`.
        scan: K detections.
    """
    each = jax.vmap(clutter.log_density)(scan.detections)
    each = jnp.maximum(each, LEAST_LOG_WEIGHT)
    return jnp.where(scan.valid, each, 0.0).sum() - clutter.rate
