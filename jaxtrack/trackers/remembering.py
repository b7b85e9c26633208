"""What the leaves of track trees were believed to be after each of the last scans.

The smoother needs it, and so does what is said of scans that lie back: whether a
target was there, or ever was.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import remembering
    >>> remembering.History._fields[:4]
    ('belief', 'existence_prob', 'log_gain', 'seen')

Used by `retrodiction` and `trajectories`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.linalg import safe_log
from jaxtrack.trackers import birth_times
from jaxtrack.trackers.forest import Forest
from jaxtrack.types import Array, PyTree


class History(NamedTuple):
    """What the leaves of N trees were believed to be, after each of W scans.

    Attributes:
        belief: About each target; the newest last, [N, L, W, ...].
        existence_prob: [N, L, W].
        log_gain: What each scan added to the score, [N, L, W].
        seen: Whether the leaf has a detection of it, [N, L, W] (bool).
        interval: Seconds before each scan, [W].
        num: How many scans there have been.
        log_never: Log-probability that there never was a target, [N, L].
        birth_prob: How likely each target was born 0, 1, ..., A - 1 or more scans
            before its first detection, [N, A]; of known targets 0. None for no answer.
    """

    belief: PyTree
    existence_prob: Array
    log_gain: Array
    seen: Array
    interval: Array
    num: Array
    log_never: Array | None = None
    birth_prob: Array | None = None


def begin(trees: Forest, delay: int, num_birth_times: int = 0) -> History:
    """Returns a history of nothing but what the trees are before the first scan."""
    size = delay + 1
    exists = trees.existence_prob
    unborn = birth_times.newborn(len(exists), num_birth_times)

    def often(x: Array) -> Array:
        return jnp.broadcast_to(x[:, :, None], (*x.shape[:2], size, *x.shape[2:]))

    return History(
        belief=jax.tree.map(often, trees.belief),
        existence_prob=often(exists),
        log_gain=jnp.zeros((*exists.shape, size), exists.dtype),
        seen=jnp.zeros((*exists.shape, size), bool),
        interval=jnp.zeros(size, exists.dtype),
        num=jnp.array(0),
        log_never=safe_log(1 - exists),
        birth_prob=None if unborn is None else 0 * unborn,
    )


def remember(
    history: History,
    before: Array,
    trees: Forest,
    parent: Array,
    interval: Array,
    births: Array | None = None,
) -> History:
    """Adds a scan.

    Args:
        history: Of N trees with L leaves.
        before: Their scores before the scan, [N, L].
        trees: The N trees after it, followed by K that it began.
        parent: The old leaf of each leaf of the N trees, [N, L] (int).
        interval: Seconds before the scan.
        births: As `History.birth_prob`, of what it detects for the first time, [K, A].

    Returns:
        The history of N + K trees.
    """
    num = len(parent)
    new = len(trees.label) - num
    tree = jnp.arange(num)[:, None]

    def add(past: Array, now: Array) -> Array:
        here = past[tree, parent]
        first = jnp.broadcast_to(now[num:, :, None], (new, *here.shape[1:]))
        both = jnp.concatenate([here, first.astype(here.dtype)])
        last = now[:, :, None].astype(here.dtype)
        return jnp.concatenate([both[:, :, 1:], last], 2)

    score = trees.log_score
    old = jnp.concatenate([before[tree, parent], jnp.zeros_like(score[num:])])
    there = (score > -jnp.inf) & (old > -jnp.inf)
    gain = jnp.where(there, score, 0.0) - jnp.where(there, old, 0.0)
    seen = trees.past[:, :, -1] >= 0
    # Who is seen again was there; what is new exists now or never did.
    assert history.log_never is not None, "begin gives it"
    never = jnp.minimum(history.log_never[tree, parent] - gain[:num], 0.0)
    never = jnp.where(seen[:num], -jnp.inf, never)
    first = safe_log(1 - trees.existence_prob[num:])
    return History(
        belief=jax.tree.map(add, history.belief, trees.belief),
        existence_prob=add(history.existence_prob, trees.existence_prob),
        log_gain=add(history.log_gain, gain),
        seen=add(history.seen, seen),
        interval=jnp.append(history.interval[1:], interval),
        num=history.num + 1,
        log_never=jnp.concatenate([never, first]).astype(gain.dtype),
        birth_prob=birth_times.added(
            history.birth_prob, births, trees.past[num:, 0, -1]
        ),
    )


def keep(history: History, kept: Array) -> History:
    """Returns the history of some trees, [N'] (int)."""
    whole = history._replace(interval=None, num=None)
    some = jax.tree.map(lambda x: x[kept], whole)
    return some._replace(interval=history.interval, num=history.num)
