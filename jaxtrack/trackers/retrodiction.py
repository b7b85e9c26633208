"""Where targets were some scans ago, by all that is known now.

Every leaf of a track tree remembers what was believed of its target after each of the
last scans. What is reported of a scan waits `delay` scans: the best hypothesis by then
says which leaf it was, and a smoother carries what came later back. As hypotheses are
decided after `num_scans` scans, a delay of at least as many shows nothing that is taken
back: tracks do not hop from one hypothesis to another.

A target that has not been detected since may have died. If it existed with probability
r after a scan, and what followed had probability q, it was dead by then with
probability (1 - r) / q.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import retrodiction
    >>> exist, log_gain = jnp.array([0.5, 0.2]), jnp.log(jnp.array([1.0, 0.625]))
    >>> seen = jnp.array([False, False])  # it was missed twice
    >>> print(retrodiction.existed(exist, log_gain, seen).round(2))
    0.2

Reference: Drummond, "Target tracking with retrodicted discrete probabilities", Signal
and Data Processing of Small Targets, SPIE 3163, 1997.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.linalg import safe_log
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.remembering import History
from jaxtrack.types import Array, PyTree, Target


class Retrodiction(NamedTuple):
    """What is known of a scan that lies `delay` scans back.

    Attributes:
        mean: [N, D].
        cov: [N, D, D].
        mode_prob: [N, M].
        label: [N] (int).
        exists: The best hypothesis has it, and it was there, [N] (bool).
        existence_prob: That it was there, if the best hypothesis is true, [N].
    """

    mean: Array
    cov: Array
    mode_prob: Array
    label: Array
    exists: Array
    existence_prob: Array


def check(delay: int | None, num_scans: int, target: Target) -> None:
    """Raises a ValueError for a delay that makes no sense."""
    if delay is None:
        return
    if delay < max(num_scans, 1):
        raise ValueError(
            f"delay is {delay}; give at least {max(num_scans, 1)}, the scans after "
            "which hypotheses are decided, or None for no delayed output"
        )
    if target.smooth is None:
        raise ValueError(
            f"delay is {delay}, and this target cannot be smoothed; use targets.single "
            "or targets.imm, or delay=None"
        )


def awaited(history: History, best: Array, age: Array, threshold: float = 0.0) -> Array:
    """Tells whose detections in the last W scans were likely of a target, [N] (bool).

    They stay, dead or alive, until that scan is reported.

    Args:
        history: Of N trees.
        best: The leaf of the best hypothesis of each, -1 for none, [N].
        age: How many scans ago each began, that scan counted, [N] (int).
        threshold: How likely, by what is known now.
    """
    leaf = jnp.arange(best.size), jnp.maximum(best, 0)
    exists, gain, seen = jax.tree.map(lambda x: x[leaf], history[1:4])
    scan = jnp.arange(seen.shape[1])
    begun = scan[None] >= scan.size - age[:, None]
    each = jax.vmap(existed, (None, None, None, 0))
    there = jax.vmap(each, (0, 0, 0, None))(exists, gain, seen, scan)
    return (best >= 0) & (begun & seen & (there > threshold)).any(1)


def existed(
    existence_prob: Array, log_gain: Array, seen: Array, scan: Array | int = 0
) -> Array:
    """Returns how likely a target was there after one of W scans.

    Args:
        existence_prob: After each scan, by the scans until then, [W].
        log_gain: What each added to the score, [W].
        seen: In which it was detected, [W] (bool).
        scan: Which one.
    """
    later = jnp.arange(seen.size) > scan
    again = (seen & later).any()
    log_gain = jnp.where(again | ~later, 0.0, log_gain)
    # A miss that cannot be has a gain whose exponential is beyond float32.
    log_dead = safe_log(1 - existence_prob[scan]) - log_gain.sum()
    return jnp.where(again, 1.0, 1 - jnp.exp(jnp.minimum(log_dead, 0.0)))


def smooth(target: Target, params: Any, history: History, shown: Array) -> PyTree:
    """Returns what is known by now of W scans, [N, W, ...].

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        history: Of the last W scans.
        shown: A leaf of each tree, [N] (int).
    """
    tree = jnp.arange(len(shown))
    belief = jax.tree.map(lambda x: x[tree, shown], history.belief)
    assert target.smooth is not None, "check raises before"
    smooth_one = target.smooth

    def back(belief: PyTree) -> PyTree:
        def step(later: PyTree, scan: tuple) -> tuple[PyTree, PyTree]:
            before, interval = scan
            now = smooth_one(params, before, later, interval)
            return now, now

        earlier = jax.tree.map(lambda x: x[:-1], belief)
        last = jax.tree.map(lambda x: x[-1], belief)
        scans = earlier, history.interval[1:]
        every = jax.lax.scan(step, last, scans, reverse=True)[1]
        return jax.tree.map(lambda x, y: jnp.concatenate([x, y[None]]), every, last)

    return jax.vmap(back)(belief)


def retrodict(
    target: Target,
    params: Any,
    history: History,
    trees: Forest,
    leaf: tuple[Array, Array],
    threshold: float,
) -> Retrodiction:
    """Reports the first scan of the history.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        history: Of the last W scans.
        trees: The N trees now.
        leaf: That of the best hypothesis of each, -1 for none, and the one to show,
            both [N] (int).
        threshold: Existence probability above which a track is reported.
    """
    best, shown = leaf
    tree, delay = jnp.arange(len(shown)), len(history.interval) - 1
    rest = jax.tree.map(lambda x: x[tree, shown], history[1:4])
    smoothed = smooth(target, params, history, shown)
    smoothed = jax.tree.map(lambda x: x[:, 0], smoothed)
    moments = jax.vmap(target.moments)(smoothed)
    begun = (trees.age > delay) & (history.num > delay)
    prob = jnp.where(begun & (trees.label >= 0), jax.vmap(existed)(*rest), 0.0)
    return Retrodiction(
        mean=moments.mean,
        cov=moments.cov,
        mode_prob=jax.vmap(target.modes)(smoothed),
        label=trees.label,
        exists=(best >= 0) & (prob > threshold),
        existence_prob=prob,
    )


def align(estimates: Any, delay: int) -> Any:
    """Puts what is known of each scan `delay` scans later where the scan is.

    Args:
        estimates: Of T scans, with a `retrodicted`.
        delay: As the tracker had it.

    Returns:
        The estimates, with its fields; the last `delay` scans are as first reported,
        and what is about all targets together is left alone.

    Raises:
        ValueError: The estimates have no delayed output.
    """
    later: Retrodiction | None = estimates.retrodicted
    if later is None:
        raise ValueError("retrodicted is None; make the tracker with a delay")

    def shift(known: Array, first: Array) -> Array:
        return jnp.concatenate([known[delay:], first[max(len(known) - delay, 0) :]])

    fields = {
        name: shift(known, getattr(estimates, name))
        for name, known in later._asdict().items()
    }
    return estimates._replace(**fields)
