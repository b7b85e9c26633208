"""The nearest-neighbour tracker: each track takes the detection that fits it best.

Tracks choose apart from each other, so two may take one detection; `gnn` sees to it
that they do not. A track is missed where that is likelier than its best detection.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import nearest
    >>> scores = jnp.array([[2.0, 1.0, 0.0], [3.0, 2.5, 0.0], [-9.0, -5.0, -1.0]])
    >>> print(nearest.associate(scores).log_prob.argmax(1))
    [0 0 2]

Reference: Bar-Shalom and Fortmann, "Tracking and Data Association", 1988, section 6.2
(by likelihood ratio, not by distance alone: a wide covariance is no advantage).
"""

import functools
from typing import Unpack

import jax.numpy as jnp

from jaxtrack.trackers import association, options
from jaxtrack.trackers.association import Association
from jaxtrack.types import Array, Target, Tracker


@functools.cache
def nearest(target: Target, **choices: Unpack[options.Options]) -> Tracker:
    """Makes a nearest-neighbour tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        **choices: See `options.make`.
    """
    return options.make(target, associate, **choices)


def associate(log_score: Array) -> Association:
    """Gives each track its best column of the log-scores [N, K + 1]."""
    column = jnp.argmax(log_score, axis=1)
    return association.hard(log_score, column, log_score.max(1).sum())
