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

from jaxtrack import imm as bank_of_modes
from jaxtrack import linearize, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.targets import blending, gauge, verbs, views
from jaxtrack.types import Array, Gaussian, Mixture, Target


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
    correct = functools.partial(_correct, method)
    return Target(
        begin=_begin,
        predict=functools.partial(_predict, method),
        miss=_miss,
        look=functools.partial(_look, method),
        score=functools.partial(_score, method),
        distance=functools.partial(_distance, yardstick, method),
        correct=correct,
        collapse=_collapse,
        absorb=verbs.absorb(correct, _collapse),
        blend=functools.partial(blend, method),
        adapt=verbs.unchanged,
        moments=mixture.collapse,
        modes=lambda bank: mixture.normalise(bank.log_weight),
        lost=lambda bank: jnp.zeros((), bank.mean.dtype),
    )


def _begin(params: Params, prior: Gaussian, mode_prob: Array, key: Array) -> Mixture:
    del params, key
    size = mode_prob.size
    mean = jnp.broadcast_to(prior.mean[None], (size, *prior.mean.shape))
    cov = jnp.broadcast_to(prior.cov[None], (size, *prior.cov.shape))
    return Mixture(safe_log(mode_prob), mean, cov)


def _predict(
    method: linearize.Method, params: Params, bank: Mixture, interval: Array
) -> tuple[Mixture, Array]:
    survive = _prob(params.survive, bank, interval)
    alive = bank._replace(log_weight=bank.log_weight + safe_log(survive))
    log_survive = mixture.total(alive.log_weight)

    log_transition = params.switching.log_transition(interval)
    mixed = bank_of_modes.mix(_normalised(alive), log_transition)
    motions = [
        linearize.motion_affine(motion, Gaussian(mean, cov), interval, method)
        for motion, mean, cov in zip(params.motions, mixed.mean, mixed.cov, strict=True)
    ]
    return bank_of_modes.predict(mixed, motions), log_survive


def _miss(params: Params, bank: Mixture) -> tuple[Mixture, Array]:
    log_miss = safe_log(1 - _prob(params.detect, bank))
    missed = bank._replace(log_weight=bank.log_weight + log_miss)
    return _normalised(missed), mixture.total(missed.log_weight)


def _look(method: linearize.Method, params: Params, bank: Mixture) -> blending.View:
    log_detect = safe_log(_prob(params.detect, bank))
    look = functools.partial(views.look, method, params)
    modes = jax.vmap(look)(Gaussian(bank.mean, bank.cov))
    return blending.View(bank.log_weight + log_detect, modes)


def _score(
    method: linearize.Method, params: Params, view: blending.View, detections: Array
) -> Array:
    score = functools.partial(views.score, method, params)
    log_density = jax.vmap(score, (0, None))(view.modes, detections)  # [M, K]
    return jax.vmap(mixture.total, 1)(view.log_weight[:, None] + log_density)


def _distance(
    yardstick: gauge.Yardstick,
    method: linearize.Method,
    params: Params,
    view: blending.View,
    detections: Array,
) -> tuple[Array, Array]:
    weight = mixture.normalise(view.log_weight)
    return gauge.distance(yardstick, method, params, weight, view.modes, detections)


def _correct(
    method: linearize.Method, params: Params, view: blending.View, detection: Array
) -> Mixture:
    correct = functools.partial(views.correct, method, params)
    moved, log_density = jax.vmap(correct, (0, None))(view.modes, detection)
    return _normalised(Mixture(view.log_weight + log_density, moved.mean, moved.cov))


def _collapse(log_weight: Array, banks: Mixture) -> Mixture:
    """Merges N banks mode by mode: log_weight [N], banks of [N, M] components."""
    log_joint = mixture.log_normalise(log_weight)[:, None] + banks.log_weight
    weight = jax.vmap(mixture.normalise, 1)(log_joint)  # [M, N]
    merged = jax.vmap(mixture.moment_match, (0, 1, 1))(weight, banks.mean, banks.cov)
    return Mixture(jax.vmap(mixture.total, 1)(log_joint), merged.mean, merged.cov)


def _prob(model: Any, bank: Mixture, interval: Array | float = 0.0) -> Array:
    """Evaluates a probability in every mode, at its mean: [M]."""
    modes = jnp.arange(bank.log_weight.size)
    return jax.vmap(model.prob, (0, 0, None))(modes, bank.mean, interval)


def _normalised(bank: Mixture) -> Mixture:
    return bank._replace(log_weight=mixture.log_normalise(bank.log_weight))
