"""What RMM-MHT tells the user.

>>> from jaxtrack.trackers import rmm_estimate
>>> rmm_estimate.Estimate._fields[:4]
('mean', 'cov', 'label', 'exists')

Reference: Liu, Shen, Wang and Meng, "Randomized multimodel multiple hypothesis
tracking", 2021, supplement, Algorithm D1, line 4.
"""

from typing import NamedTuple

import jax.numpy as jnp

from jaxtrack.trackers import rmm_stack
from jaxtrack.trackers.rmm_stack import Stack
from jaxtrack.trackers.rmm_tracks import Course, Tracks
from jaxtrack.types import Array


class Estimate(NamedTuple):
    """What a scan taught, for the user.

    Attributes:
        mean: After that scan, [N, D].
        cov: [N, D, D].
        label: Which target it is, -1 for an empty slot, [N] (int).
        exists: [N] (bool).
        existence_prob: [N].
        mode_prob: Of the model that moved it to this scan, [N, M].
        effective_size: 0: beliefs are no samples, [N].
        num_mean: Expected number of targets, undetected ones included.
        num_var: Variance of that number.
        log_evidence: Log-density of the scan and its association given the past.
        dropped: Expected number of targets that found no room; a detection that found
            none counts as one.
        integral: Whether the programme put every track on one leaf (bool).
    """

    mean: Array
    cov: Array
    label: Array
    exists: Array
    existence_prob: Array
    mode_prob: Array
    effective_size: Array
    num_mean: Array
    num_var: Array
    log_evidence: Array
    dropped: Array
    integral: Array


def report(
    stack: Stack,
    tracks: Tracks,
    course: Course,
    hidden: Array,
    threshold: float,
    log_evidence: Array,
    dropped: Array,
    integral: Array,
) -> Estimate:
    """Reports the tracks that exist with more than a threshold.

    Args:
        stack: N targets, after the last scan of the window.
        tracks: Those, after the first.
        course: What the window says of them.
        hidden: Expected number of undetected targets.
        threshold: Of the probability to exist.
        log_evidence: Log-density of the scan and its association.
        dropped: Expected number of targets that found no room.
        integral: Whether every track has one leaf.
    """
    now, prob = rmm_stack.each(stack), course.now
    return Estimate(
        mean=now.mean,
        cov=now.cov,
        label=tracks.label,
        exists=(tracks.label >= 0) & (prob > threshold),
        existence_prob=prob,
        mode_prob=course.models[:, -1],
        effective_size=jnp.zeros_like(prob),
        num_mean=prob.sum() + hidden,
        num_var=(prob * (1 - prob)).sum() + hidden,
        log_evidence=log_evidence,
        dropped=dropped,
        integral=integral,
    )
