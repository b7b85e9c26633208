"""Smoothing a bank of modes: what is known later tells which mode it was.

The filter merges the modes that lead to mode j before it moves them, and so knows of
them only the merged belief; the smoother knows each. What later scans said of mode j is
the ratio of what is known of it then to what was predicted. Each belief that led there
is conditioned on that, as by a detection, and has more weight the better it fits:

    predicted -> later        the merged belief, by all that came afterwards
    belief -> revise(belief)  one of those that were merged, by the same
    smooth_step               back before the motion

That is Kim's smoother where all fit equally well, as they do if they are equal; where
they are not, it is much nearer to what all sequences of modes together tell.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.targets import smoothing
    >>> from jaxtrack.types import Gaussian
    >>> predicted, later = Gaussian(jnp.zeros(1), 4 * jnp.eye(1)), Gaussian(
    ...     jnp.array([1.0]), 2 * jnp.eye(1))  # as if 2 had been seen with variance 4
    >>> one = Gaussian(jnp.array([-2.0]), 4 * jnp.eye(1))
    >>> revised, log_weight = smoothing.revise(one, predicted, later)
    >>> print(revised.mean.round(3), revised.cov.round(3))
    [0.] [[2.]]

References: Helmick, Blair and Hoffman, "Fixed-interval smoothing for Markovian
switching systems", IEEE Trans. Information Theory 41(6), 1995; Kim, "Dynamic linear
models with Markov-switching", Journal of Econometrics 60, 1994.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack import kalman, linalg, linearize, mixture
from jaxtrack.linalg import safe_log
from jaxtrack.targets import banks
from jaxtrack.types import Array, Gaussian, Mixture


def bank(
    method: linearize.Method,
    params: Any,
    bank: Mixture,
    later: Mixture,
    interval: Array,
) -> Mixture:
    """Tells by what is known one interval later how each mode was.

    Args:
        method: Of `linearize`.
        params: A target's `Params`, with M motions.
        bank: By the data until then; its weights sum to one, [M].
        later: One interval afterwards, by more data; its weights sum to one, [M].
        interval: Seconds.
    """
    survive = banks.prob(params.survive, bank, interval)
    alive = bank.log_weight + safe_log(survive)
    log_joint = alive[:, None] + params.switching.log_transition(interval)
    log_left = jax.vmap(mixture.log_normalise, 1)(log_joint)  # [entered, left]
    beliefs = Gaussian(bank.mean, bank.cov)
    back = functools.partial(_back, method, beliefs, interval)
    each = [
        back(motion, log_left[j], Gaussian(later.mean[j], later.cov[j]))
        for j, motion in enumerate(params.motions)
    ]
    log_share, smoothed = jax.tree.map(lambda *x: jnp.stack(x, 1), *each)
    log_pair = log_share + later.log_weight[None]  # [left, entered]
    weight = jax.vmap(mixture.normalise)(log_pair)
    merged = jax.vmap(mixture.moment_match)(weight, smoothed.mean, smoothed.cov)
    return Mixture(jax.vmap(mixture.total)(log_pair), merged.mean, merged.cov)


def _back(
    method: linearize.Method,
    beliefs: Gaussian,
    interval: Array,
    motion: Any,
    log_left: Array,
    later: Gaussian,
) -> tuple[Array, Gaussian]:
    """Carries a mode back to the M that were left for it.

    Args:
        method: Of `linearize`.
        beliefs: Before the motion, [M].
        interval: Seconds.
        motion: Of the mode that was entered.
        log_left: How likely each was left for it, by the data until then, [M].
        later: The mode that was entered, by more data.

    Returns:
        How likely each was left for it by more data, [M], and how it was.
    """
    prior = mixture.moment_match(jnp.exp(log_left), beliefs.mean, beliefs.cov)
    affine = linearize.motion_affine(motion, prior, interval, method)
    merged = kalman.predict(prior, affine)

    def one(belief: Gaussian) -> tuple[Array, Gaussian]:
        moved = kalman.predict(belief, affine)
        revised, log_weight = revise(moved, merged, later)
        return log_weight, kalman.smooth_step(belief, affine, moved, revised)

    log_weight, smoothed = jax.vmap(one)(beliefs)
    return mixture.log_normalise(log_left + log_weight), smoothed


def revise(
    belief: Gaussian, predicted: Gaussian, later: Gaussian
) -> tuple[Gaussian, Array]:
    """Conditions a belief on what turned another one into a third.

    That is the ratio of later to predicted. Where it cannot be had, because what is
    known later is in some direction less sure, the result is `later` itself.

    Args:
        belief: mean [D], cov [D, D].
        predicted: What was believed of all.
        later: What is known of all.

    Returns:
        The belief by what is known later, and its log-weight, up to a constant that is
        the same for any belief.
    """
    lower = linalg.cholesky(predicted.cov)

    def whiten(other: Gaussian) -> tuple[Array, Array]:
        half = linalg.solve_lower(lower, other.cov)
        mean = linalg.solve_lower(lower, other.mean - predicted.mean)
        return mean, linalg.symmetrize(linalg.solve_lower(lower, half.T))

    # With unit variance predicted, as by a detection of gain @ x with variance
    # 1 - gain.T @ gain: it moves the mean by `step` and takes gain @ gain.T away.
    (step, left), (mean, cov) = whiten(later), whiten(belief)
    unit = jnp.eye(len(mean), dtype=mean.dtype)
    gain = linalg.root(unit - left)
    rounding = 1e3 * jnp.finfo(mean.dtype).eps
    right = jnp.abs(gain @ gain.T + left - unit).max() < rounding
    gain = jnp.where(right, gain, 0.0)
    step = jnp.where(right, step, 0.0)

    wider = cov - unit
    factor = linalg.cholesky(linalg.loosen(linalg.congruence(gain.T, wider) + unit))
    surprise = step - gain @ (gain.T @ mean)
    inner = linalg.solve_lower(factor, gain.T @ (wider @ surprise))
    taken = linalg.solve_lower(factor, gain.T @ cov)
    moved = mean + cov @ (surprise - gain @ linalg.solve_upper(factor, inner))
    fit = (
        (gain.T @ mean) @ (gain.T @ mean)
        - 2 * mean @ step
        - surprise @ wider @ surprise
        + inner @ inner
    )
    log_weight = -fit / 2 - jnp.log(jnp.diagonal(factor)).sum()
    revised = Gaussian(
        predicted.mean + linalg.product(lower, moved[:, None])[:, 0],
        linalg.congruence(lower, cov - taken.T @ taken),
    )
    known = jax.tree.map(lambda x, y: jnp.where(right, x, y), revised, later)
    return known, jnp.where(right, log_weight, 0.0)
