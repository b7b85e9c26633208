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
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack import kalman, linearize
from jaxtrack import mixture as gaussians
from jaxtrack.linalg import safe_log
from jaxtrack.models.sensor import untimed
from jaxtrack.targets import components
from jaxtrack.targets.imm import Params
from jaxtrack.types import Affine, Array, Gaussian, Mixture, Target

__all__ = ["Params", "mixture"]


@functools.cache
def mixture(
    max_components: int = 10,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 4.0,
    max_candidates: int | None = None,
    method: linearize.Method = linearize.taylor,
) -> Target:
    """Makes a target whose belief is a jump Markov Gaussian mixture.

    Args:
        max_components: Components that each mode keeps.
        prune_threshold: Components with a smaller share of the whole weight go.
        merge_threshold: Squared Mahalanobis distance within which components merge.
        max_candidates: Components of a mode that `absorb` corrects and merges, the
            heaviest; by default three times `max_components`.
        method: `linearize.taylor`, `unscented` or `cubature`; idle where the models
            are linear.

    Raises:
        ValueError: A size or threshold that makes no sense.
    """
    candidates = 3 * max_components if max_candidates is None else max_candidates
    reduction = components.Reduction(
        max_components, prune_threshold, merge_threshold, candidates
    )
    components.check(reduction)
    return Target(
        begin=functools.partial(_begin, reduction),
        predict=functools.partial(_predict, reduction, method),
        miss=_miss,
        score=functools.partial(_score, method),
        correct=functools.partial(_correct, method),
        collapse=functools.partial(components.collapse, reduction),
        absorb=functools.partial(_absorb, reduction, method),
        moments=components.moments,
        modes=lambda belief: gaussians.normalise(
            jax.vmap(gaussians.total)(belief.log_weight)
        ),
        lost=lambda belief: belief.lost,
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

    def linearised(motion: Any, component: Gaussian) -> Affine:
        return linearize.motion_affine(motion, component, interval, method)

    motions = [
        jax.vmap(functools.partial(linearised, motion))(Gaussian(mean, cov))
        for motion, mean, cov in zip(params.motions, mixed.mean, mixed.cov, strict=True)
    ]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *motions)
    moved = jax.vmap(jax.vmap(kalman.predict))(Gaussian(mixed.mean, mixed.cov), stacked)
    return mixed._replace(mean=moved.mean, cov=moved.cov), log_survive


def _miss(params: Params, belief: components.Belief) -> tuple[components.Belief, Array]:
    detect = _prob(params.detect, belief)
    missed = components.reweight(belief, safe_log(1 - detect))
    return components.normalised(missed), gaussians.total(missed.log_weight.ravel())


def _score(
    method: linearize.Method,
    params: Params,
    belief: components.Belief,
    detections: Array,
) -> Array:
    weigh = functools.partial(_weigh, method, params, belief)
    return jax.vmap(lambda z: gaussians.total(weigh(z).ravel()))(detections)


def _weigh(
    method: linearize.Method,
    params: Params,
    belief: components.Belief,
    detection: Array,
) -> Array:
    """Returns each component's log-weight times its likelihood of the detection."""
    sensor, plain = untimed(params.sensor, detection)

    def in_component(component: Gaussian) -> Array:
        affine = linearize.sensor_affine(sensor, params.layout, component, method)
        return kalman.log_density(component, affine, plain, sensor.residual)

    log_density = jax.vmap(jax.vmap(in_component))(Gaussian(belief.mean, belief.cov))
    log_detect = safe_log(_prob(params.detect, belief))
    return belief.log_weight + log_detect + log_density


def _correct(
    method: linearize.Method,
    params: Params,
    belief: components.Belief,
    detection: Array,
) -> components.Belief:
    weighed = _weigh(method, params, belief, detection)
    mean, cov = _condition(method, params, Gaussian(belief.mean, belief.cov), detection)
    return components.normalised(components.Belief(weighed, mean, cov, belief.lost))


def _condition(
    method: linearize.Method, params: Params, prior: Gaussian, detection: Array
) -> Gaussian:
    """Conditions Gaussians [M, N] on a detection, each for itself."""
    sensor, plain = untimed(params.sensor, detection)

    def in_component(component: Gaussian) -> Gaussian:
        affine = linearize.sensor_affine(sensor, params.layout, component, method)
        return kalman.update(component, affine, plain, sensor.residual)[0]

    return jax.vmap(jax.vmap(in_component))(prior)


def _absorb(
    reduction: components.Reduction,
    method: linearize.Method,
    params: Params,
    log_weight: Array,
    beliefs: components.Belief,
    detection: Array,
) -> components.Belief:
    """Collapses the corrected beliefs; only the heaviest components are corrected."""
    weigh = functools.partial(_weigh, method, params)
    weighed = jax.vmap(weigh, (0, None))(beliefs, detection)
    posterior = jax.vmap(components.normalised)(beliefs._replace(log_weight=weighed))
    share, pooled = components.pool(log_weight, posterior)

    def candidates(log_weight: Array, mean: Array, cov: Array) -> tuple[Mixture, Array]:
        size = min(reduction.max_candidates, log_weight.size)
        return gaussians.cap(Mixture(log_weight, mean, cov), size)

    chosen, left = jax.vmap(candidates)(*pooled)
    mode_prob = jnp.exp(jax.vmap(gaussians.total)(pooled.log_weight))
    mean, cov = _condition(method, params, Gaussian(chosen.mean, chosen.cov), detection)
    reduced = components.reduce(reduction, chosen.log_weight, mean, cov)
    earlier = (share * beliefs.lost).sum() + (mode_prob * left).sum()
    return components.lose(reduced, earlier)


def _prob(
    model: Any, belief: components.Belief, interval: Array | float = 0.0
) -> Array:
    """Evaluates a probability in every component, at its mean: [M, N]."""
    modes = jnp.arange(belief.mean.shape[0])
    per_mode = jax.vmap(model.prob, (None, 0, None))
    return jax.vmap(per_mode, (0, 0, None))(modes, belief.mean, interval)
