"""How targets share out the detections of a scan if each has its cause independently.

The measurement model of probabilistic MHT: target n causes a Poisson number of
detections, lambda_n of them expected, and clutter the others. So a target may have
several detections of a scan, and what all of them together tell it is one: their
weighted mean, with a covariance divided by their weight.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import pmht_claims
    >>> from jaxtrack.models.clutter import UniformClutter
    >>> from jaxtrack.types import Scan
    >>> clutter = UniformClutter(4.0, -5.0 * jnp.ones(1), 5.0 * jnp.ones(1))
    >>> scan = Scan(jnp.array([[-1.0], [1.0]]), jnp.ones(2, bool), 1.0)
    >>> claims = pmht_claims.share_out(
    ...     lambda z, expected: z - expected, jnp.eye(1), None, clutter,
    ...     expected=jnp.zeros((1, 1)), blur=jnp.zeros((1, 1, 1)), rate=jnp.ones(1),
    ...     scan=scan)
    >>> print(claims.prob.round(3), claims.weight.round(3))
    [[0.377 0.623]
     [0.377 0.623]] [0.754]

References: Streit and Luginbuhl, "Probabilistic multi-hypothesis tracking", NUWC-NPT
Technical Report 10428, 1995; Willett, Ruan and Streit, "PMHT: problems and some
solutions", IEEE Trans. Aerospace and Electronic Systems 38(3), 2002 (homothetic
measurement models).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg, mixture
from jaxtrack.constraints import Positive, Simplex
from jaxtrack.entries import dense
from jaxtrack.linalg import safe_log
from jaxtrack.trackers.association import LEAST_LOG_WEIGHT
from jaxtrack.types import Affine, Array, Scan

# A synthetic detection of less weight would have a covariance beyond float32.
LEAST_WEIGHT = 1e-12


class Spread(NamedTuple):
    """A detection's noise as a mixture of S covariances, all multiples of R.

    Attributes:
        scale: The multiples, [S].
        share: Of each in the mixture, summing to one, [S].
    """

    scale: Positive
    share: Simplex


class Claims(NamedTuple):
    """How a scan is shared out.

    Attributes:
        prob: That each detection was caused by each target or, last, is clutter,
            [K, N + 1]; 0 where there is none.
        surprise: Weighted mean of the residuals of each target's detections, [N, Z].
        weight: Of that mean, [N]; its covariance is R divided by it.
        log_density: Of the scan, given the targets.
    """

    prob: Array
    surprise: Array
    weight: Array
    log_density: Array


def share_out(
    residual: Callable[[Array, Array], Array],
    noise: Any,
    spread: Spread | None,
    clutter: Any,
    expected: Array,
    blur: Array,
    rate: Array,
    scan: Scan,
) -> Claims:
    """Shares the detections of a scan out to their possible causes.

    Args:
        residual: (detection, expected) -> [Z], of the sensor.
        noise: R, [Z, Z].
        spread: Of the noise, None for R alone.
        clutter: Of `models.clutter`.
        expected: The detection expected of each target, [N, Z].
        blur: Covariance of that expectation, [N, Z, Z]; 0 if the states are given.
        rate: Detections expected of each target, [N].
        scan: K detections.
    """
    scale = jnp.ones(1, rate.dtype) if spread is None else jnp.asarray(spread.scale)
    share = jnp.ones(1, rate.dtype) if spread is None else jnp.asarray(spread.share)
    each = jax.vmap(jax.vmap(residual, (0, None)), (None, 0))
    surprise = each(scan.detections, expected)  # [N, K, Z]
    noises = scale[:, None, None] * dense(noise)[None]

    def fit(surprise: Array, blur: Array, noise: Array) -> Array:
        lower = linalg.cholesky(blur + noise)
        return jax.vmap(lambda gap: linalg.log_normal(gap, lower))(surprise)

    fits = jax.vmap(jax.vmap(fit, (None, None, 0)), (0, 0, None))
    log_rate = safe_log(rate)[:, None] + safe_log(share)[None]  # [N, S]
    log_cause = log_rate[:, :, None] + fits(surprise, blur, noises)  # [N, S, K]
    log_clutter = jax.vmap(clutter.log_density)(scan.detections)
    log_clutter = jnp.maximum(log_clutter, LEAST_LOG_WEIGHT)
    every = jnp.concatenate([log_cause.reshape(-1, len(scan.valid)), log_clutter[None]])
    log_total = mixture.total(every)
    log_prob = jnp.where(
        scan.valid[None, None], log_cause - log_total[None, None], -jnp.inf
    )
    prob = jnp.exp(log_prob)  # [N, S, K]
    precision = (prob / scale[None, :, None]).sum(1)  # [N, K]
    weight = precision.sum(1)
    total = (precision[:, :, None] * surprise).sum(1)
    false = jnp.where(scan.valid, jnp.exp(log_clutter - log_total), 0.0)
    expected_number = rate.sum() + clutter.rate
    return Claims(
        prob=jnp.concatenate([prob.sum(1), false[None]]).T,
        surprise=total / jnp.where(weight > LEAST_WEIGHT, weight, 1.0)[:, None],
        weight=weight,
        log_density=jnp.where(scan.valid, log_total, 0.0).sum() - expected_number,
    )


def synthetic(
    sensor: Affine, expected: Array, surprise: Array, weight: Array
) -> tuple[Affine, Array, Array]:
    """Makes the one detection that stands for all of a target's.

    Args:
        sensor: matrix [Z, D], offset [Z], cov [Z, Z], for a detection of weight one.
        expected: [Z].
        surprise: Its mean residual, [Z].
        weight: Its weight.

    Returns:
        The sensor, the detection [Z], and whether there is any.
    """
    some = weight > LEAST_WEIGHT
    cov = dense(sensor.cov) / jnp.where(some, weight, 1.0)
    return sensor._replace(cov=cov), expected + surprise, some
