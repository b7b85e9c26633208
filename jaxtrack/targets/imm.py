"""A target whose belief is a bank of modes, one Gaussian each: the IMM filter.

The modes may be any motions over the same state; they share one sensor.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import models
    >>> from jaxtrack.targets import imm
    >>> from jaxtrack.types import Gaussian
    >>> smooth, rough = (
    ...     models.motion.ConstantVelocity(q * jnp.ones(1)) for q in (0.1, 9.0))
    >>> params = imm.Params(
    ...     motions=(smooth, rough),
    ...     switching=models.switching.MarkovSwitching(
    ...         jnp.array([[0.9, 0.1], [0.2, 0.8]])),
    ...     sensor=models.sensor.Position(noise_std=jnp.ones(1)),
    ...     survive=models.probability.Constant(jnp.array(0.99)),
    ...     detect=models.probability.Constant(jnp.array(0.9)),
    ... )
    >>> target = imm.imm()
    >>> prior = Gaussian(jnp.zeros(2), jnp.eye(2))
    >>> bank = target.begin(params, prior, jnp.array([1.0, 0.0]), jax.random.key(0))
    >>> bank, _ = target.predict(params, bank, jnp.array(1.0))
    >>> print(target.modes(bank).round(3))
    [0.9 0.1]

Reference: Blom and Bar-Shalom 1988, see `jaxtrack.imm`.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linearize, mixture
from jaxtrack.targets import banks, blending, gauge, smoothing, verbs
from jaxtrack.types import Array, Mixture, Target


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        motions: One motion model per mode, a tuple of M; all over the same state.
        switching: Markov switching between modes, of `models.switching`.
        sensor: A model of `models.sensor`.
        survive: Probability to survive one interval, of `models.probability`.
        detect: Probability of detection, of `models.probability`.
    """

    motions: tuple[Any, ...]
    switching: Any
    sensor: Any
    survive: Any
    detect: Any

    @property
    def layout(self) -> Any:
        """Returns a motion model that says where positions and velocities stand."""
        return self.motions[0]


@functools.cache
def imm(
    method: linearize.Method = linearize.taylor,
    blend: blending.Blend = blending.by_mixture,
    yardstick: gauge.Yardstick = "mixture",
) -> Target:
    """Makes a target whose belief is a `Mixture` with one component per mode.

    Args:
        method: `linearize.taylor`, `unscented` or `cubature`; idle where the models
            are linear.
        blend: `blending.by_mixture` or `blending.by_residual`: how the modes are
            weighed where it is uncertain which detection is the target's.
        yardstick: Whose innovation covariance a gate goes by: the whole "mixture"'s, or
            that of the mode where it is "largest".

    Raises:
        ValueError: A yardstick that there is not.
    """
    gauge.check(yardstick)
    correct = functools.partial(banks.correct, method)
    return Target(
        begin=lambda params, prior, mode_prob, key: banks.begin(prior, mode_prob),
        predict=functools.partial(banks.predict, method),
        miss=lambda params, bank: banks.miss(params, bank, _all(bank)),
        look=lambda params, bank: banks.look(method, params, bank, _all(bank)),
        score=functools.partial(banks.score, method),
        distance=functools.partial(banks.distance, yardstick, method),
        correct=correct,
        collapse=_collapse,
        absorb=verbs.absorb(correct, _collapse),
        blend=functools.partial(blend, method),
        adapt=verbs.unchanged,
        moments=mixture.collapse,
        parts=lambda bank: bank,
        modes=lambda bank: mixture.normalise(bank.log_weight),
        lost=lambda bank: jnp.zeros((), bank.mean.dtype),
        effective_size=verbs.no_sample,
        smooth=functools.partial(smoothing.bank, method),
    )


def _all(bank: Mixture) -> Array:
    """Returns that all modes are active, [M]."""
    return jnp.zeros_like(bank.log_weight)


def _collapse(log_weight: Array, many: Mixture) -> Mixture:
    """Merges N banks mode by mode: log_weight [N], each of M modes."""
    log_joint = mixture.log_normalise(log_weight)[:, None] + many.log_weight
    weight = jax.vmap(mixture.normalise, 1)(log_joint)  # [M, N]
    merged = jax.vmap(mixture.moment_match, (0, 1, 1))(weight, many.mean, many.cov)
    return Mixture(mixture.total(log_joint), merged.mean, merged.cov)
