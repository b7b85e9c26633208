"""Interacting multiple models (IMM): one target, M motion modes, Markov switching.

A bank of modes is a `Mixture` with one component per mode, whose weights are the mode
probabilities. One scan is

    bank = mix(bank, log_transition)        # modes trade belief
    bank = predict(bank, motions)           # each mode moves by its own model
    bank, log_density = update(bank, sensors, detection)  # reweighted by its likelihood
    belief = mixture.collapse(bank)         # for output only; the bank is the state

Reference: Blom and Bar-Shalom, "The interacting multiple model algorithm for systems
with Markovian switching coefficients", IEEE Trans. Automatic Control 33(8), 1988.
"""

import functools
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
from jax.scipy.special import logsumexp

from jaxtrack import kalman, linalg
from jaxtrack.entries import apart, dense, flat, scalars, split
from jaxtrack.linalg import safe_log
from jaxtrack.mixture import log_normalise, moment_match
from jaxtrack.types import Affine, Array, Gaussian, Mixture


def mix(bank: Mixture, log_transition: Array) -> Mixture:
    """Lets the modes trade belief before each is predicted by its own model.

    With mode probabilities mu and p[i, j] = P(mode j now | mode i before), mode j is
    entered with probability c[j] = sum_i mu[i] p[i, j], and its new belief is the
    moment match of the old ones under the weights mu[i] p[i, j] / c[j].

    The belief as a whole is left alone: `mixture.collapse` gives the same mean and
    covariance before and after.

    Args:
        bank: Mode-conditioned beliefs; log_weight [M], mean [M, D], cov [M, D, D].
        log_transition: log p, [M, M]; rows are the mode left, columns the one entered.

    Returns:
        The mixed bank, same shapes. A mode that nothing can enter gets log-weight
        -inf and keeps its own moments, so values and gradients stay finite.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxtrack import imm
        >>> from jaxtrack.types import Mixture
        >>> bank = Mixture(jnp.log(jnp.array([0.5, 0.5])),
        ...                jnp.array([[0.0], [4.0]]), jnp.ones((2, 1, 1)))
        >>> sticky = jnp.log(jnp.array([[0.75, 0.25], [0.25, 0.75]]))
        >>> print(imm.mix(bank, sticky).mean.round(1))
        [[1.]
         [3.]]
    """
    num_modes, dim = bank.mean.shape
    chex.assert_shape(bank.log_weight, (num_modes,))
    chex.assert_shape(bank.cov, (num_modes, dim, dim))
    chex.assert_shape(log_transition, (num_modes, num_modes))
    if max(num_modes, dim) > linalg.UNROLL:
        return _mix_large(bank, log_transition)

    left = scalars(bank.log_weight)
    modes = [(mean, linalg.symmetric(cov)) for mean, cov in _modes(bank)]
    log_entered, mixed = [], []
    for mode, column in enumerate(split(log_transition).T.rows):
        log_joint = [x + y for x, y in zip(left, column, strict=True)]
        log_sum, came_from = _normalise(log_joint, mode)
        log_entered.append(log_sum)
        mixed.append(_match(came_from, modes))
    return _bank(jnp.stack(log_entered), mixed)


def _mix_large(bank: Mixture, log_transition: Array) -> Mixture:
    """Mixes as `mix` does, not written out."""
    log_joint = bank.log_weight[:, None] + log_transition  # [left, entered]

    # A column of -inf would be 0/0 below. Masking the result is too late for the
    # gradient, so such a mode is given itself as its only predecessor instead.
    enterable = jnp.any(log_joint > -jnp.inf, axis=0)
    itself = safe_log(jnp.eye(bank.log_weight.size, dtype=log_joint.dtype))
    log_joint = jnp.where(enterable[None], log_joint, itself)

    log_entered = jnp.where(enterable, logsumexp(log_joint, axis=0), -jnp.inf)
    came_from = jax.nn.softmax(log_joint, axis=0)
    mixed = jax.vmap(moment_match, (1, None, None))(came_from, bank.mean, bank.cov)
    return Mixture(log_entered, mixed.mean, mixed.cov)


def _modes(bank: Mixture) -> list[tuple[Any, Any]]:
    """Returns mean [D, 1] and covariance [D, D] of each mode, small ones by entries."""
    both = linalg.column(bank.mean), linalg.entries(bank.cov)
    leaves, layout = jax.tree.flatten(both)
    modes = zip(*(apart(leaf, 0) for leaf in leaves), strict=True)
    return [jax.tree.unflatten(layout, mode) for mode in modes]


def _bank(log_weight: Array, modes: Sequence[tuple[Any, Any]]) -> Mixture:
    """Joins modes again, each entry over the modes first: XLA sees through that."""
    mean, cov = jax.tree.map(lambda *x: jnp.stack(x), *modes)
    return Mixture(log_weight, flat(mean), dense(cov))


def _normalise(log_weight: Sequence[Array], fallback: int) -> tuple[Array, list[Array]]:
    """Returns the log of the sum of some weights, and the share of each.

    Where all are -inf the fallback has the whole share, and gradients are finite.
    """
    top = jax.lax.stop_gradient(functools.reduce(jnp.maximum, log_weight))
    some = top != -jnp.inf
    weight = [jnp.exp(x - jnp.where(some, top, 0.0)) for x in log_weight]
    size = jnp.where(some, functools.reduce(operator.add, weight), 1.0)
    share = [
        jnp.where(some, x / size, float(i == fallback)) for i, x in enumerate(weight)
    ]
    return jnp.where(some, top + jnp.log(size), -jnp.inf), share


def _match(
    weight: Sequence[Array], modes: Sequence[tuple[Any, Any]]
) -> tuple[Any, Any]:
    """Moment-matches modes with weights that sum to one."""

    def mean_of(values: Iterable[Any]) -> Any:
        weighted = (x * w for x, w in zip(values, weight, strict=True))
        return linalg.settle(functools.reduce(operator.add, weighted))

    centre = mean_of(mean for mean, _ in modes)

    def about(mean: Any, cov: Any) -> Any:
        gap = mean - centre
        return linalg.triangle(cov + gap @ gap.T)

    return centre, mean_of(about(*mode) for mode in modes)


def predict(bank: Mixture, motions: Sequence[Affine]) -> Mixture:
    """Moves each mode by its own model.

    Args:
        bank: log_weight [M], mean [M, D], cov [M, D, D].
        motions: One affine model per mode, M of them: matrix [D, D], offset [D],
            cov [D, D]. Each may know other entries (see `jaxtrack.entries`).

    Returns:
        The predicted bank, same shapes and weights.
    """
    pairs = zip(_beliefs(bank), motions, strict=True)
    moved = [kalman.predict(belief, motion) for belief, motion in pairs]
    return _bank(bank.log_weight, [_entries(belief) for belief in moved])


def update(
    bank: Mixture,
    sensors: Sequence[Affine],
    detection: Array,
    residual: Callable[[Array, Array], Array] = jnp.subtract,
) -> tuple[Mixture, Array]:
    """Conditions every mode on one detection and reweights it by its likelihood.

    Args:
        bank: log_weight [M], mean [M, D], cov [M, D, D].
        sensors: One affine model per mode, M of them: matrix [Z, D], offset [Z],
            cov [Z, Z].
        detection: [Z].
        residual: (detection, expected) -> [Z].

    Returns:
        The posterior bank, weights summing to one, and the log-density of the
        detection under the prior bank (a scalar; -inf where no mode has weight).
    """
    updated = [
        kalman.update(belief, sensor, detection, residual)
        for belief, sensor in zip(_beliefs(bank), sensors, strict=True)
    ]
    log_weight = [
        x + y for x, (_, y) in zip(scalars(bank.log_weight), updated, strict=True)
    ]
    before, _ = _normalise(scalars(bank.log_weight), 0)
    log_total, _ = _normalise(log_weight, 0)
    log_evidence = log_total - jnp.where(before > -jnp.inf, before, 0.0)
    posterior = [_entries(belief) for belief, _ in updated]
    return _bank(log_normalise(jnp.stack(log_weight)), posterior), log_evidence


def _beliefs(bank: Mixture) -> list[Gaussian]:
    return [Gaussian(flat(mean), dense(cov)) for mean, cov in _modes(bank)]


def _entries(belief: Gaussian) -> tuple[Any, Any]:
    return linalg.column(belief.mean), linalg.entries(belief.cov)
