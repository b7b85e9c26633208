"""Probability of each association, and the weight of all joint events together.

`exact` sums over all joint events, cluster by cluster of tracks that share detections;
`belief` is loopy belief propagation, for any size. Here one call chooses, and says what
it used for each track.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import marginals
    >>> log_score = jnp.log(jnp.array([[4.0, 1.0, 1.0], [0.0, 2.0, 1.0]]))
    >>> found = marginals.marginals(log_score)
    >>> print(jnp.round(found.prob, 3), found.exact)
    [[0.75  0.062 0.188]
     [0.    0.625 0.375]] [ True  True]
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.assign.belief import belief
from jaxtrack.assign.best import solvable
from jaxtrack.assign.exact import MAX_CLUSTER, exact
from jaxtrack.types import Array

METHODS = "auto", "exact", "belief"


class Marginals(NamedTuple):
    """Association probabilities.

    Attributes:
        prob: Probability of each column for each track, [N, K + 1]; all zero if not
            `feasible`, and in rows that are not solved.
        log_norm: Log of the summed weight of all joint events; exact where all tracks
            are, with Bethe's approximation for the others.
        feasible: Whether a joint event of positive weight exists and all tracks are
            solved (bool): under "exact" none may be in too large a cluster.
        exact: Whether the track's probabilities are exact, [N] (bool).
        converged: Whether belief propagation settled; true where it had nothing to do.
        num_iterations: Its rounds; 0 if it was not called.
    """

    prob: Array
    log_norm: Array
    feasible: Array
    exact: Array
    converged: Array
    num_iterations: Array


def marginals(
    log_score: Array,
    method: str = "auto",
    max_cluster: int = MAX_CLUSTER,
    max_iterations: int = 200,
) -> Marginals:
    """Finds the association probabilities of all tracks, and their log-normaliser.

    The probabilities are the derivatives of the log-normaliser by the scores; both can
    be differentiated further. By a score of -inf all derivatives are zero.

    Args:
        log_score: [N, K + 1], the miss last, -inf where impossible.
        method: "exact"; "belief"; or "auto", exact for each cluster of at most
            `max_cluster` tracks and belief propagation for the others.
        max_cluster: Tracks that are summed over together, at most; each one more
            doubles work and memory.
        max_iterations: Rounds of belief propagation at most.

    Raises:
        ValueError: There is no such method, or a number makes no sense.
    """
    if method not in METHODS:
        raise ValueError(f"method is {method!r}; give one of {', '.join(METHODS)}")
    table = exact(log_score, max_cluster) if method != "belief" else None
    solved = table.exact if table else jnp.zeros(log_score.shape[:1], bool)
    if table and (method == "exact" or log_score.shape[0] <= max_cluster):
        return Marginals(
            prob=table.prob,
            log_norm=table.log_norm,
            feasible=table.feasible & solved.all(),
            exact=solved,
            converged=jnp.array(True),
            num_iterations=jnp.array(0),
        )
    scores, found = solvable(log_score)
    feasible = found.feasible
    # What is solved already is left to be missed.
    missed = jnp.full(log_score.shape, -jnp.inf).at[:, -1].set(0.0)
    missed = missed.astype(log_score.dtype)
    passed = belief(jnp.where(solved[:, None], missed, scores), max_iterations)
    prob, log_norm = passed.prob, passed.log_norm
    if table:
        prob = jnp.where(solved[:, None], table.prob, prob)
        log_norm = log_norm + jnp.where(feasible, table.log_norm, 0.0)
    return Marginals(
        prob=jnp.where(feasible, prob, 0.0),
        log_norm=jnp.where(feasible, log_norm, -jnp.inf),
        feasible=feasible,
        exact=solved,
        converged=passed.converged,
        num_iterations=passed.num_iterations,
    )
