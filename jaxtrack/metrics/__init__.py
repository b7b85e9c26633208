"""Scores of trackers against the truth, and of filters against their own covariance.

Those of one scan, and of sets of trajectories, are jitted and vmappable functions of
masked sets; `identity` scores whole tracks and runs on the host.

    >>> from jaxtrack import metrics
    >>> low, high = metrics.consistency.chi2_bounds(dim=2, num_runs=100)
    >>> low < 2 < high
    True
"""

from jaxtrack.metrics import (
    assignment,
    cardinality,
    chains,
    consistency,
    coupled,
    errors,
    gospa,
    identity,
    ospa,
    splitting,
    trajectories,
)

__all__ = [
    "assignment",
    "cardinality",
    "chains",
    "consistency",
    "coupled",
    "errors",
    "gospa",
    "identity",
    "ospa",
    "splitting",
    "trajectories",
]
