"""The global nearest-neighbour tracker: the likeliest joint event, and no other.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import gnn
    >>> scores = jnp.array([[2.0, 1.0, 0.0], [3.0, 0.5, 0.0]])
    >>> print(gnn.associate(scores).log_prob.argmax(1))
    [1 0]

The log-evidence is that of the event chosen: a lower bound.

Reference: Blackman and Popoli, "Design and Analysis of Modern Tracking Systems", 1999,
section 6.4.
"""

import functools
from typing import Unpack

from jaxtrack import assign
from jaxtrack.trackers import association, options
from jaxtrack.trackers.association import Association
from jaxtrack.types import Array, Target, Tracker


@functools.cache
def gnn(target: Target, **choices: Unpack[options.Options]) -> Tracker:
    """Makes a global nearest-neighbour tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        **choices: See `options.make`.
    """
    return options.make(target, associate, **choices)


def associate(log_score: Array) -> Association:
    """Finds the joint event with the largest sum of log-scores [N, K + 1]."""
    chosen = assign.best.best(log_score)
    return association.hard(log_score, chosen.column, chosen.log_score)
