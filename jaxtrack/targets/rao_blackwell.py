"""A target whose belief is particles of modes, each with a Kalman filter: RBPF.

Only the sequence of modes is drawn; given the sequence the state is Gaussian, if motion
and sensor are linear, and a Kalman filter follows it. With nonlinear ones each particle
has an extended, unscented or cubature filter. Compared with `targets.particles` a few
dozen particles do. Where it is uncertain which detection was the target's, each
particle draws one, or none.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import models
    >>> from jaxtrack.targets import rao_blackwell
    >>> from jaxtrack.types import Gaussian
    >>> params = rao_blackwell.Params(
    ...     motions=(models.motion.ConstantVelocity(jnp.ones(1)),),
    ...     switching=models.switching.MarkovSwitching(jnp.ones((1, 1))),
    ...     sensor=models.sensor.Position(noise_std=jnp.ones(1)),
    ...     survive=models.probability.Constant(jnp.array(0.99)),
    ...     detect=models.probability.Constant(jnp.array(0.9)),
    ... )
    >>> target = rao_blackwell.rao_blackwell(max_particles=3)
    >>> prior = Gaussian(jnp.zeros(2), jnp.eye(2))
    >>> belief = target.begin(params, prior, jnp.ones(1), jax.random.key(0))
    >>> belief, _ = target.predict(params, belief, jnp.array(1.0))
    >>> belief = target.correct(params, target.look(params, belief), jnp.array([1.0]))
    >>> print(f"{target.moments(belief).mean[0]:.3f}")  # a mode alone: exact
    0.700

References: Doucet, Gordon and Krishnamurthy, "Particle filters for state estimation of
jump Markov linear systems", IEEE Trans. Signal Processing 49(3), 2001; Sarkka, Vehtari
and Lampinen, "Rao-Blackwellized particle filter for multiple target tracking",
Information Fusion 8(1), 2007 (drawing the detection).
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import kalman, linearize, mixture, particle, resampling
from jaxtrack.linalg import safe_log
from jaxtrack.linearize import Method
from jaxtrack.resampling import Scheme
from jaxtrack.targets import blending, cloud_motion, clouds, gauge, verbs, views
from jaxtrack.targets.cloud_motion import ModeProposal
from jaxtrack.targets.clouds import Belief
from jaxtrack.targets.imm import Params
from jaxtrack.types import Array, Gaussian, Mixture, Target

__all__ = ["Params", "View", "rao_blackwell"]


class View(NamedTuple):
    """A belief as the sensor sees it.

    Attributes:
        belief: L particles.
        log_detect: Log-probability to detect each, at its mean, [L].
        parts: [L, ...].
    """

    belief: Belief
    log_detect: Array
    parts: views.View


class Settings(NamedTuple):
    """The maker's arguments."""

    max_particles: int
    method: Method
    scheme: Scheme
    ess_threshold: float
    mode_proposal: ModeProposal | None


@functools.cache
def rao_blackwell(
    max_particles: int = 50,
    method: Method = linearize.taylor,
    scheme: Scheme = resampling.systematic,
    ess_threshold: float = 0.5,
    mode_proposal: ModeProposal | None = None,
) -> Target:
    """Makes a target whose belief is a `clouds.Belief` that carries covariances.

    Args:
        max_particles: How many sequences of modes are followed.
        method: `linearize.taylor`, `unscented` or `cubature`; idle where the models
            are linear.
        scheme: Of `resampling`.
        ess_threshold: Share of the particles that the effective sample size must reach
            or they are resampled.
        mode_proposal: See `targets.particles.particles`.

    Raises:
        ValueError: A size or threshold that makes no sense.
    """
    if max_particles < 1:
        raise ValueError(f"max_particles is {max_particles}; give at least 1")
    clouds.check(ess_threshold)
    settings = Settings(max_particles, method, scheme, ess_threshold, mode_proposal)
    correct = functools.partial(_correct, method)
    collapse = functools.partial(_collapse, scheme)
    return Target(
        begin=functools.partial(_begin, max_particles),
        predict=functools.partial(_predict, settings),
        miss=_miss,
        look=functools.partial(_look, method),
        score=functools.partial(_score, method),
        distance=functools.partial(_distance, method),
        correct=correct,
        collapse=collapse,
        absorb=verbs.absorb(correct, collapse),
        blend=functools.partial(_blend, method),
        adapt=verbs.unchanged,
        moments=_moments,
        parts=_parts,
        modes=lambda belief: particle.mode_prob(belief.particles, len(belief.root)),
        lost=lambda belief: jnp.zeros((), belief.state.dtype),
        effective_size=lambda belief: belief.effective_size,
    )


def _begin(
    size: int, params: Params, prior: Gaussian, mode_prob: Array, key: Array
) -> Belief:
    del params
    following, keys = clouds.split(clouds.numbers(key), 1)
    mode = resampling.systematic_index(keys[0], safe_log(mode_prob), size, size)
    dim, dtype = prior.mean.size, prior.mean.dtype
    return Belief(
        log_weight=resampling.even(jnp.ones(size, bool), dtype),
        state=jnp.broadcast_to(prior.mean, (size, dim)),
        mode=mode,
        carried=jnp.broadcast_to(prior.cov.ravel(), (size, dim * dim)),
        root=jnp.zeros((mode_prob.size, dim, dim), dtype),
        distinct=jnp.ones((), dtype),
        num=jnp.full((), size, jnp.int32),
        key=following,
    )


def _predict(
    settings: Settings, params: Params, belief: Belief, interval: Array
) -> tuple[Belief, Array]:
    following, keys = clouds.split(belief.key, 2)
    survive = clouds.prob(params.survive, belief, interval)
    belief, log_survive = clouds.reweighted(belief, safe_log(survive))
    belief = clouds.renewed(settings.scheme, settings.ess_threshold, belief, keys[0])
    belief = cloud_motion.switch(
        settings.mode_proposal, params, belief, interval, keys[1]
    )

    def move(motion: Any, one: Gaussian) -> Gaussian:
        affine = linearize.motion_affine(motion, one, interval, settings.method)
        return kalman.predict(one, affine)

    # Mode by mode, since each motion knows other zeros.
    every = [
        jax.vmap(functools.partial(move, motion))(_gaussians(belief))
        for motion in params.motions
    ]
    moved = jax.tree.map(lambda *x: particle.pick(x, belief.mode), *every)
    belief = belief._replace(distinct=jnp.ones_like(belief.distinct), key=following)
    return _with(belief, moved), log_survive


def _miss(params: Params, belief: Belief) -> tuple[Belief, Array]:
    log_miss = safe_log(1 - clouds.prob(params.detect, belief))
    missed, log_prob = clouds.reweighted(belief, log_miss)
    return missed._replace(key=clouds.fold(belief.key, clouds.MISSED)), log_prob


def _look(method: Method, params: Params, belief: Belief) -> View:
    log_detect = safe_log(clouds.prob(params.detect, belief))
    look = functools.partial(views.look, method, params)
    return View(belief, log_detect, jax.vmap(look)(_gaussians(belief)))


def _score(method: Method, params: Params, view: View, detections: Array) -> Array:
    log_factor = _log_factor(method, params, view, detections)
    log_joint = view.belief.log_weight[:, None] + log_factor
    return mixture.total(log_joint)


def _log_factor(method: Method, params: Params, view: View, detections: Array) -> Array:
    """Returns what detections [K, Z] multiply the weights by, in logarithms, [L, K]."""
    score = functools.partial(views.score, method, params)
    return view.log_detect[:, None] + jax.vmap(score, (0, None))(view.parts, detections)


def _distance(
    method: Method, params: Params, view: View, detections: Array
) -> tuple[Array, Array]:
    weight = mixture.normalise(view.belief.log_weight + view.log_detect)
    return gauge.distance("mixture", method, params, weight, view.parts, detections)


def _correct(method: Method, params: Params, view: View, detection: Array) -> Belief:
    correct = functools.partial(views.correct, method, params)
    moved, log_density = jax.vmap(correct, (0, None))(view.parts, detection)
    belief, _ = clouds.reweighted(view.belief, view.log_detect + log_density)
    return _with(belief, moved)._replace(key=clouds.fold(belief.key, detection))


def _blend(
    method: Method,
    params: Params,
    view: View,
    missed: Belief,
    log_weight: Array,
    detections: Array,
) -> Belief:
    """Draws for each particle which detection was its own, or none."""
    base = clouds.fold(view.belief.key, clouds.BLENDED)
    following, keys = clouds.split(base, 1)
    log_factor = _log_factor(method, params, view, detections)
    reweight = functools.partial(particle.reweight, view.belief.log_weight)
    each = jax.vmap(reweight, 1)(log_factor)[0]  # [K, L]
    each = jnp.concatenate([each, missed.log_weight[None]])
    each = blending.shares(log_weight)[:, None] + each
    choice, own = clouds.choose(keys[0], detections, each, view.belief.key)
    correct = functools.partial(views.correct, method, params)
    hit, _ = jax.vmap(correct)(view.parts, own)
    none = choice == len(detections)
    belief = _with(missed, hit)
    belief = belief._replace(
        log_weight=mixture.total(each),
        state=jnp.where(none[:, None], missed.state, belief.state),
        carried=jnp.where(none[:, None], missed.carried, belief.carried),
        key=following,
    )
    return clouds.reweighted(belief, jnp.zeros_like(belief.log_weight))[0]


def _collapse(scheme: Scheme, log_weight: Array, beliefs: Belief) -> Belief:
    key = clouds.fold(beliefs.key[jnp.argmax(log_weight)], clouds.COLLAPSED)
    unchanged = jnp.zeros_like(beliefs.log_weight)
    return clouds.one_of(scheme, log_weight, beliefs, unchanged, key)


def _moments(belief: Belief) -> Gaussian:
    return mixture.collapse(_parts(belief))


def _parts(belief: Belief) -> Mixture:
    return Mixture(belief.log_weight, *_gaussians(belief))


def _gaussians(belief: Belief) -> Gaussian:
    """Returns what each particle knows of the state: mean [L, D], cov [L, D, D]."""
    size, dim = belief.state.shape
    return Gaussian(belief.state, jnp.reshape(belief.carried, (size, dim, dim)))


def _with(belief: Belief, gaussians: Gaussian) -> Belief:
    flat = gaussians.cov.reshape(len(gaussians.mean), -1)
    return belief._replace(state=gaussians.mean, carried=flat)
