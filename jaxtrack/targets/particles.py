"""A target whose belief is a set of weighted particles with modes: SMC.

It takes any motions, also nonlinear ones with noise of low rank, any sensor, and
probabilities of survival and detection that depend on the state. With one mode it is
the bootstrap filter.

A belief is resampled at the start of a prediction, where it needs to be, and where
several become one; what a scan teaches only changes weights, exactly, and estimates are
taken before anything is drawn.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import models, targets, types
    >>> params = targets.particles.Params(
    ...     motions=(models.motion.ConstantVelocity(jnp.ones(1)),),
    ...     switching=models.switching.MarkovSwitching(jnp.ones((1, 1))),
    ...     sensor=models.sensor.Position(noise_std=jnp.ones(1)),
    ...     survive=models.probability.Constant(jnp.array(0.99)),
    ...     detect=models.probability.Constant(jnp.array(0.9)),
    ... )
    >>> target = targets.particles.particles(max_particles=500)
    >>> prior = types.Gaussian(jnp.zeros(2), jnp.eye(2))
    >>> def mean(key):
    ...     belief = target.begin(params, prior, jnp.ones(1), key)
    ...     belief, _ = target.predict(params, belief, jnp.array(1.0))
    ...     view = target.look(params, belief)
    ...     return target.moments(target.correct(params, view, jnp.ones(1))).mean
    >>> print(f"{jax.jit(mean)(jax.random.key(0))[0]:.1f}")  # exactly 0.7
    0.7

Reference: Yuan, Lian and Han, "Multiple-model cardinality balanced multitarget
multi-Bernoulli filter for tracking maneuvering targets", 2013, equations 14 to 24.
Unlike equation 15, weights h / alpha of a mode proposal are scaled to sum to one: their
expected sum is known to be one, and a probability to survive stays one.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg, mixture, particle, resampling
from jaxtrack.entries import dense
from jaxtrack.linalg import safe_log
from jaxtrack.linearize import Method
from jaxtrack.resampling import Scheme
from jaxtrack.targets import (
    blending,
    cloud_motion,
    cloud_moves,
    cloud_proposals,
    cloud_views,
    clouds,
    verbs,
)
from jaxtrack.targets.cloud_motion import ModeProposal
from jaxtrack.targets.cloud_views import View
from jaxtrack.targets.clouds import Belief
from jaxtrack.targets.imm import Params
from jaxtrack.types import Array, Gaussian, Target

__all__ = ["Params", "particles"]


class Settings(NamedTuple):
    """The maker's arguments."""

    max_particles: int
    min_particles: int
    scheme: Scheme
    ess_threshold: float
    regularise: bool
    num_moves: int
    proposal: Method | None
    mode_proposal: ModeProposal | None


@functools.cache
def particles(
    max_particles: int = 1000,
    min_particles: int | None = None,
    scheme: Scheme = resampling.systematic,
    ess_threshold: float = 0.5,
    regularise: bool = False,
    num_moves: int = 0,
    proposal: Method | None = None,
    mode_proposal: ModeProposal | None = None,
) -> Target:
    """Makes a target whose belief is a `clouds.Belief` of weighted particles.

    Args:
        max_particles: Particles of a track that exists for sure.
        min_particles: Particles of the least likely track; between, their number goes
            with the probability that the track exists. By default all have the same.
        scheme: Of `resampling`.
        ess_threshold: Share of the particles that the effective sample size must reach
            or they are resampled; with 1 they are before every motion.
        regularise: Whether to move resampled particles apart by a Gaussian kernel; for
            motions with little noise. Biased where a mode's cloud is not Gaussian.
        num_moves: Metropolis-Hastings moves of each particle after a detection, over
            the last motion; see `cloud_moves`. Then particles are resampled first.
        proposal: `linearize.taylor`, `unscented` or `cubature`: particles are drawn
            given the detection, by an extended, unscented or cubature Kalman filter
            each; see `cloud_proposals`. By default they are drawn from the motion.
        mode_proposal: log h [M, M] -> log alpha [M, M], rows on any scale: how modes
            are drawn, so that rare ones get particles. Finite where log h is. By
            default alpha is h.

    Raises:
        ValueError: A size or threshold that makes no sense.
    """
    least = max_particles if min_particles is None else min_particles
    if not 1 <= least <= max_particles:
        raise ValueError(
            f"min_particles is {least} and max_particles is {max_particles}; give at "
            "least 1, and max_particles no less than min_particles"
        )
    clouds.check(ess_threshold)
    if num_moves < 0 or (num_moves > 0 and proposal is not None):
        message = f"num_moves is {num_moves}; give 0 or more, and 0 with a proposal"
        raise ValueError(message)
    settings = Settings(
        *(max_particles, least, scheme, ess_threshold),
        *(regularise, num_moves, proposal, mode_proposal),
    )
    return _made(settings)


def _made(settings: Settings) -> Target:
    collapse = functools.partial(_collapse, settings)
    plain = Target(
        begin=functools.partial(_begin, settings),
        predict=functools.partial(_predict, settings),
        miss=_miss,
        look=cloud_views.look,
        score=cloud_views.score,
        distance=cloud_views.distance,
        correct=_correct,
        collapse=collapse,
        absorb=functools.partial(_absorb, settings),
        blend=_blend,
        adapt=functools.partial(_adapt, settings),
        moments=lambda belief: particle.moments(belief.particles),
        parts=cloud_proposals.parts if settings.proposal else clouds.parts,
        modes=lambda belief: particle.mode_prob(belief.particles, len(belief.root)),
        lost=lambda belief: jnp.zeros((), belief.state.dtype),
        effective_size=lambda belief: belief.effective_size,
    )
    if settings.num_moves:
        how = settings.num_moves, settings.scheme, settings.ess_threshold
        correct = functools.partial(cloud_moves.correct, _correct, *how)
        return plain._replace(
            correct=correct,
            absorb=verbs.absorb(correct, collapse),
            blend=functools.partial(cloud_moves.blend, _blend, *how),
        )
    if settings.proposal is not None:
        correct = functools.partial(cloud_proposals.correct, settings.proposal)
        return plain._replace(
            look=functools.partial(cloud_proposals.look, settings.proposal),
            score=functools.partial(cloud_proposals.score, settings.proposal),
            distance=functools.partial(cloud_proposals.distance, settings.proposal),
            correct=correct,
            absorb=verbs.absorb(correct, collapse),
            blend=functools.partial(cloud_proposals.blend, settings.proposal),
            moments=cloud_proposals.moments,
        )
    return plain


def _begin(
    settings: Settings, params: Params, prior: Gaussian, mode_prob: Array, key: Array
) -> Belief:
    """Draws states and modes, the modes in strata (equations 18 and 19)."""
    del params
    size, dtype = settings.max_particles, prior.mean.dtype
    following, keys = clouds.split(clouds.numbers(key), 2)
    mode = resampling.systematic_index(keys[0], safe_log(mode_prob), size, size)
    centre = jnp.broadcast_to(prior.mean, (size, prior.mean.size))
    root = dense(linalg.root(prior.cov))
    belief = Belief(
        log_weight=resampling.even(jnp.ones(size, bool), dtype),
        state=centre,
        mode=mode,
        carried=centre if settings.num_moves else None,
        root=jnp.broadcast_to(root, (mode_prob.size, *root.shape)),
        distinct=jnp.ones((), dtype),
        num=jnp.full((), size, jnp.int32),
        key=following,
    )
    return _drawn(settings, belief, [root] * mode_prob.size, keys[1])


def _drawn(
    settings: Settings, belief: Belief, roots: Sequence[Any], key: Array
) -> Belief:
    """Draws the noise of the last motion now, or keeps its factors for later."""
    root = jnp.stack([dense(x) for x in roots]).astype(belief.root.dtype)
    if settings.proposal is not None:
        return belief._replace(root=root)
    noise = particle.normals(key, belief.state)
    state = belief.state + cloud_motion.push(roots, belief.mode, noise)
    if settings.num_moves:
        return belief._replace(state=state, carried=belief.state, root=root)
    return belief._replace(state=state, root=jnp.zeros_like(root))


def _predict(
    settings: Settings, params: Params, belief: Belief, interval: Array
) -> tuple[Belief, Array]:
    """Equations 15 to 17: survive, resample where needed, switch, move."""
    following, keys = clouds.split(belief.key, 5)
    if settings.proposal is not None:
        belief = cloud_proposals.settle(keys[4], belief)
    # A pool of several beliefs may have been drawn from few particles before.
    few = belief.effective_size < settings.ess_threshold * belief.num
    survive = clouds.prob(params.survive, belief, interval)
    belief, log_survive = clouds.reweighted(belief, safe_log(survive))
    few = few | (belief.effective_size < settings.ess_threshold * belief.num)
    belief = clouds.renewed(settings.scheme, settings.ess_threshold, belief, keys[0])
    if settings.regularise:
        apart = particle.regularise(keys[1], belief.particles, len(params.motions))
        belief = belief._replace(state=jnp.where(few, apart.state, belief.state))
    belief = cloud_motion.switch(
        settings.mode_proposal, params, belief, interval, keys[2]
    )
    belief = belief._replace(state=cloud_motion.move(params, belief, interval))
    belief = _drawn(settings, belief, cloud_motion.roots(params, interval), keys[3])
    one = jnp.ones_like(belief.distinct)
    return belief._replace(distinct=one, key=following), log_survive


def _miss(params: Params, belief: Belief) -> tuple[Belief, Array]:
    log_miss = safe_log(1 - clouds.prob(params.detect, belief))
    missed, log_prob = clouds.reweighted(belief, log_miss)
    return missed._replace(key=clouds.fold(belief.key, clouds.MISSED)), log_prob


def _correct(params: Params, view: View, detection: Array) -> Belief:
    log_factor = cloud_views.log_factor(params, view, detection)
    corrected, _ = clouds.reweighted(view.belief, log_factor)
    return corrected._replace(key=clouds.fold(view.belief.key, detection))


def _absorb(
    settings: Settings, params: Params, log_weight: Array, views: View, detection: Array
) -> Belief:
    """Pools the particles of all views; the likeliest view's key goes on."""
    each = jax.vmap(cloud_views.log_factor, (None, 0, None))(params, views, detection)
    key = views.belief.key[jnp.argmax(log_weight)]
    key = clouds.fold(key, detection)
    return clouds.one_of(settings.scheme, log_weight, views.belief, each, key)


def _collapse(settings: Settings, log_weight: Array, beliefs: Belief) -> Belief:
    key = clouds.fold(beliefs.key[jnp.argmax(log_weight)], clouds.COLLAPSED)
    if settings.proposal is not None:
        beliefs = jax.vmap(_settled)(beliefs)
    unchanged = jnp.zeros_like(beliefs.log_weight)
    return clouds.one_of(settings.scheme, log_weight, beliefs, unchanged, key)


def _blend(
    params: Params,
    view: View,
    missed: Belief,
    log_weight: Array,
    detections: Array,
) -> Belief:
    """Reweights each particle by all that may have been its own."""
    share = jnp.exp(blending.shares(log_weight))

    def one(detection: Array) -> Array:
        log_factor = cloud_views.log_factor(params, view, detection)
        return jnp.exp(particle.reweight(view.belief.log_weight, log_factor)[0])

    each = jax.vmap(one)(detections)
    weight = share[:-1] @ each + share[-1] * jnp.exp(missed.log_weight)
    log_new = mixture.log_normalise(safe_log(weight))
    return missed._replace(
        log_weight=log_new,
        key=clouds.fold(view.belief.key, clouds.BLENDED),
    )


def _adapt(
    settings: Settings, params: Params, belief: Belief, existence_prob: Array
) -> Belief:
    del params
    if settings.min_particles == settings.max_particles:
        return belief
    num = jnp.round(existence_prob * settings.max_particles).astype(jnp.int32)
    num = jnp.clip(num, settings.min_particles, settings.max_particles)
    return belief._replace(num=num)


def _settled(belief: Belief) -> Belief:
    key = clouds.split(clouds.fold(belief.key, clouds.COLLAPSED), 2)[1][1]
    return cloud_proposals.settle(key, belief)
