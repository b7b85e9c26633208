"""Joint probabilistic data association: shares of detections that have one cause each.

The weight of a joint event is the product of its log-scores; a track's share of a
detection is the weight of all joint events in which it has it. `jpda(target=imm())` is
IMM-JPDA, `jpda(target=likely_modes())` LMS-JPDA. In `jipda` a track is weighed by the
probability that it exists, which also confirms and drops it.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import jpda
    >>> scores = jnp.log(jnp.array([[2.0, 1.0], [2.0, 1.0]]))  # two tracks, a detection
    >>> print(jnp.exp(jpda.associate(scores).log_prob))
    [[0.4 0.6]
     [0.4 0.6]]

References: Fortmann, Bar-Shalom and Scheffe, "Sonar tracking of multiple targets using
joint probabilistic data association", IEEE J. Oceanic Engineering 8(3), 1983; Musicki
and Evans, "Joint integrated probabilistic data association: JIPDA", IEEE Trans.
Aerospace and Electronic Systems 40(3), 2004; Gomes, "An overview on target tracking
using multiple models methods", 2011, Tables 4 and 5.
"""

import functools
from collections.abc import Callable
from typing import Unpack

import jax.numpy as jnp

from jaxtrack import assign, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import association, options
from jaxtrack.trackers.association import Association
from jaxtrack.types import Array, Target, Tracker

METHODS = "auto", "belief"


@functools.cache
def jpda(
    target: Target,
    method: str = "auto",
    max_cluster: int = assign.exact.MAX_CLUSTER,
    max_events: int | None = None,
    **choices: Unpack[options.Options],
) -> Tracker:
    """Makes a JPDA tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        method: Of `assign.marginals`: "auto" sums over all joint events of each cluster
            of tracks up to a size and is belief propagation beyond, as the estimate's
            `exact` says; "belief" is belief propagation for all.
        max_cluster: Tracks that are summed over together, at most.
        max_events: Instead, take as many of the likeliest joint events, and no other.
        **choices: See `options.make`.
    """
    return options.make(target, rule(method, max_cluster, max_events), **choices)


@functools.cache
def jipda(
    target: Target,
    method: str = "auto",
    max_cluster: int = assign.exact.MAX_CLUSTER,
    max_events: int | None = None,
    **choices: Unpack[options.Options],
) -> Tracker:
    """Makes a joint integrated PDA tracker: JPDA with existence probabilities.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        method: See `jpda`.
        max_cluster: See `jpda`.
        max_events: See `jpda`.
        **choices: See `options.make`.
    """
    associate = rule(method, max_cluster, max_events)
    return options.make(target, associate, weighs=True, **choices)


def check(max_events: int) -> None:
    """Raises a ValueError for a number of events that makes no sense."""
    if max_events < 1:
        raise ValueError(f"max_events is {max_events}; give at least 1")


def rule(
    method: str, max_cluster: int, max_events: int | None
) -> Callable[[Array], Association]:
    """Makes a function from scores [N, K + 1] to an association; see `jpda`.

    Raises:
        ValueError: A setting that makes no sense.
    """
    if method not in METHODS:
        raise ValueError(f"method is {method!r}; give one of {', '.join(METHODS)}")
    if max_cluster < 1:
        raise ValueError(f"max_cluster is {max_cluster}; give at least 1")
    if max_events is None:
        return functools.partial(associate, method=method, max_cluster=max_cluster)
    check(max_events)
    return functools.partial(by_events, max_events=max_events)


def associate(
    log_score: Array,
    method: str = "auto",
    max_cluster: int = assign.exact.MAX_CLUSTER,
) -> Association:
    """Finds the marginal probabilities of all joint events of the scores [N, K + 1]."""
    found = assign.marginals.marginals(log_score, method, max_cluster)
    return association.soft(
        log_score, safe_log(found.prob), found.log_norm, found.exact
    )


def by_events(log_score: Array, max_events: int) -> Association:
    """Finds the marginal probabilities over the likeliest joint events alone."""
    events = assign.k_best.k_best(log_score, max_events)
    complete = events.log_score[-1] == -jnp.inf  # there was room for more
    return of_events(log_score, events.column, events.log_score, complete)


def of_events(
    log_score: Array, column: Array, log_weight: Array, complete: Array
) -> Association:
    """Makes the association of some joint events.

    Args:
        log_score: [N, K + 1].
        column: Which column each track has, [E, N].
        log_weight: Of each event; -inf for none, [E].
        complete: Whether no event was left out (bool).

    Returns:
        The association by these events alone; `log_ratio` of a track that none of them
        misses is too large, by what other events say for its miss.
    """
    num_columns = log_score.shape[1]
    log_prob = mixture.log_normalise(log_weight)
    taken = column[:, :, None] == jnp.arange(num_columns)[None, None]
    prob = jnp.where(taken, jnp.exp(log_prob)[:, None, None], 0.0).sum(0)
    exact = jnp.broadcast_to(complete, len(log_score))
    answer = association.soft(
        log_score, safe_log(prob), mixture.total(log_weight), exact
    )
    # A miss that is in no event is still possible: in the heaviest, without the
    # track's detection, at least.
    none = log_score[:, -1]
    left_out = (prob[:, -1] == 0) & (none > -jnp.inf)
    held = jnp.take_along_axis(log_score.T, column, axis=0)  # [E, N]
    counts = (log_prob > -jnp.inf)[:, None] & left_out[None]
    without = jnp.where(counts, log_prob[:, None] - held, -jnp.inf).max(0)
    bound = -jnp.where(left_out, without, 0.0)
    return answer._replace(
        log_ratio=jnp.where(left_out, bound, answer.log_ratio),
        events=association.Events(column, log_prob),
    )
