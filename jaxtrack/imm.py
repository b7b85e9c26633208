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

from collections.abc import Callable

import chex
import jax
import jax.numpy as jnp
from jax.scipy.special import logsumexp

from jaxtrack import kalman
from jaxtrack.linalg import safe_log
from jaxtrack.mixture import log_normalise, moment_match, total
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

    log_joint = bank.log_weight[:, None] + log_transition  # [left, entered]

    # A column of -inf would be 0/0 below. Masking the result is too late for the
    # gradient, so such a mode is given itself as its only predecessor instead.
    enterable = jnp.any(log_joint > -jnp.inf, axis=0)
    itself = safe_log(jnp.eye(num_modes, dtype=log_joint.dtype))
    log_joint = jnp.where(enterable[None], log_joint, itself)

    log_entered = jnp.where(enterable, logsumexp(log_joint, axis=0), -jnp.inf)
    came_from = jax.nn.softmax(log_joint, axis=0)
    mixed = jax.vmap(moment_match, (1, None, None))(came_from, bank.mean, bank.cov)
    return Mixture(log_entered, mixed.mean, mixed.cov)


def predict(bank: Mixture, motions: Affine) -> Mixture:
    """Moves each mode by its own model.

    Args:
        bank: log_weight [M], mean [M, D], cov [M, D, D].
        motions: One affine model per mode: matrix [M, D, D], offset [M, D],
            cov [M, D, D].

    Returns:
        The predicted bank, same shapes and weights.
    """
    moved = jax.vmap(kalman.predict)(Gaussian(bank.mean, bank.cov), motions)
    return Mixture(bank.log_weight, moved.mean, moved.cov)


def update(
    bank: Mixture,
    sensors: Affine,
    detection: Array,
    residual: Callable[[Array, Array], Array] = jnp.subtract,
) -> tuple[Mixture, Array]:
    """Conditions every mode on one detection and reweights it by its likelihood.

    Args:
        bank: log_weight [M], mean [M, D], cov [M, D, D].
        sensors: One affine model per mode: matrix [M, Z, D], offset [M, Z],
            cov [M, Z, Z].
        detection: [Z].
        residual: (detection, expected) -> [Z].

    Returns:
        The posterior bank, weights summing to one, and the log-density of the
        detection under the prior bank (a scalar; -inf where no mode has weight).
    """

    def one(belief: Gaussian, sensor: Affine) -> tuple[Gaussian, Array]:
        return kalman.update(belief, sensor, detection, residual)

    posterior, log_density = jax.vmap(one)(Gaussian(bank.mean, bank.cov), sensors)
    log_weight = bank.log_weight + log_density
    before = total(bank.log_weight)
    log_evidence = total(log_weight) - jnp.where(before > -jnp.inf, before, 0.0)
    weight = log_normalise(log_weight)
    return Mixture(weight, posterior.mean, posterior.cov), log_evidence
