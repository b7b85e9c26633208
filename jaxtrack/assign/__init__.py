"""Which track caused which detection: one matrix of log-scores, many solvers.

Every solver takes `log_score` [N, K + 1]: N tracks, K detections, the last column the
miss. Scores are log-likelihood ratios against clutter, so a detection that no track
takes counts 1; -inf is impossible, such as what lies outside the gate. A joint event
gives every track one column and no detection to two tracks; its log-weight is the sum
of the chosen scores. An empty track slot is a row of -inf with a miss of 0, an invalid
detection a column of -inf. Each says whether its answer is feasible. For several scans
at once there is `multiscan`, which takes trees of hypotheses.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import assign
    >>> print(assign.best.best(jnp.array([[3.0, 0.0], [2.0, 1.0]])).column)
    [0 1]
"""

from jaxtrack.assign import (
    auction,
    belief,
    best,
    clusters,
    exact,
    k_best,
    k_best_of_many,
    lanes,
    marginals,
    multiscan,
    paths,
    sample,
    sample_of_many,
    soft,
    subsets,
)

__all__ = [
    "auction",
    "belief",
    "best",
    "clusters",
    "exact",
    "k_best",
    "k_best_of_many",
    "lanes",
    "marginals",
    "multiscan",
    "paths",
    "sample",
    "sample_of_many",
    "soft",
    "subsets",
]
