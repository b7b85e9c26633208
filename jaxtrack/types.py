"""The nouns of the library. Every filter and every tracker speaks in these tuples.

Axis letters, used in all docstrings: D state, P position (1 to 3 axes), Z measurement,
N slots (mixture components, tracks), M motion modes, K detections in a scan, T scans,
R Monte Carlo runs. A leading axis always means "many of": a `Gaussian` whose mean is
[N, D] is N Gaussians.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.types import Gaussian
    >>> Gaussian(mean=jnp.zeros(2), cov=jnp.eye(2)).cov.shape
    (2, 2)
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax

Array = jax.Array
PyTree = Any


class Gaussian(NamedTuple):
    """A normal belief: mean [D] and covariance [D, D]."""

    mean: Array
    cov: Array


class Mixture(NamedTuple):
    """N weighted Gaussians: log_weight [N], mean [N, D], cov [N, D, D].

    A log-weight of -inf marks an empty slot, which must still hold finite moments.
    """

    log_weight: Array
    mean: Array
    cov: Array


class Affine(NamedTuple):
    """The map x -> matrix @ x + offset + noise, with noise ~ N(0, cov)."""

    matrix: Array
    offset: Array
    cov: Array


class Scan(NamedTuple):
    """One sensor scan, padded to K slots.

    Attributes:
        detections: What the sensor reported, [K, Z].
        valid: Which slots hold a detection, [K] (bool).
        interval: Seconds since the previous scan (a scalar), so that irregular data
            is ordinary.
    """

    detections: Array
    valid: Array
    interval: Array


class Scans(NamedTuple):
    """What S sensors reported at one time.

    Attributes:
        each: A `Scan` for each sensor; the interval of the first one counts.
        looked: Which sensors looked at all, [S] (bool). Nothing is missed by a sensor
            that did not, and its detections are ignored.
    """

    each: tuple[Scan, ...]
    looked: Array


class Target(NamedTuple):
    """The belief about one target, as a tracker sees it: seventeen functions.

    A tracker knows nothing of how one target is filtered; a target knows nothing of
    how many there are. Survival and detection may depend on mode and state, so their
    probabilities come from here. `params` is the target's own `Params`.

    Attributes:
        begin: (params, prior: Gaussian, mode_prob[M], key) -> belief. A newborn.
        predict: (params, belief, interval) -> (belief, log_prob). It survived.
        miss: (params, belief) -> (belief, log_prob). It is there and was not detected.
        look: (params, belief) -> view. The belief as the sensor sees it: all that
            scoring and correcting need and no detection changes, worked out once.
        score: (params, view, detections[K, Z]) -> log_prob[K]. It was detected, here;
            the probability of detection is inside.
        distance: (params, view, detections[K, Z]) -> (square[K], log_det[K]). How far
            from the expected detection, in squared Mahalanobis distance, and the
            log-determinant of the innovation covariance that this is measured by.
        correct: (params, view, detection[Z]) -> belief. Given such a detection.
        collapse: (log_weight[N], beliefs[N, ...]) -> belief. One for a weighted many;
            the weights need not be normalised, -inf marks an empty slot, and if all
            are empty the first belief comes back.
        absorb: (params, log_weight[N], views[N, ...], detection[Z]) -> belief. One for
            a weighted many that claim the detection: each corrected, then all
            collapsed.
        blend: (params, view, missed, log_weight[K + 1], detections[K, Z]) -> belief.
            One whose detection is uncertain: k with weight k, or none with the last
            weight, where it is `missed` (what `miss` gave). If all weights are empty
            it was missed.
        adapt: (params, belief, existence_prob) -> belief. Called once a scan on the
            belief that came of it: what may change once all of the scan is known, such
            as the set of active modes, or the number of particles that a track of such
            probability to exist is worth.
        moments: (belief) -> Gaussian. Mean and covariance over all modes.
        parts: (belief) -> Mixture [S]. What it is made of: Gaussians, or particles
            with no covariance.
        modes: (belief) -> mode_prob[M]. One if there is a single mode.
        lost: (belief) -> scalar. Share of the belief's mass that its capacities threw
            away when it was last predicted or collapsed; 0 where nothing can be lost.
        effective_size: (belief) -> scalar. How many equally weighted particles the
            belief is worth; 0 where it is no sample.
        smooth: (params, belief, later, interval) -> belief. What `later`, known of it
            one interval afterwards by more data, tells about it now; None where that
            cannot be said.
    """

    begin: Callable[..., PyTree]
    predict: Callable[..., tuple[PyTree, Array]]
    miss: Callable[..., tuple[PyTree, Array]]
    look: Callable[..., PyTree]
    score: Callable[..., Array]
    distance: Callable[..., tuple[Array, Array]]
    correct: Callable[..., PyTree]
    collapse: Callable[..., PyTree]
    absorb: Callable[..., PyTree]
    blend: Callable[..., PyTree]
    adapt: Callable[..., PyTree]
    moments: Callable[[PyTree], Gaussian]
    parts: Callable[[PyTree], Mixture]
    modes: Callable[[PyTree], Array]
    lost: Callable[[PyTree], Array]
    effective_size: Callable[[PyTree], Array]
    smooth: Callable[..., PyTree] | None = None


class Tracker(NamedTuple):
    """A pair of pure functions; everything the library can run is one of these.

    Sizes are fixed when the tracker is made, values travel in `params`, so `step` can
    be jitted, scanned over time, vmapped over runs and differentiated in `params`.

    Attributes:
        init: (params, key) -> state.
        step: (params, state, scan) -> (state, estimate); the scan is a `Scan`, or the
            `Scans` of several sensors.
    """

    init: Callable[[PyTree, Array], PyTree]
    step: Callable[[PyTree, PyTree, Any], tuple[PyTree, PyTree]]
