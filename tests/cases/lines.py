"""CBMeMBer runs on scans given as lists of detections on a line."""

import jax
import numpy as np

from jaxtrack import engine
from jaxtrack.types import Scan

KEY = np.array(jax.random.key_data(jax.random.key(0)))


def compiled(tracker, batch=False):
    """(params, scans) -> estimates, as NumPy."""

    def run(params, scans):
        return engine.run(tracker, params, scans, jax.random.wrap_key_data(KEY))

    run = jax.jit(jax.vmap(run) if batch else run)
    return lambda *args: jax.tree.map(np.array, run(*args))


def scans_of(rows, slots, intervals):
    """Pads lists of detections, one list a scan."""
    detections = np.zeros((len(rows), slots, 1))
    valid = np.zeros((len(rows), slots), bool)
    for t, row in enumerate(rows):
        detections[t, : len(row), 0] = row
        valid[t, : len(row)] = True
    return Scan(detections, valid, np.broadcast_to(intervals, len(rows)) * 1.0)
