"""A bank of modes whose detection is uncertain: two ways to weigh its modes.

Every mode keeps one Gaussian, matched over the detections that may be its own and over
none. The ways differ in what makes a mode likely:

- `by_mixture`: the Gaussian mixture density of all detections, each weighed by how
  likely it is the target's. This is Bayes' rule; modes differ in which detection is
  theirs.
- `by_residual`: the density N(r; 0, S) of the average residual r, as Gomes prints it.
  All modes share one set of association probabilities, and a mode that expects the
  centre of several detections is rewarded.

With one certain detection the two agree. Where only some modes are active, the others
are weighed on the same scale, but what is certain is that one of the active is true.

    >>> from jaxtrack.targets import blending, imm
    >>> target = imm.imm(blend=blending.by_residual)
    >>> import jax.numpy as jnp
    >>> print(blending.shares(jnp.full(3, -jnp.inf)))
    [-inf -inf   0.]

Reference: Gomes, "An overview on target tracking using multiple models methods", 2011,
Tables 4 and 5; Blom and Bloem, "Combining IMM and JPDA for tracking multiple
maneuvering targets in clutter", FUSION 2002.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linearize, mixture
from jaxtrack.targets import views
from jaxtrack.types import Array, Mixture


class View(NamedTuple):
    """A bank as the sensor sees it.

    Attributes:
        log_weight: Of each mode, times its probability of detection, [M].
        modes: [M].
        log_active: 0 for the modes that count and -inf for those that do not, or the
            log of something in between, [M].
    """

    log_weight: Array
    modes: views.View
    log_active: Array


Blend = Callable[[linearize.Method, Any, View, Mixture, Array, Array], Mixture]


def by_mixture(
    method: linearize.Method,
    params: Any,
    view: View,
    missed: Mixture,
    log_weight: Array,
    detections: Array,
) -> Mixture:
    """Weighs a mode by how well it explains the detections, each on its own.

    Args:
        method: Of `linearize`.
        params: A target's `Params`.
        view: How the bank is seen.
        missed: The bank if it was not detected, M modes.
        log_weight: Of each detection and, last, of none; any scale, [K + 1].
        detections: [K, Z].

    Returns:
        The bank, weights of the active modes summing to one.
    """
    log_share = shares(log_weight)
    score = functools.partial(views.score, method, params)
    log_density = jax.vmap(score, (0, None))(view.modes, detections)  # [M, K]
    log_mode = view.log_weight[:, None] + log_density
    log_mode = jax.vmap(log_normalise, (1, None), 1)(log_mode, view.log_active)
    log_joint = jnp.concatenate(
        [log_share[None, :-1] + log_mode, (log_share[-1] + missed.log_weight)[:, None]],
        axis=1,
    )
    log_total = jax.vmap(mixture.total)(log_joint)
    weight = jnp.exp(jax.vmap(shares)(log_joint))
    blend = functools.partial(views.blend, method, params)
    modes = jax.vmap(blend, (0, 0, None))(view.modes, weight, detections)
    log_total = log_normalise(log_total, view.log_active)
    return Mixture(log_total, modes.mean, modes.cov)


def by_residual(
    method: linearize.Method,
    params: Any,
    view: View,
    missed: Mixture,
    log_weight: Array,
    detections: Array,
) -> Mixture:
    """Weighs a mode by the density of its average residual; see `by_mixture`."""
    weight = jnp.exp(shares(log_weight))
    detected = weight[:-1].sum()

    def of_mode(mode: views.View) -> tuple[Any, Array]:
        log_density = views.average_score(method, params, mode, weight[:-1], detections)
        return views.blend(method, params, mode, weight, detections), log_density

    modes, log_density = jax.vmap(of_mode)(view.modes)
    # Where nothing may be its own there is no residual to go by.
    seen = log_normalise(view.log_weight + log_density, view.log_active)
    log_mode = jnp.where(detected > 0, seen, missed.log_weight)
    return Mixture(log_mode, modes.mean, modes.cov)


def shares(log_weight: Array) -> Array:
    """Returns log-weights that sum to one; if all are empty, none is the target's."""
    nobody = jnp.all(log_weight == -jnp.inf)
    last = jnp.where(jnp.arange(log_weight.size) == log_weight.size - 1, 0.0, -jnp.inf)
    return jax.nn.log_softmax(jnp.where(nobody, last, log_weight))


def log_normalise(log_weight: Array, log_active: Array) -> Array:
    """Scales all weights so that those of the active modes sum to one.

    If none of the active has any, the first of them gets all, so that values and
    gradients stay finite.

    Args:
        log_weight: [M].
        log_active: As in `View`, [M].

    Returns:
        Log-weights, [M]; those of modes that are not active may be above 0.

    Example:
        >>> from jaxtrack.targets import blending
        >>> import jax.numpy as jnp
        >>> weight = jnp.log(jnp.array([3.0, 1.0, 8.0]))
        >>> scaled = blending.log_normalise(weight, jnp.array([0.0, 0.0, -jnp.inf]))
        >>> print(jnp.exp(scaled))
        [0.75 0.25 2.  ]
    """
    log_total = mixture.total(log_weight + log_active)
    empty = log_total == -jnp.inf
    first = jnp.arange(log_weight.size) == jnp.argmax(log_active)
    safe = jnp.where(empty, jnp.where(first, 0.0, -jnp.inf), log_weight)
    return safe - jnp.where(empty, 0.0, log_total)
