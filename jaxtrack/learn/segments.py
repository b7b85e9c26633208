"""Running a tracker over many scans when its slopes are wanted: memory for time.

A gradient needs what every scan did on the way back. With `segment` only the state
between segments is kept, and each segment is run once more when its turn comes; so
10,000 scans in segments of 100 need the memory of 100 scans and 100 states. Segments of
1 are the fastest where a scan is much work: less is fetched from memory.

    >>> import functools, jax, jax.numpy as jnp
    >>> from jaxtrack.learn import segments
    >>> from jaxtrack.types import Tracker
    >>> total = Tracker(lambda params, key: jnp.zeros(()),
    ...     lambda params, state, scan: (state + params * scan, state))
    >>> run = functools.partial(segments.run, total, segment=4)
    >>> print(run(2.0, jnp.arange(6.0), jax.random.key(0)))
    [ 0.  0.  2.  6. 12. 20.]

Reference: Griewank and Walther, "Algorithm 799: revolve", ACM Trans. Mathematical
Software 26(1), 2000, of which this is one level.
"""

import functools

import jax
import jax.numpy as jnp

from jaxtrack.types import Array, PyTree, Tracker


def run(
    tracker: Tracker,
    params: PyTree,
    scans: PyTree,
    key: Array,
    segment: int | None = None,
) -> PyTree:
    """Runs a tracker over T scans, as `engine.run` does.

    Args:
        tracker: Static under `jit`.
        params: Its `Params`.
        scans: With a leading T.
        key: Random key.
        segment: Scans of a segment; by default all is kept. What is left over makes
            one more program, so let it divide T.

    Returns:
        The tracker's `Estimate` with a leading T.
    """
    step = functools.partial(tracker.step, params)
    state = tracker.init(params, key)
    total = len(jax.tree.leaves(scans)[0])
    if segment is None or segment >= total:
        return jax.lax.scan(step, state, scans)[1]
    count = total // segment

    @jax.checkpoint
    def several(state: PyTree, part: PyTree) -> tuple[PyTree, PyTree]:
        return jax.lax.scan(step, state, part)

    head = jax.tree.map(
        lambda x: x[: count * segment].reshape(count, segment, *x.shape[1:]), scans
    )
    state, told = jax.lax.scan(several, state, head)
    told = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), told)
    if count * segment == total:
        return told
    tail = jax.tree.map(lambda x: x[count * segment :], scans)
    rest = several(state, tail)[1]
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y]), told, rest)
