"""Probabilistic data association: each track takes a share of every detection near it.

Tracks share out the detections apart from each other: right for targets far apart,
while `jpda` knows that a detection has one cause. With `ipda` a track is weighed by the
probability that it exists, which also confirms and drops it.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import pda
    >>> scores = jnp.log(jnp.array([[3.0, 6.0, 1.0]]))
    >>> print(jnp.exp(pda.associate(scores).log_prob))
    [[0.3 0.6 0.1]]

References: Bar-Shalom and Tse, "Tracking in a cluttered environment with probabilistic
data association", Automatica 11, 1975; Musicki, Evans and Stankovic, "Integrated
probabilistic data association", IEEE Trans. Automatic Control 39(6), 1994.
"""

import functools
from typing import Unpack

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.trackers import association, options
from jaxtrack.trackers.association import Association
from jaxtrack.types import Array, Target, Tracker


@functools.cache
def pda(target: Target, **choices: Unpack[options.Options]) -> Tracker:
    """Makes a PDA tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        **choices: See `options.make`.
    """
    return options.make(target, associate, **choices)


@functools.cache
def ipda(target: Target, **choices: Unpack[options.Options]) -> Tracker:
    """Makes an integrated PDA tracker: PDA with existence probabilities.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        **choices: See `options.make`.
    """
    return options.make(target, associate, weighs=True, **choices)


def associate(log_score: Array) -> Association:
    """Normalises each row of the log-scores [N, K + 1] on its own."""
    log_prob = jax.vmap(mixture.log_normalise)(log_score)
    log_norm = jax.vmap(mixture.total)(log_score).sum()
    exact = jnp.ones(len(log_score), bool)
    return association.soft(log_score, log_prob, log_norm, exact)
