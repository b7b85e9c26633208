"""Arrays that may have only some values, as free numbers that may have any.

Some entries of an array move, the others stay as they are (see
`jaxtrack.constraints`). To each free number belongs an entry, and they are no more than
they need to be: a row of a simplex with n entries that move has n - 1, a covariance
of n components n (n + 1) / 2. So their information matrix can be regular.

    real         v = scale x
    positive     v = exp(x)
    probability  v = low + (high - low) / (1 + exp(-x)), from 0 to 1 or what bounds it
    simplex      v = softmax(x), x = 0 at the largest entry
    covariance   V = S L L' S, S = diag(exp(x)), L lower with x below its unit diagonal

    >>> import numpy as np
    >>> from jaxtrack.learn import supports
    >>> row = np.array([[0.8, 0.0, 0.2]])
    >>> place = supports.places("simplex", row)
    >>> x = supports.unconstrain("simplex", row, place, supports.Bounds())
    >>> print(place.free, x.round(3))
    (2,) [-1.386]
    >>> print(supports.constrain("simplex", row, x, place, supports.Bounds()))
    [[0.8 0.  0.2]]

Reference: Pinheiro and Bates, "Unconstrained parametrizations for variance-covariance
matrices", Statistics and Computing 6, 1996 (the logarithm of the Cholesky factor).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import linalg
from jaxtrack.constraints import Kind
from jaxtrack.types import Array

ROUNDING = 1e-5  # of a sum, or of two mirrored entries, in float32


class Places(NamedTuple):
    """Which entries of an array move; static, so that programs may depend on it.

    Attributes:
        free: Where the free numbers stand, flat indices.
        moving: Which entries they move, flat indices.
    """

    free: tuple[int, ...]
    moving: tuple[int, ...]


class Bounds(NamedTuple):
    """What other arrays say about this one.

    Attributes:
        low: Probabilities are above it.
        high: And below it.
        cov: Its standard deviations are the scale of real numbers; by default that is
            the size of the largest of them.
    """

    low: Any = 0.0
    high: Any = 1.0
    cov: Any = None


def remedy(kind: Kind, value: np.ndarray, bounds: Bounds) -> str | None:
    """Returns what should be given instead, None if the value may be."""
    if not np.isfinite(value).all():
        return "finite numbers"
    if kind == "positive" and not (value >= 0).all():
        return "numbers that are not negative"
    if kind in ("probability", "below"):
        inside = (value > bounds.low) & (value < bounds.high)
        if not (inside | (value == 0) | ((value == 1) & (kind != "below"))).all():
            return f"probabilities between {bounds.low} and {bounds.high}"
    if kind in ("simplex", "jumps"):
        sums = _weights(kind, value).sum(-1, initial=0.0)
        good = np.abs(sums - 1) < ROUNDING
        if kind == "jumps":
            good = good | (sums == 0)  # of a single mode, or one that is never left
        if not (good.all() and (_weights(kind, value) >= 0).all()):
            return "probabilities that sum to one over the last axis"
    if kind == "covariance" and not _positive_definite(value):
        return "symmetric, positive definite matrices"
    return None


def places(kind: Kind, value: np.ndarray) -> Places:
    """Returns which entries of a value move, and where their free numbers stand."""
    if kind in ("simplex", "jumps"):
        weights = _weights(kind, value)
        several = (weights > 0).sum(-1, keepdims=True) > 1
        moving = (weights > 0) & several
        largest = np.argmax(weights, -1)[..., None]
        free = moving & (np.arange(value.shape[-1]) != largest)
    elif kind == "covariance":
        alive = np.diagonal(value, axis1=-2, axis2=-1) > 0
        moving = alive[..., :, None] & alive[..., None, :]
        free = np.tril(moving)
    elif kind == "positive":
        free = moving = value > 0
    elif kind in ("probability", "below"):
        free = moving = (value > 0) & (value < 1)
    else:
        free = moving = np.ones_like(value, bool)
    return Places(_flat_indices(free), _flat_indices(moving))


def unconstrain(
    kind: Kind, value: np.ndarray, place: Places, bounds: Bounds
) -> np.ndarray:
    """Returns the free numbers of a value, [number of them]."""
    moving = _mask(place.moving, value.shape)
    if kind == "positive":
        full = np.log(np.where(moving, value, 1.0))
    elif kind in ("probability", "below"):
        safe = np.where(moving, value, (bounds.low + bounds.high) / 2)
        full = np.log(safe - bounds.low) - np.log(bounds.high - safe)
    elif kind in ("simplex", "jumps"):
        weights = np.where(moving, value, 0.0)
        log_weight = np.log(np.where(moving, value, 1.0))
        largest = np.argmax(weights, -1)[..., None]
        full = log_weight - np.take_along_axis(log_weight, largest, -1)
    elif kind == "covariance":
        alive = np.where(moving, value, np.eye(value.shape[-1]))
        lower = np.linalg.cholesky((alive + np.swapaxes(alive, -1, -2)) / 2)
        own = np.diagonal(lower, axis1=-2, axis2=-1)[..., None]
        full = np.tril(lower / own, -1) + np.log(own) * np.eye(value.shape[-1])
    else:
        full = value / _scale(np, value, bounds.cov)
    return full.ravel()[list(place.free)]


def constrain(
    kind: Kind, base: Any, free: Array, place: Places, bounds: Bounds
) -> Array:
    """Returns the value that free numbers stand for.

    Args:
        kind: Which values are allowed.
        base: The value at the start, whose entries that do not move are kept.
        free: As many numbers as `place` says.
        place: Of `places`, for the value at the start.
        bounds: Those of now.

    Returns:
        An array of the shape of `base`, in the precision of `free`.
    """
    free = linalg.floating(free)
    base = jnp.asarray(base, free.dtype)
    moving = _mask(place.moving, base.shape)
    index = np.array(place.free, int)
    full = jnp.zeros(base.size, free.dtype).at[index].set(free).reshape(base.shape)
    if kind == "positive":
        value = jnp.exp(full)
    elif kind in ("probability", "below"):
        value = bounds.low + (bounds.high - bounds.low) * jax.nn.sigmoid(full)
    elif kind in ("simplex", "jumps"):
        value = _shares(base, full, moving)
    elif kind == "covariance":
        value = _square(full)
    else:
        value = full * _scale(jnp, base, bounds.cov)
    return jnp.where(moving, value, base).astype(free.dtype)


def _shares(base: Array, full: Array, moving: np.ndarray) -> Array:
    """Returns rows whose entries that move have the sum that they had, to rounding."""
    some = moving.any(-1, keepdims=True)
    # A row in which nothing moves must not become a softmax of nothing.
    logits = jnp.where(moving, full, jnp.where(some, -jnp.inf, 0.0))
    total = jnp.where(moving, base, 0.0).sum(-1, keepdims=True)
    return total * jax.nn.softmax(logits, axis=-1)


def _square(full: Array) -> Array:
    """Returns covariances, of components that do not move the identity."""
    size = full.shape[-1]
    eye = jnp.eye(size, dtype=full.dtype)
    own = jnp.exp(jnp.diagonal(full, axis1=-2, axis2=-1))[..., None]
    lower = own * (jnp.tril(full, -1) + jnp.broadcast_to(eye, full.shape))
    return jnp.einsum("...ik,...jk->...ij", lower, lower)


def _scale(xp: Any, value: Any, cov: Any) -> Any:
    """Returns what a free number of 1 stands for; `xp` is numpy or jax.numpy."""
    if cov is not None:
        variance = xp.diagonal(xp.asarray(cov), axis1=-2, axis2=-1)
        return xp.sqrt(xp.where(variance > 0, variance, 1.0))
    largest = abs(value).max(initial=0.0)
    return xp.where(largest > 0, largest, 1.0)


def _weights(kind: Kind, value: np.ndarray) -> np.ndarray:
    """Returns the entries that sum to one, the others as 0."""
    return value * (1 - np.eye(value.shape[-1])) if kind == "jumps" else value


def _positive_definite(value: np.ndarray) -> bool:
    turned = np.swapaxes(value, -1, -2)
    variance = np.diagonal(value, axis1=-2, axis2=-1)
    std = np.sqrt(np.maximum(variance, 0.0))
    size = std[..., :, None] * std[..., None, :]
    if (variance < 0).any() or (np.abs(value - turned) > ROUNDING * size).any():
        return False
    alive = size > 0
    if (value[~alive] != 0).any():
        return False
    scaled = np.where(alive, value / np.where(alive, size, 1.0), np.eye(len(std.T)))
    return bool((np.linalg.eigvalsh(scaled) > 0).all())


def _mask(index: tuple[int, ...], shape: tuple[int, ...]) -> np.ndarray:
    mask = np.zeros(int(np.prod(shape)), bool)
    mask[list(index)] = True
    return mask.reshape(shape)


def _flat_indices(mask: np.ndarray) -> tuple[int, ...]:
    return tuple(int(i) for i in np.flatnonzero(mask))
