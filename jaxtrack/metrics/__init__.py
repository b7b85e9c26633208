"""Scores of trackers against the truth, and of filters against their own covariance.

Those of one scan, and of sets of trajectories, are jitted and vmappable functions of
masked sets; `identity` and `hota` score whole tracks and run on the host.

    >>> from jaxtrack import metrics
    >>> low, high = metrics.consistency.chi2_bounds(dim=2, num_runs=100)
    >>> low < 2 < high
    True
"""

from jaxtrack.metrics import (
    assignment,
    averages,
    cardinality,
    chains,
    consistency,
    coupled,
    errors,
    gospa,
    hota,
    identity,
    ospa,
    ospa2,
    splitting,
    trajectories,
)

__all__ = [
    "assignment",
    "averages",
    "cardinality",
    "chains",
    "consistency",
    "coupled",
    "errors",
    "gospa",
    "hota",
    "identity",
    "ospa",
    "ospa2",
    "splitting",
    "trajectories",
]
