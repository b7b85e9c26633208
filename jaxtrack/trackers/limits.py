"""What a CBMeMBer filter bears: how much clutter beside a target, and how many misses.

Its update lets every detection in a target's gate make a track of its own, so clutter
there is counted as targets. Bias of the expected number after one scan, against Bayes'
rule by enumeration (one target of existence 0.95; 300 random scenes each, in brackets
two targets up to four standard deviations apart); the gate is that of three standard
deviations of the innovation:

            false detections expected in the gate
    P_D     0.1             0.3             1               3
    0.5     0.00 (0.00)     0.01 (0.01)     0.02 (0.03)     0.03 (0.04)
    0.7     0.01 (0.01)     0.02 (0.04)     0.06 (0.09)     0.10 (0.15)
    0.8     0.01 (0.02)     0.04 (0.05)     0.11 (0.13)     0.19 (0.29)
    0.9     0.04 (0.04)     0.07 (0.11)     0.21 (0.31)     0.45 (0.66)
    0.95    0.04 (0.07)     0.12 (0.18)     0.36 (0.52)     0.86 (1.09)
    0.99    0.09 (0.09)     0.21 (0.36)     0.68 (1.07)     1.68 (2.13)

With `balance="claims"` the bias is zero in all of them, and that of a PHD filter is at
most 0.1, but its error from scan to scan is 0.2 to 0.7. A low P_D does no harm to the
number. But a track that exists with probability r hands only (1 - r) / (1 - r P_D) of
that on to its detection: for r = 0.95 that is 0.84 at P_D = 0.99, 0.51 at 0.95, 0.21 at
0.8 and 0.10 at 0.5, and what stays behind is not corrected by it.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import limits
    >>> found = limits.false_in_gate(1e-4, 100.0 * jnp.eye(2))  # per m^2; m^2
    >>> print(f"{found:.3f}")
    0.283
    >>> print(limits.warning("cbmember", 0.95, found))
    None
    >>> limits.warning("cbmember", 0.7, 0.1)
    'cbmember takes P_D for near one, and it is 0.7 (limit 0.8); use balance="claims"'
"""

import math

import jax.numpy as jnp

from jaxtrack.types import Array

SIGMAS = 3.0  # of the innovation, the gate's half width
LEAST_DETECT_PROB = 0.8  # a fifth of a sure track's existence is handed on
MOST_FALSE = 0.3  # in a gate; an eighth of a target too many at P_D = 0.95


def false_in_gate(clutter_density: Array | float, innovation_cov: Array) -> Array:
    """Returns how many false detections to expect in a target's gate, a scalar.

    Args:
        clutter_density: False detections per scan and unit of measurement space.
        innovation_cov: Covariance of a target's detection around where it is expected,
            [Z, Z].
    """
    dim = innovation_cov.shape[0]
    ball = math.pi ** (dim / 2) / math.gamma(dim / 2 + 1) * SIGMAS**dim
    return clutter_density * ball * jnp.sqrt(jnp.linalg.det(innovation_cov))


def warning(
    tracker: str,
    detect_prob: float,
    false_detections: Array | float,
    remedy: str = 'use balance="claims"',
) -> str | None:
    """Says what is outside of what a CBMeMBer filter bears, or None.

    Args:
        tracker: What to call it.
        detect_prob: Where the sensor sees best.
        false_detections: Expected in a gate, see `false_in_gate`.
        remedy: What to do instead.
    """
    if float(false_detections) > MOST_FALSE:
        return (
            f"{tracker} counts clutter beside targets as targets, and "
            f"{float(false_detections):.2g} false detections are expected in a gate "
            f"(limit {MOST_FALSE}); {remedy}"
        )
    if detect_prob < LEAST_DETECT_PROB:
        return (
            f"{tracker} takes P_D for near one, and it is {detect_prob:.2g} (limit "
            f"{LEAST_DETECT_PROB}); {remedy}"
        )
    return None
