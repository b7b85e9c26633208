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
from jaxtrack.models.sensor import untimed
from jaxtrack.targets.imm import Params
from jaxtrack.types import Affine, Array, Gaussian, Mixture, Target

__all__ = ["Belief", "Params", "mixture"]


class Belief(NamedTuple):
    """N components in each of M modes; the weights of all M N sum to one.

    Attributes:
        log_weight: -inf marks an empty slot, [M, N].
        mean: [M, N, D].
        cov: [M, N, D, D].
        lost: Share of the weight that the cap threw away at the last reduction.
    """

    log_weight: Array
    mean: Array
    cov: Array
    lost: Array


class Reduction(NamedTuple):
    """How a mixture is kept small; see `jaxtrack.mixture.reduce`."""

    max_components: int
    prune_threshold: float
    merge_threshold: float


@functools.cache
def mixture(
    max_components: int = 10,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 4.0,
    method: linearize.Method = linearize.taylor,
) -> Target:
    """Makes a target whose belief is a jump Markov Gaussian mixture.

    Args:
        max_components: Components that each mode keeps.
        prune_threshold: Components with a smaller share of the whole weight go.
        merge_threshold: Squared Mahalanobis distance within which components merge.
        method: `linearize.taylor`, `unscented` or `cubature`; idle where the models
            are linear.

    Raises:
        ValueError: A size or threshold that makes no sense.
    """
    reduction = Reduction(max_components, prune_threshold, merge_threshold)
    _check(reduction)
    return Target(
        begin=functools.partial(_begin, reduction),
        predict=functools.partial(_predict, reduction, method),
        miss=_miss,
        score=functools.partial(_score, method),
        correct=functools.partial(_correct, method),
        collapse=functools.partial(_collapse, reduction),
        moments=_moments,
        modes=lambda belief: gaussians.normalise(
            jax.vmap(gaussians.total)(belief.log_weight)
        ),
        lost=lambda belief: belief.lost,
    )


def _check(reduction: Reduction) -> None:
    if reduction.max_components < 1:
        raise ValueError(
            f"max_components is {reduction.max_components}; a mode needs at least 1"
        )
    if not 0 <= reduction.prune_threshold < 1:
        raise ValueError(
            f"prune_threshold is {reduction.prune_threshold}; give a share of the "
            "weight from 0 up to 1, e.g. 1e-5"
        )
    if not reduction.merge_threshold >= 0:
        raise ValueError(
            f"merge_threshold is {reduction.merge_threshold}; give a squared distance "
            "of 0 or more, e.g. 4"
        )


def _begin(
    reduction: Reduction, params: Params, prior: Gaussian, mode_prob: Array, key: Array
) -> Belief:
    del params, key
    shape = (mode_prob.size, reduction.max_components)
    first = (jnp.arange(shape[1]) == 0)[None]
    return Belief(
        log_weight=jnp.where(first, safe_log(mode_prob)[:, None], -jnp.inf),
        mean=jnp.broadcast_to(prior.mean, (*shape, *prior.mean.shape)),
        cov=jnp.broadcast_to(prior.cov, (*shape, *prior.cov.shape)),
        lost=jnp.zeros((), prior.mean.dtype),
    )


def _predict(
    reduction: Reduction,
    method: linearize.Method,
    params: Params,
    belief: Belief,
    interval: Array,
) -> tuple[Belief, Array]:
    survive = _prob(params.survive, belief, interval)
    alive = _reweight(belief, safe_log(survive))
    log_survive = gaussians.total(alive.log_weight.ravel())

    # Equation 32: component (i, j) enters mode n with weight h(n | i) w(i, j).
    log_transition = params.switching.log_transition(interval)  # [left, entered]
    log_weight = alive.log_weight[None] + log_transition.T[:, :, None]
    mixed = _reduce(
        reduction,
        gaussians.log_normalise(log_weight.ravel()).reshape(log_weight.shape[0], -1),
        *(x.reshape(-1, *x.shape[2:]) for x in (belief.mean, belief.cov)),
    )

    def linearised(motion: Any, component: Gaussian) -> Affine:
        return linearize.motion_affine(motion, component, interval, method)

    motions = [
        jax.vmap(functools.partial(linearised, motion))(Gaussian(mean, cov))
        for motion, mean, cov in zip(params.motions, mixed.mean, mixed.cov, strict=True)
    ]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *motions)
    moved = jax.vmap(jax.vmap(kalman.predict))(_gaussians(mixed), stacked)
    return mixed._replace(mean=moved.mean, cov=moved.cov), log_survive


def _miss(params: Params, belief: Belief) -> tuple[Belief, Array]:
    detect = _prob(params.detect, belief)
    missed = _reweight(belief, safe_log(1 - detect))
    return _normalised(missed), gaussians.total(missed.log_weight.ravel())


def _score(
    method: linearize.Method, params: Params, belief: Belief, detections: Array
) -> Array:
    log_detect = safe_log(_prob(params.detect, belief))

    def one(detection: Array) -> Array:
        sensor, plain = untimed(params.sensor, detection)

        def in_component(component: Gaussian) -> Array:
            motion = params.layout  # all modes share one state
            affine = linearize.sensor_affine(sensor, motion, component, method)
            return kalman.log_density(component, affine, plain, sensor.residual)

        log_density = jax.vmap(jax.vmap(in_component))(_gaussians(belief))
        return gaussians.total((belief.log_weight + log_detect + log_density).ravel())

    return jax.vmap(one)(detections)


def _correct(
    method: linearize.Method, params: Params, belief: Belief, detection: Array
) -> Belief:
    sensor, plain = untimed(params.sensor, detection)

    def in_component(component: Gaussian) -> tuple[Gaussian, Array]:
        motion = params.layout
        affine = linearize.sensor_affine(sensor, motion, component, method)
        return kalman.update(component, affine, plain, sensor.residual)

    log_detect = safe_log(_prob(params.detect, belief))
    posterior, log_density = jax.vmap(jax.vmap(in_component))(_gaussians(belief))
    corrected = belief._replace(mean=posterior.mean, cov=posterior.cov)
    return _normalised(_reweight(corrected, log_detect + log_density))


def _collapse(reduction: Reduction, log_weight: Array, beliefs: Belief) -> Belief:
    """Pools the components of N beliefs, mode by mode, and reduces them."""
    share = gaussians.log_normalise(log_weight)
    pooled = _reweight(beliefs, share[:, None, None])
    log_joint, mean, cov = (
        jnp.moveaxis(x, 0, 1).reshape(x.shape[1], -1, *x.shape[3:])
        for x in (pooled.log_weight, pooled.mean, pooled.cov)
    )
    reduced = _reduce(reduction, log_joint, mean, cov)
    earlier = (jnp.exp(share) * beliefs.lost).sum()
    return reduced._replace(lost=reduced.lost + (1 - reduced.lost) * earlier)


def _reduce(reduction: Reduction, log_weight: Array, mean: Array, cov: Array) -> Belief:
    """Reduces each mode's components.

    log_weight is [M, C]; mean is [M, C, D], or [C, D] where the modes share it.
    """
    size, threshold = reduction.max_components, reduction.merge_threshold
    heavy = jnp.exp(log_weight) >= reduction.prune_threshold
    pruned = jnp.where(heavy, log_weight, -jnp.inf)
    pruned = gaussians.log_normalise(pruned.ravel()).reshape(pruned.shape)

    def in_mode(log_weight: Array, mean: Array, cov: Array) -> tuple[Mixture, Array]:
        components = Mixture(log_weight, mean, cov)
        return gaussians.reduce(components, size, 0.0, threshold)

    shared = None if mean.ndim == 2 else 0
    kept, lost = jax.vmap(in_mode, (0, shared, shared))(pruned, mean, cov)
    weight = jnp.exp(jax.vmap(gaussians.total)(kept.log_weight))
    return Belief(*kept, lost=(weight * lost).sum())


def _moments(belief: Belief) -> Gaussian:
    flat = (x.reshape(-1, *x.shape[2:]) for x in belief[:3])
    return gaussians.collapse(Mixture(*flat))


def _prob(model: Any, belief: Belief, interval: Array | float = 0.0) -> Array:
    """Evaluates a probability in every component, at its mean: [M, N]."""
    modes = jnp.arange(belief.mean.shape[0])
    per_mode = jax.vmap(model.prob, (None, 0, None))
    return jax.vmap(per_mode, (0, 0, None))(modes, belief.mean, interval)


def _reweight(belief: Belief, log_factor: Array) -> Belief:
    return belief._replace(log_weight=belief.log_weight + log_factor)


def _normalised(belief: Belief) -> Belief:
    flat = gaussians.log_normalise(belief.log_weight.ravel())
    return belief._replace(log_weight=flat.reshape(belief.log_weight.shape))


def _gaussians(belief: Belief) -> Gaussian:
    return Gaussian(belief.mean, belief.cov)
