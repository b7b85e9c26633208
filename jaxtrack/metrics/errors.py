"""How far a track is from the target that it was begun for, scan by scan.

Where the tracker was told at the start which targets are there, target n has the track
with label n, whatever happens: a track that follows another's target from a crossing on
is in error. OSPA and GOSPA would not mind.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.metrics import errors
    >>> distance, tracked = jnp.array([3.0, 4.0]), jnp.array([True, True])
    >>> print(errors.rms(distance, tracked).round(1))
    3.5
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.types import Array


class Errors(NamedTuple):
    """Errors of one run, each [T, N].

    Attributes:
        position: Distance between target n and the track with label n, m; 0 where there
            is none.
        velocity: The same of their velocities, m/s.
        tracked: Whether the target exists and has its track (bool).
    """

    position: Array
    velocity: Array
    tracked: Array


def errors(state: Array, exists: Array, estimates: Any, motion: Any) -> Errors:
    """Compares tracks with the targets whose numbers they have for labels.

    Args:
        state: Of the targets, [T, N, D].
        exists: Which targets there are, [T, N] (bool).
        estimates: Any tracker's `Estimate` with a leading T.
        motion: A motion model, asked only where positions and velocities stand.

    Returns:
        Errors, each [T, N].
    """
    mean, reported = of_labels(estimates.mean, estimates, state.shape[1])
    tracked = exists & reported

    def distance(index: tuple[int, ...]) -> Array:
        gap = jnp.where(tracked[..., None], mean - state, 0.0)[..., jnp.array(index)]
        square = (gap * gap).sum(-1)
        return jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)

    position, velocity = map(distance, (motion.position_index, motion.velocity_index))
    return Errors(position, velocity, tracked)


def of_labels(values: Array, estimates: Any, num: int) -> tuple[Array, Array]:
    """Picks what belongs to the tracks with labels 0 to num - 1.

    Args:
        values: Of each track, a field of the estimates, e.g. its `association_prob`
            or `mode_prob`, [T, slots, ...].
        estimates: Any tracker's `Estimate` with a leading T.
        num: N.

    Returns:
        The values, [T, N, ...], 0 where no such track is reported; and whether one is,
        [T, N] (bool).
    """

    def one(values: Array, label: Array, exists: Array) -> tuple[Array, Array]:
        mine = exists[None] & (label[None] == jnp.arange(num)[:, None])  # [N, slots]
        there, slot = mine.any(1), jnp.argmax(mine, 1)
        picked = values[slot]
        shape = (num, *[1] * (picked.ndim - 1))
        return jnp.where(there.reshape(shape), picked, 0), there

    return jax.vmap(one)(values, estimates.label, estimates.exists)


def rms(values: Array, tracked: Array) -> Array:
    """Returns the root of the mean square over runs, [R, ...] -> [...].

    Args:
        values: [R, ...].
        tracked: Which of them count, the same shape (bool); where none does, 0.
    """
    count = tracked.sum(0)
    square = jnp.where(tracked, values * values, 0.0).sum(0)
    some = square > 0
    return jnp.where(
        some, jnp.sqrt(jnp.where(some, square, 1.0) / jnp.maximum(count, 1)), 0.0
    )
