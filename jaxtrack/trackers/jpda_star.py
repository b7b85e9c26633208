"""JPDA*: JPDA that does not average over who is who.

Two targets side by side, each with a detection: JPDA gives either half of both, and the
tracks coalesce between them. JPDA* keeps, of all joint events with the same tracks
detected by the same detections, only the likeliest, so that what remains uncertain is
which detections are the targets', not which is whose. It goes by the likeliest events
alone; the estimate's `exact` says whether these were all.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import jpda_star
    >>> scores = jnp.log(jnp.array([[5.0, 4.0, 0.1], [4.0, 5.0, 0.1]]))
    >>> print(jnp.exp(jpda_star.associate(scores).log_prob[:, :2]).round(2))
    [[0.95 0.01]
     [0.01 0.95]]

Reference: Blom and Bloem, "Probabilistic data association avoiding track coalescence",
IEEE Trans. Automatic Control 45(2), 2000.
"""

import functools
from typing import Unpack

import jax.numpy as jnp

from jaxtrack import assign
from jaxtrack.trackers import jpda, options
from jaxtrack.trackers.association import Association
from jaxtrack.types import Array, Target, Tracker


@functools.cache
def jpda_star(
    target: Target, max_events: int = 100, **choices: Unpack[options.Options]
) -> Tracker:
    """Makes a JPDA* tracker.

    Args:
        target: How one target is filtered, e.g. `targets.imm.imm()`.
        max_events: Joint events considered, the likeliest.
        **choices: See `options.make`.

    Raises:
        ValueError: A setting that makes no sense.
    """
    jpda.check(max_events)
    chosen = functools.partial(associate, max_events=max_events)
    return options.make(target, chosen, **choices)


def associate(log_score: Array, max_events: int = 100) -> Association:
    """Finds marginals over the likeliest event of each set of tracks and detections.

    Args:
        log_score: [N, K + 1].
        max_events: Joint events considered before any goes.
    """
    events = assign.k_best.k_best(log_score, max_events)
    last = log_score.shape[1] - 1
    detected = events.column < last  # [E, N]
    used = (events.column[:, :, None] == jnp.arange(last)[None, None]).any(1)
    same = (detected[:, None] == detected[None]).all(-1)
    same = same & (used[:, None] == used[None]).all(-1)
    order = jnp.arange(max_events)
    beaten = (same & (order[None] < order[:, None])).any(1)
    log_weight = jnp.where(beaten, -jnp.inf, events.log_score)
    complete = events.log_score[-1] == -jnp.inf  # there was room for more
    return jpda.of_events(log_score, events.column, log_weight, complete)
