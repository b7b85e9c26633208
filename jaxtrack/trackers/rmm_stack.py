"""The Kalman filter for random coefficient matrices, on all targets at once.

The association tells how likely each target caused each detection, and how likely it
moved by each model. So a detection is a random linear function of the stacked state of
all targets, and the best linear filter is that of `rcm_kalman`. Targets that share a
detection are correlated from then on; others are not, and if nothing is shared it is
one Kalman filter for each.

What is random adds noise that depends on the moments of the state. They are kept
relative to the mean, so that they have no large squares of coordinates in them. A
detection that may also be false has, if it is, a place spread evenly over the gates of
those who may have caused it.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import rmm_stack
    >>> from jaxtrack.types import Gaussian
    >>> two = Gaussian(jnp.zeros((2, 4)), jnp.tile(jnp.eye(4), (2, 1, 1)))
    >>> rmm_stack.stack(two).cov.shape
    (2, 4, 2, 4)

Reference: Liu et al. 2021, equations 36 to 47 and Corollary 1.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate, kalman, linearize
from jaxtrack.entries import dense
from jaxtrack.models.sensor import untimed
from jaxtrack.types import Affine, Array, Gaussian

FALSE_GATE = 0.9999  # where a false detection falls, if the gate has no end


class Stack(NamedTuple):
    """N targets: what is believed, and the moments of the state itself.

    Attributes:
        mean: [N, D].
        cov: Of its error, [N, D, N, D].
        state_mean: Of the state, before any detection or as is believed now, [N, D].
        state_cov: [N, D, N, D].
    """

    mean: Array
    cov: Array
    state_mean: Array
    state_cov: Array


class Seen(NamedTuple):
    """How every target would look at every one of C detections.

    Attributes:
        matrix: [N, C, Z, D].
        cov: Of the noise, [N, C, Z, Z].
        surprise: Detection less the one expected, [N, C, Z].
        off: The mean of the state less what is believed, seen by the sensor, [N, C, Z].
        apart: What target i expects less what target j does, [N, N, C, Z].
    """

    matrix: Array
    cov: Array
    surprise: Array
    off: Array
    apart: Array


def stack(targets: Gaussian) -> Stack:
    """Puts N independent targets together: mean [N, D], cov [N, D, D]."""
    size = len(targets.mean)
    cov = jnp.einsum(
        "iab,ij->iajb", targets.cov, jnp.eye(size, dtype=targets.cov.dtype)
    )
    return Stack(targets.mean, cov, targets.mean, cov)


def begun_again(now: Stack) -> Stack:
    """Forgets that what is believed came from detections (`rcm_kalman.begin`)."""
    return now._replace(state_mean=now.mean, state_cov=now.cov)


def each(now: Stack) -> Gaussian:
    """Returns the targets one by one: mean [N, D], cov [N, D, D]."""
    return Gaussian(now.mean, _diagonal(now.cov))


def chosen(now: Stack, index: Array) -> Stack:
    """Returns the targets [N'] with these indices."""
    means = now.mean[index], now.state_mean[index]
    covs = (x[index][:, :, index] for x in (now.cov, now.state_cov))
    mean, state_mean = means
    cov, state_cov = covs
    return Stack(mean, cov, state_mean, state_cov)


def cleared(now: Stack, there: Array) -> Stack:
    """Puts something harmless where no target is, [N] (bool)."""
    size, dim = now.mean.shape
    eye = jnp.eye(size * dim, dtype=now.cov.dtype).reshape(now.cov.shape)
    both = there[:, None, None, None] & there[None, None, :, None]
    return Stack(
        jnp.where(there[:, None], now.mean, 0.0),
        jnp.where(both, now.cov, eye),
        jnp.where(there[:, None], now.state_mean, 0.0),
        jnp.where(both, now.state_cov, eye),
    )


def joined(one: Stack, other: Stack) -> Stack:
    """Puts two stacks together that know nothing of each other."""

    def together(x: Array, y: Array) -> Array:
        wide = jnp.pad(x, ((0, len(y)), (0, 0), (0, len(y)), (0, 0)))
        return wide.at[len(x) :, :, len(x) :].set(y)

    return Stack(
        jnp.concatenate([one.mean, other.mean]),
        together(one.cov, other.cov),
        jnp.concatenate([one.state_mean, other.state_mean]),
        together(one.state_cov, other.state_cov),
    )


def predict(
    method: linearize.Method, target: Any, now: Stack, mode_prob: Array, interval: Array
) -> Stack:
    """Moves all targets, each by random models (eq. 41 to 44).

    Args:
        method: Of `linearize`, at each target's mean.
        target: The target's `Params`.
        now: N targets.
        mode_prob: Of the models of each, [N, M].
        interval: Seconds.
    """

    def one(belief: Gaussian, state: Gaussian, prob: Array) -> tuple[Affine, Array]:
        maps = [
            linearize.motion_affine(motion, belief, interval, method)
            for motion in target.motions
        ]
        matrix, offset, cov = (
            jnp.stack([dense(getattr(x, name)) for x in maps])
            for name in ("matrix", "offset", "cov")
        )
        mean_matrix = jnp.einsum("m,mij->ij", prob, matrix)
        mean_offset = prob @ offset
        extra = matrix - mean_matrix[None]
        shift = jnp.einsum("mij,j->mi", extra, state.mean) + offset - mean_offset[None]
        spread = jnp.einsum("mij,jk,mlk->mil", extra, state.cov, extra)
        spread = spread + shift[:, :, None] * shift[:, None, :]
        noise = jnp.einsum("m,mij->ij", prob, cov + spread)
        return Affine(mean_matrix, mean_offset, noise), prob

    states = Gaussian(now.state_mean, _diagonal(now.state_cov))
    affine, _ = jax.vmap(one)(each(now), states, mode_prob)
    eye = jnp.eye(len(now.mean), dtype=now.cov.dtype)
    noise = jnp.einsum("iab,ij->iajb", affine.cov, eye)

    def moved(mean: Array, cov: Array) -> tuple[Array, Array]:
        mean = jnp.einsum("iab,ib->ia", affine.matrix, mean) + affine.offset
        half = jnp.einsum("iab,ibjc->iajc", affine.matrix, cov)
        return mean, jnp.einsum("iajc,jdc->iajd", half, affine.matrix) + noise

    return Stack(*moved(now.mean, now.cov), *moved(now.state_mean, now.state_cov))


def update(
    method: linearize.Method,
    target: Any,
    now: Stack,
    prob: Array,
    detections: Array,
    gate_prob: float,
) -> Stack:
    """Corrects all targets by C detections that each may have caused (eq. 40 to 47).

    The detections are independent of each other, as in the paper.

    Args:
        method: Of `linearize`, at each target's mean.
        target: The target's `Params`.
        now: N targets.
        prob: That a target caused a detection, [N, C]; a detection's add up to one at
            most, and where to less it may be false.
        detections: [C, Z]; any finite numbers where nobody caused one.
        gate_prob: P_G, of the gates in which false detections are.
    """
    seen = _see(method, target, now, detections)
    total = prob.sum(0)
    there = total > 0
    weight = prob / jnp.where(there, total, 1.0)[None]
    noise = _noise(now, seen, prob, weight, total, gate_prob)
    blank = jnp.eye(noise.shape[-1], dtype=noise.dtype)[None]
    noise = jnp.where(there[:, None, None], noise, blank)
    surprise = jnp.einsum("nc,ncz->cz", weight, seen.surprise).reshape(-1)
    matrix = jnp.einsum("nc,nczd->cznd", prob, seen.matrix)
    matrix = matrix.reshape(surprise.size, -1)
    every = jnp.eye(len(noise), dtype=noise.dtype)
    cov = jnp.einsum("cyz,ck->cykz", noise, every).reshape(surprise.size, -1)
    dim = now.mean.size
    prior = Gaussian(now.mean.reshape(-1), now.cov.reshape(dim, dim))
    sensor = Affine(matrix, jnp.zeros_like(surprise), cov)
    (mean, after), _ = kalman.update(prior, sensor, surprise, lambda z, _: z)
    return now._replace(
        mean=mean.reshape(now.mean.shape), cov=after.reshape(now.cov.shape)
    )


def _see(method: linearize.Method, target: Any, now: Stack, detections: Array) -> Seen:
    """Looks at all pairs of a target and a detection."""

    def pair(belief: Gaussian, state_mean: Array, detection: Array) -> tuple:
        sensor, plain = untimed(target.sensor, detection)
        affine = linearize.sensor_affine(sensor, target.layout, belief, method)
        matrix = dense(affine.matrix)
        expected = matrix @ belief.mean + affine.offset
        off = matrix @ (state_mean - belief.mean)
        surprise = sensor.residual(plain, expected)
        return matrix, dense(affine.cov), surprise, off, expected

    across = jax.vmap(pair, (None, None, 0))
    matrix, cov, surprise, off, expected = jax.vmap(across, (0, 0, None))(
        each(now), now.state_mean, detections
    )

    def apart(one: Array, other: Array, detection: Array) -> Array:
        return untimed(target.sensor, detection)[0].residual(one, other)

    pairs = jax.vmap(apart)
    pairs = jax.vmap(jax.vmap(pairs, (None, 0, None)), (0, None, None))
    far = pairs(expected, expected, detections)
    return Seen(matrix, cov, surprise, off, far)


def _noise(
    now: Stack, seen: Seen, prob: Array, weight: Array, total: Array, gate_prob: float
) -> Array:
    """Returns the covariance of what is random in each detection (eq. 45), [C, Z, Z].

    All places are relative to the one expected on average of those who may be seen.
    """
    spread = jnp.einsum(
        "icya,iajb,jczb->ijcyz", seen.matrix, now.state_cov, seen.matrix
    )
    own = _own(spread)  # [N, C, Z, Z]
    place = seen.off + jnp.einsum("jc,ijcz->icz", weight, seen.apart)
    square = own + place[..., :, None] * place[..., None, :]
    mean = jnp.einsum("nc,ncz->cz", prob, place)
    both = jnp.einsum("ic,jc,ijcyz->cyz", prob, prob, spread)
    both = both + mean[:, :, None] * mean[:, None, :]
    by_targets = jnp.einsum("nc,ncyz->cyz", prob, seen.cov + square)
    limit = gate.threshold(min(gate_prob, FALSE_GATE), seen.cov.shape[-1])
    gates = jnp.einsum("icya,iab,iczb->icyz", seen.matrix, each(now).cov, seen.matrix)
    # A point spread evenly over a ball of Z dimensions.
    factor = limit / (seen.cov.shape[-1] + 2)
    false = factor * jnp.einsum("nc,ncyz->cyz", weight, gates + seen.cov)
    rest = jnp.maximum(1 - total, 0.0)[:, None, None]
    return by_targets + rest * false - both


def _own(spread: Array) -> Array:
    """Returns the diagonal [N, ...] of [N, N, ...]."""
    index = jnp.arange(len(spread))
    return spread[index, index]


def _diagonal(cov: Array) -> Array:
    """Returns the blocks of the targets themselves, [N, D, D]."""
    index = jnp.arange(len(cov))
    return cov[index, :, index]
