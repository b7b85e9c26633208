"""Metropolis-Hastings moves of particles over their last motion.

Resampling makes copies of the good particles. A move draws for each another end of its
last motion, from the motion's own noise, and takes it with the ratio of how well the
two explain the detection, so that copies part and the posterior stays as it is.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import models
    >>> from jaxtrack.targets import particles
    >>> target = particles.particles(max_particles=100, num_moves=2)
    >>> target is particles.particles(max_particles=100, num_moves=2)
    True

References: Gilks and Berzuini, "Following a moving target: Monte Carlo inference for
dynamic Bayesian models", J. Royal Statistical Society B 63(1), 2001; Yuan 2013, the
note below equation 24.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack import mixture, particle
from jaxtrack.linalg import safe_log
from jaxtrack.resampling import Scheme
from jaxtrack.targets import blending, cloud_motion, cloud_views, clouds
from jaxtrack.targets.cloud_views import View
from jaxtrack.targets.clouds import Belief
from jaxtrack.types import Array


def moved(
    num_moves: int,
    scheme: Scheme,
    threshold: float,
    log_likelihood: Callable[[Belief], Array],
    belief: Belief,
) -> Belief:
    """Resamples where needed, then moves every particle some times.

    Args:
        num_moves: How often.
        scheme: Of `resampling`.
        threshold: Share of the particles that the effective size must reach.
        log_likelihood: Of what was seen in the scan, given each particle, [L].
        belief: L particles, with the centres and the factors of their last noise.
    """
    following, keys = clouds.split(belief.key, num_moves + 1)
    belief = clouds.renewed(scheme, threshold, belief, keys[0])
    centre = belief.state if belief.carried is None else belief.carried
    shape, dtype = belief.state.shape, belief.state.dtype

    def propose(key: Array) -> Array:
        noise = jax.random.normal(key, shape, dtype)
        return centre + cloud_motion.push(list(belief.root), belief.mode, noise)

    def likelihood(state: Array) -> Array:
        return log_likelihood(belief._replace(state=state))

    def step(state: Array, key: Array) -> tuple[Array, None]:
        return particle.move(key, state, propose, likelihood)[0], None

    state, _ = jax.lax.scan(step, belief.state, keys[1:])
    return belief._replace(state=state, key=following)


def correct(
    weigh: Callable[[Any, View, Array], Belief],
    num_moves: int,
    scheme: Scheme,
    threshold: float,
    params: Any,
    view: View,
    detection: Array,
) -> Belief:
    """Weighs the particles by a detection, resamples and moves them.

    Args:
        weigh: The verb `correct` without moves.
        num_moves: See `moved`.
        scheme: See `moved`.
        threshold: See `moved`.
        params: A target's `Params`.
        view: The belief as the sensor sees it.
        detection: [Z].
    """

    def log_likelihood(belief: Belief) -> Array:
        view = cloud_views.look(params, belief)
        return cloud_views.log_factor(params, view, detection)

    weighed = weigh(params, view, detection)
    return moved(num_moves, scheme, threshold, log_likelihood, weighed)


def blend(
    weigh: Callable[[Any, View, Belief, Array, Array], Belief],
    num_moves: int,
    scheme: Scheme,
    threshold: float,
    params: Any,
    view: View,
    missed: Belief,
    log_weight: Array,
    detections: Array,
) -> Belief:
    """Weighs the particles by an uncertain detection, resamples and moves them.

    What explains the scan is a sum over the detections and none, each scaled as it is
    for the particles before the moves.
    """
    log_share = blending.shares(log_weight)
    score = cloud_views.score(params, view, detections)
    log_miss = safe_log(1 - clouds.prob(params.detect, view.belief))
    log_scale = jnp.append(score, mixture.total(view.belief.log_weight + log_miss))
    known = log_scale > -jnp.inf
    log_each = jnp.where(known, log_share - jnp.where(known, log_scale, 0.0), -jnp.inf)

    def log_likelihood(belief: Belief) -> Array:
        view = cloud_views.look(params, belief)
        factor = jax.vmap(cloud_views.log_factor, (None, None, 0))
        hit = factor(params, view, detections)
        missed = safe_log(1 - clouds.prob(params.detect, belief))
        every = jnp.concatenate([hit, missed[None]]) + log_each[:, None]
        return mixture.total(every)

    weighed = weigh(params, view, missed, log_weight, detections)
    return moved(num_moves, scheme, threshold, log_likelihood, weighed)
