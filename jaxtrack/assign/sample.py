"""Draws joint events with the probability that they have.

`sample` draws them exactly: the table of `subsets.backward` tells the weight of all
that may follow, so each detection's track is drawn given those before. `gibbs` draws
the column of one track after another given all others, which is near the truth after
many sweeps; `sample` falls back on it for clusters that are too large. `walk` gives all
the events on the way.

    >>> import jax
    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import sample
    >>> log_score = jnp.array([[50.0, 0.0, 0.0], [50.0, 20.0, 0.0]])
    >>> print(sample.sample(jax.random.key(0), log_score).column)
    [0 1]
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign import clusters, subsets
from jaxtrack.assign.best import solvable
from jaxtrack.assign.exact import MAX_CLUSTER
from jaxtrack.resampling import running
from jaxtrack.types import Array


class Sample(NamedTuple):
    """A joint event.

    Attributes:
        column: Of each track, [N] (int): 0 to K - 1 the detection, K the miss.
        exact: Whether the track was drawn with its exact probability, [N] (bool).
        feasible: Whether a joint event of positive weight exists (bool). Where none
            does, all tracks are missed.
    """

    column: Array
    exact: Array
    feasible: Array


def sample(
    key: Array,
    log_score: Array,
    max_cluster: int = MAX_CLUSTER,
    num_sweeps: int = 50,
) -> Sample:
    """Draws a joint event.

    For many of one matrix, `vmap` over keys: the table is made once.

    Args:
        key: Random key.
        log_score: [N, K + 1], the miss last, -inf where impossible.
        max_cluster: Tracks that are summed over together, at most.
        num_sweeps: Sweeps of `gibbs`, from the best joint event on, for tracks in
            larger clusters.

    Raises:
        ValueError: The largest cluster is not from 1 to 20.
    """
    if not 1 <= max_cluster <= 20:
        raise ValueError(f"max_cluster is {max_cluster}; give 1 to 20")
    num_tracks, num_columns = log_score.shape
    size = min(max_cluster, num_tracks)
    scores, found = solvable(jax.lax.stop_gradient(log_score))
    u, v = found.track_price, found.detection_price
    weight = jnp.exp(scores[:, :-1] - u[:, None] - v[None])
    order = clusters.steps(weight[..., None] > 0, size)
    fits = order.fits[:, 0]
    column = jnp.full(num_tracks, num_columns - 1)
    exact_key, gibbs_key = jax.random.split(key)
    if num_columns > 1:
        miss, spare = jnp.exp(scores[:, -1] - u)[:, None], jnp.exp(-v)[:, None]
        steps = subsets.steps(size, weight[..., None], miss, spare, order)
        column = _draw(exact_key, steps, order)
    if num_tracks > max_cluster:
        missed = jnp.arange(num_columns) == num_columns - 1
        alone = jnp.where(missed, 0.0, -jnp.inf).astype(scores.dtype)
        rest = jnp.where(fits[:, None], alone[None], scores)
        start = jnp.where(fits, num_columns - 1, found.column)
        walked = gibbs(gibbs_key, rest, num_sweeps, start)
        column = jnp.where(fits, column, walked)
    column = jnp.where(found.feasible, column, num_columns - 1)
    return Sample(column, fits, found.feasible)


def _draw(key: Array, steps: subsets.Step, order: clusters.Steps) -> Array:
    """Draws the track of one detection after another; returns columns [N]."""
    num_tracks, (num_items, size, _) = len(order.bit), steps.weight.shape
    after = subsets.backward(steps)[..., 0]  # [K, 2^C]
    bits = 1 << jnp.arange(size)

    def one(held: Array, given: tuple) -> tuple[Array, Array]:
        step, after, noise = given
        held = jnp.where(step.first[0], 0, held)
        free = (held & bits) == 0
        taken = jnp.where(free, step.weight[:, 0] * after[held | bits], 0.0)
        left = step.spare * after[held][None]
        bit = jnp.argmax(jnp.log(jnp.concatenate([taken, left])) + noise)
        drawn = step.used[0] & (bit < size)
        held = jnp.where(drawn, held | bits[jnp.minimum(bit, size - 1)], held)
        return held, jnp.where(drawn, bit, size)

    noise = jax.random.gumbel(key, (num_items, size + 1), after.dtype)
    bit = jax.lax.scan(one, jnp.array(0), (steps, after, noise))[1]  # [K]
    member = order.member[..., 0]
    track = jnp.where(
        bit < size,
        jnp.take_along_axis(member, jnp.minimum(bit, size - 1)[:, None], axis=1)[:, 0],
        num_tracks,
    )
    missed = jnp.full(num_tracks, num_items)
    return missed.at[track].set(order.item[:, 0], mode="drop")


def gibbs(key: Array, log_score: Array, num_sweeps: int, start: Array) -> Array:
    """Draws a joint event by Gibbs sampling: the last one of `walk`, [N]."""
    return walk(key, log_score, num_sweeps, start)[-1]


def walk(
    key: Array, log_score: Array, num_sweeps: int, start: Array, ways: int = 1
) -> Array:
    """Draws joint events by Gibbs sampling.

    Each track in turn draws its column given those of the others. Where tracks cannot
    be missed, it may never reach some events: two that hold each other's detection
    cannot swap.

    Args:
        key: Random key.
        log_score: [N, K + W], -inf where impossible; the last W columns are ways of
            having no detection, and any number of tracks may have them.
        num_sweeps: How often every track draws, S.
        start: Columns of a joint event that is possible, [N], such as that of `best`.
        ways: W.

    Returns:
        The columns after each sweep, [S, N].
    """
    num_tracks, num_columns = log_score.shape
    columns, tracks = jnp.arange(num_columns), jnp.arange(num_tracks)
    start = start.astype(tracks.dtype)
    detection = columns < num_columns - ways
    held = jnp.zeros(num_columns, bool).at[start].set(True) & detection

    def one(held: Array, given: tuple) -> tuple[Array, Array]:
        own, row, share = given
        others = held & (columns != own)
        free = jnp.where(others, -jnp.inf, row)
        ahead = running(jnp.exp(free - free.max()))
        # Rounding must not choose what is impossible, nor nothing.
        beyond = (ahead > share * ahead[-1]) & (free > -jnp.inf)
        first = jnp.where(beyond, columns, num_columns).min()
        drawn = jnp.where(first < num_columns, first, own)
        return others | (columns == drawn) & detection, drawn

    def sweep(state: tuple, key: Array) -> tuple[tuple, Array]:
        held, column = state
        share = jax.random.uniform(key, tracks.shape, log_score.dtype)
        state = jax.lax.scan(one, held, (column, log_score, share))
        return state, state[1]

    keys = jax.random.split(key, num_sweeps)
    return jax.lax.scan(sweep, (held, start), keys)[1]
