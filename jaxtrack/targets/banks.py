"""A bank of modes, one Gaussian each: what targets with several modes share.

A bank is a `Mixture` with one component per mode. Not all modes need be active: those
that are not are moved and corrected like the others, and their weights are on the same
scale, but they do not count in what is told to a tracker. `log_active` [M] is 0 for the
modes that count and -inf for those that do not, or the log of something in between.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.targets import banks
    >>> from jaxtrack.types import Gaussian
    >>> prior = Gaussian(jnp.zeros(2), jnp.eye(2))
    >>> banks.begin(prior, jnp.array([0.5, 0.25, 0.25])).mean.shape
    (3, 2)

Reference: Blom and Bar-Shalom 1988, see `jaxtrack.imm`.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack import imm, linearize, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.targets import blending, gauge, views
from jaxtrack.types import Array, Gaussian, Mixture


def begin(prior: Gaussian, mode_prob: Array) -> Mixture:
    """Returns a bank whose modes differ only in their probabilities [M]."""
    size = mode_prob.size
    mean = jnp.broadcast_to(prior.mean[None], (size, *prior.mean.shape))
    cov = jnp.broadcast_to(prior.cov[None], (size, *prior.cov.shape))
    return Mixture(safe_log(mode_prob), mean, cov)


def predict(
    method: linearize.Method, params: Any, bank: Mixture, interval: Array
) -> tuple[Mixture, Array]:
    """Mixes the modes of those who survived, and moves each by its own motion.

    Args:
        method: Of `linearize`.
        params: A target's `Params`, with M motions.
        bank: Its weights sum to one, [M].
        interval: Seconds.

    Returns:
        The bank, weights summing to one, and the log-probability to survive.
    """
    survive = prob(params.survive, bank, interval)
    alive = bank.log_weight + safe_log(survive)
    log_transition = params.switching.log_transition(interval)
    normal = bank._replace(log_weight=mixture.log_normalise(alive))
    mixed = imm.mix(normal, log_transition)
    motions = [
        linearize.motion_affine(motion, Gaussian(mean, cov), interval, method)
        for motion, mean, cov in zip(params.motions, mixed.mean, mixed.cov, strict=True)
    ]
    return imm.predict(mixed, motions), mixture.total(alive)


def miss(params: Any, bank: Mixture, log_active: Array) -> tuple[Mixture, Array]:
    """Weighs the modes by their chance of a miss; returns the log of that of all."""
    log_miss = safe_log(1 - prob(params.detect, bank))
    missed = bank.log_weight + log_miss
    log_prob = mixture.total(missed + log_active)
    # Where no mode can be missed, a miss says nothing of the mode.
    missed = jnp.where(log_prob > -jnp.inf, missed, bank.log_weight)
    log_normal = blending.log_normalise(missed, log_active)
    return bank._replace(log_weight=log_normal), log_prob


def look(
    method: linearize.Method, params: Any, bank: Mixture, log_active: Array
) -> blending.View:
    """Looks at every mode through the sensor."""
    log_detect = safe_log(prob(params.detect, bank))
    look = functools.partial(views.look, method, params)
    modes = jax.vmap(look)(Gaussian(bank.mean, bank.cov))
    return blending.View(bank.log_weight + log_detect, modes, log_active)


def score(
    method: linearize.Method, params: Any, view: blending.View, detections: Array
) -> Array:
    """Returns the log-densities of detections [K, Z] under the active modes, [K]."""
    score = functools.partial(views.score, method, params)
    log_density = jax.vmap(score, (0, None))(view.modes, detections)  # [M, K]
    log_weight = view.log_weight + view.log_active
    return mixture.total(log_weight[:, None] + log_density)


def distance(
    yardstick: gauge.Yardstick,
    method: linearize.Method,
    params: Any,
    view: blending.View,
    detections: Array,
) -> tuple[Array, Array]:
    """Measures how far detections are from the active modes; see `gauge.distance`."""
    weight = mixture.normalise(view.log_weight + view.log_active)
    return gauge.distance(yardstick, method, params, weight, view.modes, detections)


def correct(
    method: linearize.Method, params: Any, view: blending.View, detection: Array
) -> Mixture:
    """Conditions every mode on a detection [Z], and reweights it by its likelihood."""
    correct = functools.partial(views.correct, method, params)
    moved, log_density = jax.vmap(correct, (0, None))(view.modes, detection)
    log_weight = view.log_weight + log_density
    log_normal = blending.log_normalise(log_weight, view.log_active)
    return Mixture(log_normal, moved.mean, moved.cov)


def prob(model: Any, bank: Mixture, interval: Array | float = 0.0) -> Array:
    """Evaluates a probability in every mode, at its mean: [M]."""
    modes = jnp.arange(bank.log_weight.size)
    return jax.vmap(model.prob, (0, 0, None))(modes, bank.mean, interval)
