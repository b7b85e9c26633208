"""A target whose belief is a Gaussian mixture in every mode: jump Markov.

It is exact but for the reduction. Each scan multiplies the components: mode n is
entered from every component of every mode. They are pruned, merged and capped to
`max_components` a mode before the motion, and again whenever beliefs are collapsed.
With one component a mode that absorbs all others this is the IMM filter
(`targets.imm`); with one mode it is the Gaussian mixture of the single-model filters.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import models
    >>> from jaxtrack.targets import mixture
    >>> from jaxtrack.types import Gaussian
    >>> params = mixture.Params(
    ...     motions=(models.motion.ConstantVelocity(jnp.ones(1)),),
    ...     switching=models.switching.MarkovSwitching(jnp.ones((1, 1))),
    ...     sensor=models.sensor.Position(noise_std=jnp.ones(1)),
    ...     survive=models.probability.Constant(jnp.array(0.99)),
    ...     detect=models.probability.Constant(jnp.array(0.9)),
    ... )
    >>> target = mixture.mixture(max_components=3)
    >>> prior = Gaussian(jnp.zeros(2), jnp.eye(2))
    >>> belief = target.begin(params, prior, jnp.ones(1), jax.random.key(0))
    >>> belief.mean.shape
    (1, 3, 2)

Reference: Yuan, Lian and Han, "Multiple-model cardinality balanced multitarget
multi-Bernoulli filter for tracking maneuvering targets", 2013, equations 30 to 36;
Pasha, Vo, Tuan and Ma, "A Gaussian mixture PHD filter for jump Markov system models",
IEEE Trans. Aerospace and Electronic Systems 45(3), 2009.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import kalman, linearize
from jaxtrack import mixture as gaussians
from jaxtrack.linalg import safe_log
from jaxtrack.targets import components, gauge, verbs, views
from jaxtrack.targets.imm import Params
from jaxtrack.types import Array, Gaussian, Target

__all__ = ["Params", "mixture"]


class View(NamedTuple):
    """A belief as the sensor sees it.

    Attributes:
        log_weight: Of each component, times its probability of detection, [M, N].
        parts: [M, N].
        lost: As in the belief.
    """

    log_weight: Array
    parts: views.View
    lost: Array


@functools.cache
def mixture(
    max_components: int = 10,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 4.0,
    method: linearize.Method = linearize.taylor,
    yardstick: gauge.Yardstick = "mixture",
) -> Target:
    """Makes a target whose belief is a jump Markov Gaussian mixture.

    Args:
        max_components: Components that each mode keeps.
        prune_threshold: Components with a smaller share of the whole weight go.
        merge_threshold: Squared Mahalanobis distance within which components merge.
        method: `linearize.taylor`, `unscented` or `cubature`; idle where the models
            are linear.
        yardstick: Whose innovation covariance a gate goes by: the whole "mixture"'s, or
            that of the component where it is "largest".

    Raises:
        ValueError: A size, threshold or yardstick that makes no sense.
    """
    gauge.check(yardstick)
    reduction = components.Reduction(max_components, prune_threshold, merge_threshold)
    components.check(reduction)
    correct = functools.partial(_correct, method)
    collapse = functools.partial(components.collapse, reduction)
    return Target(
        begin=functools.partial(_begin, reduction),
        predict=functools.partial(_predict, reduction, method),
        miss=_miss,
        look=functools.partial(_look, method),
        score=functools.partial(_score, method),
        distance=functools.partial(_distance, yardstick, method),
        correct=correct,
        collapse=collapse,
        absorb=verbs.absorb(correct, collapse),
        blend=verbs.blend(correct, collapse),
        adapt=verbs.unchanged,
        moments=components.moments,
        parts=components.parts,
        modes=lambda belief: gaussians.normalise(
            jax.vmap(gaussians.total)(belief.log_weight)
        ),
        lost=lambda belief: belief.lost,
        effective_size=verbs.no_sample,
    )


def _begin(
    reduction: components.Reduction,
    params: Params,
    prior: Gaussian,
    mode_prob: Array,
    key: Array,
) -> components.Belief:
    del params, key
    shape = (mode_prob.size, reduction.max_components)
    first = (jnp.arange(shape[1]) == 0)[None]
    return components.Belief(
        log_weight=jnp.where(first, safe_log(mode_prob)[:, None], -jnp.inf),
        mean=jnp.broadcast_to(prior.mean, (*shape, *prior.mean.shape)),
        cov=jnp.broadcast_to(prior.cov, (*shape, *prior.cov.shape)),
        lost=jnp.zeros((), prior.mean.dtype),
    )


def _predict(
    reduction: components.Reduction,
    method: linearize.Method,
    params: Params,
    belief: components.Belief,
    interval: Array,
) -> tuple[components.Belief, Array]:
    survive = _prob(params.survive, belief, interval)
    alive = components.reweight(belief, safe_log(survive))
    log_survive = gaussians.total(alive.log_weight.ravel())

    # Equation 32: component (i, j) enters mode n with weight h(n | i) w(i, j).
    log_transition = params.switching.log_transition(interval)  # [left, entered]
    log_weight = alive.log_weight[None] + log_transition.T[:, :, None]
    mixed = components.reduce(
        reduction,
        gaussians.log_normalise(log_weight.ravel()).reshape(log_weight.shape[0], -1),
        *(x.reshape(-1, *x.shape[2:]) for x in (belief.mean, belief.cov)),
    )

    def move(motion: Any, component: Gaussian) -> Gaussian:
        affine = linearize.motion_affine(motion, component, interval, method)
        return kalman.predict(component, affine)

    # Mode by mode, since each motion knows other zeros.
    moved = [
        jax.vmap(functools.partial(move, motion))(Gaussian(mean, cov))
        for motion, mean, cov in zip(params.motions, mixed.mean, mixed.cov, strict=True)
    ]
    mean, cov = (jnp.stack(x) for x in zip(*moved, strict=True))
    return mixed._replace(mean=mean, cov=cov), log_survive


def _miss(params: Params, belief: components.Belief) -> tuple[components.Belief, Array]:
    detect = _prob(params.detect, belief)
    missed = components.reweight(belief, safe_log(1 - detect))
    return components.normalised(missed), gaussians.total(missed.log_weight.ravel())


def _look(method: linearize.Method, params: Params, belief: components.Belief) -> View:
    log_detect = safe_log(_prob(params.detect, belief))
    look = functools.partial(views.look, method, params)
    parts = jax.vmap(jax.vmap(look))(Gaussian(belief.mean, belief.cov))
    return View(belief.log_weight + log_detect, parts, belief.lost)


def _score(
    method: linearize.Method, params: Params, view: View, detections: Array
) -> Array:
    score = functools.partial(views.score, method, params)
    log_density = jax.vmap(jax.vmap(score, (0, None)), (0, None))(
        view.parts, detections
    )
    weighed = view.log_weight[:, :, None] + log_density
    return gaussians.total(weighed.reshape(-1, len(detections)))


def _distance(
    yardstick: gauge.Yardstick,
    method: linearize.Method,
    params: Params,
    view: View,
    detections: Array,
) -> tuple[Array, Array]:
    weight = gaussians.normalise(view.log_weight.ravel())
    parts = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), view.parts)
    return gauge.distance(yardstick, method, params, weight, parts, detections)


def _correct(
    method: linearize.Method, params: Params, view: View, detection: Array
) -> components.Belief:
    correct = functools.partial(views.correct, method, params)
    moved, log_density = jax.vmap(jax.vmap(correct, (0, None)), (0, None))(
        view.parts, detection
    )
    weighed = view.log_weight + log_density
    return components.normalised(
        components.Belief(weighed, moved.mean, moved.cov, view.lost)
    )


def _prob(
    model: Any, belief: components.Belief, interval: Array | float = 0.0
) -> Array:
    """Evaluates a probability in every component, at its mean: [M, N]."""
    modes = jnp.arange(belief.mean.shape[0])
    per_mode = jax.vmap(model.prob, (None, 0, None))
    return jax.vmap(per_mode, (0, 0, None))(modes, belief.mean, interval)
