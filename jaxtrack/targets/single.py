"""A target whose belief is one Gaussian: the KF, EKF, UKF and CKF.

Which of them it is follows from the linearisation: with linear models all are the
Kalman filter; with nonlinear ones `linearize.taylor` gives the extended, `unscented`
the unscented and `cubature` the cubature filter. Probabilities of survival and of
detection that depend on the state are taken at the mean.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import models
    >>> from jaxtrack.targets import single
    >>> from jaxtrack.types import Gaussian
    >>> params = single.Params(
    ...     motion=models.motion.ConstantVelocity(noise_density=jnp.ones(1)),
    ...     sensor=models.sensor.Position(noise_std=jnp.ones(1)),
    ...     survive=models.probability.Constant(jnp.array(0.99)),
    ...     detect=models.probability.Constant(jnp.array(0.9)),
    ... )
    >>> target = single.single()
    >>> belief = Gaussian(jnp.zeros(2), jnp.eye(2))
    >>> belief, log_survive = target.predict(params, belief, jnp.array(2.0))
    >>> print(belief.mean.shape, jnp.exp(log_survive).round(2))
    (2,) 0.99
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxtrack import kalman, linearize, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.targets import blending, verbs, views
from jaxtrack.types import Array, Gaussian, Mixture, Target


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        motion: A model of `models.motion` or `models.turn`.
        sensor: A model of `models.sensor`.
        survive: Probability to survive one interval, of `models.probability`.
        detect: Probability of detection, of `models.probability`.
    """

    motion: Any
    sensor: Any
    survive: Any
    detect: Any

    @property
    def layout(self) -> Any:
        """Returns a motion model that says where positions and velocities stand."""
        return self.motion


@functools.cache
def single(method: linearize.Method = linearize.taylor) -> Target:
    """Makes a target whose belief is a single `Gaussian`.

    Args:
        method: `linearize.taylor`, `unscented` or `cubature`; idle where the models
            are linear.
    """
    correct = functools.partial(_correct, method)
    return Target(
        begin=_begin,
        predict=functools.partial(_predict, method),
        miss=_miss,
        look=functools.partial(views.look, method),
        score=functools.partial(_score, method),
        distance=functools.partial(views.distance, method),
        correct=correct,
        collapse=_collapse,
        absorb=verbs.absorb(correct, _collapse),
        blend=functools.partial(_blend, method),
        adapt=verbs.unchanged,
        moments=lambda belief: belief,
        parts=_parts,
        modes=lambda belief: jnp.ones(1, belief.mean.dtype),
        lost=lambda belief: jnp.zeros((), belief.mean.dtype),
        effective_size=verbs.no_sample,
        smooth=functools.partial(_smooth, method),
    )


def _begin(params: Params, prior: Gaussian, mode_prob: Array, key: Array) -> Gaussian:
    del params, mode_prob, key
    return prior


def _predict(
    method: linearize.Method, params: Params, belief: Gaussian, interval: Array
) -> tuple[Gaussian, Array]:
    log_survive = safe_log(params.survive.prob(0, belief.mean, interval))
    motion = linearize.motion_affine(params.motion, belief, interval, method)
    return kalman.predict(belief, motion), log_survive


def _smooth(
    method: linearize.Method,
    params: Params,
    belief: Gaussian,
    later: Gaussian,
    interval: Array,
) -> Gaussian:
    motion = linearize.motion_affine(params.motion, belief, interval, method)
    return kalman.smooth_step(belief, motion, kalman.predict(belief, motion), later)


def _miss(params: Params, belief: Gaussian) -> tuple[Gaussian, Array]:
    return belief, safe_log(1 - _detect_prob(params, belief))


def _score(
    method: linearize.Method, params: Params, view: views.View, detections: Array
) -> Array:
    log_detect = safe_log(_detect_prob(params, view.prior))
    return log_detect + views.score(method, params, view, detections)


def _correct(
    method: linearize.Method, params: Params, view: views.View, detection: Array
) -> Gaussian:
    return views.correct(method, params, view, detection)[0]


def _blend(
    method: linearize.Method,
    params: Params,
    view: views.View,
    missed: Gaussian,
    log_weight: Array,
    detections: Array,
) -> Gaussian:
    del missed  # a miss teaches nothing here
    weight = jnp.exp(blending.shares(log_weight))
    return views.blend(method, params, view, weight, detections)


def _collapse(log_weight: Array, beliefs: Gaussian) -> Gaussian:
    return mixture.collapse(Mixture(log_weight, beliefs.mean, beliefs.cov))


def _parts(belief: Gaussian) -> Mixture:
    whole = jnp.zeros(1, belief.mean.dtype)
    return Mixture(whole, belief.mean[None], belief.cov[None])


def _detect_prob(params: Params, belief: Gaussian) -> Array:
    return params.detect.prob(0, belief.mean, 0.0)
