"""How well one run went, scan by scan.

>>> from jaxtrack.study import scores
>>> scores.Scores._fields[:3]
('ospa', 'ospa_localisation', 'ospa_cardinality')
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.metrics.gospa import gospa
from jaxtrack.metrics.ospa import ospa
from jaxtrack.scenarios.world import Truth
from jaxtrack.types import Array


class Scores(NamedTuple):
    """How well one run went, each [T].

    Attributes:
        ospa: Metres; ospa_localisation and ospa_cardinality are its parts.
        gospa: Metres; gospa_localisation, gospa_missed and gospa_false are its parts to
            the power of the order.
        num_true: Targets that exist.
        num_reported: Tracks that were reported.
        num_expected: Expected number of targets.
        num_std: Standard deviation of the number, as the tracker knows it.
        log_evidence: Log-density of the scan.
        dropped: Expected number of targets that capacities threw away.
    """

    ospa: Array
    ospa_localisation: Array
    ospa_cardinality: Array
    gospa: Array
    gospa_localisation: Array
    gospa_missed: Array
    gospa_false: Array
    num_true: Array
    num_reported: Array
    num_expected: Array
    num_std: Array
    log_evidence: Array
    dropped: Array


def score(
    truth: Truth, motion: Any, estimates: Any, cutoff: Array, order: Array
) -> Scores:
    """Scores the estimates of one run scan by scan.

    Args:
        truth: T scans of N targets.
        motion: A motion model, asked only where positions stand.
        estimates: Any tracker's `Estimate` with a leading T.
        cutoff: Of OSPA and GOSPA, metres.
        order: Of OSPA and GOSPA.

    Returns:
        Scores, each [T].
    """
    index = jnp.array(motion.position_index)

    def one(state: Array, there: Array, mean: Array, exists: Array) -> tuple[Any, Any]:
        sets = state[:, index], there, mean[:, index], exists
        return ospa(*sets, cutoff, order), gospa(*sets, cutoff, order)

    near, general = jax.vmap(one)(
        truth.state, truth.exists, estimates.mean, estimates.exists
    )
    return Scores(
        *near,
        *general[:4],
        num_true=truth.exists.sum(1),
        num_reported=estimates.exists.sum(1),
        num_expected=estimates.num_mean,
        num_std=jnp.sqrt(jnp.maximum(estimates.num_var, 0.0)),
        log_evidence=estimates.log_evidence,
        dropped=estimates.dropped,
    )
