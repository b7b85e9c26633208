"""Set JPDA: JPDA for those who ask where the targets are, not which is which.

In each joint event the tracks may trade places before the events are averaged. Those
trades are chosen that make the average sharpest: the sum of the tracks' position
variances least, and with it the mean OSPA error. So tracks of targets side by side do
not coalesce. Labels may trade, too.

The search goes back and forth between the averages and each event's best trade. It
never gets worse, and ends at a local optimum. What is remembered of a track, its label,
existence and record, stays with its place; only beliefs trade. It goes by the likeliest
events alone; the estimate's `exact` says whether these were all.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import set_jpda
    >>> set_jpda.set_jpda(targets.single.single(), max_events=20)._fields
    ('init', 'step')

Reference: Svensson, Svensson, Guerriero and Willett, "Set JPDA filter for multitarget
tracking", IEEE Trans. Signal Processing 59(10), 2011.
"""

import functools
from typing import Any, Unpack, cast

import jax
import jax.numpy as jnp

from jaxtrack import assign
from jaxtrack.linalg import safe_log
from jaxtrack.trackers import jpda, options
from jaxtrack.trackers.association import Association, Events, Sighting
from jaxtrack.types import Array, PyTree, Scan, Target, Tracker

ROUNDS = 10  # of averages and trades; most scenes settle after two or three


@functools.cache
def set_jpda(
    target: Target, max_events: int = 50, **choices: Unpack[options.Options]
) -> Tracker:
    """Makes a set JPDA tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_events: Joint events considered, the likeliest.
        **choices: See `options.make`.

    Raises:
        ValueError: A setting that makes no sense.
    """
    jpda.check(max_events)
    associate = functools.partial(jpda.by_events, max_events=max_events)
    return options.make(target, associate, update=update, **choices)


def update(
    target: Target, params: Any, sighting: Sighting, answer: Association, scan: Scan
) -> PyTree:
    """Updates each place by the tracks that take it, event by event.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        sighting: The tracks, as the sensor sees them.
        answer: The joint events.
        scan: K detections.

    Returns:
        N beliefs.
    """
    events = cast(Events, answer.events)
    where = jnp.array(params.layout.position_index)

    def place(belief: PyTree) -> Array:
        return target.moments(belief).mean[where]

    def places(view: PyTree, missed: PyTree) -> Array:
        correct = functools.partial(target.correct, params, view)
        return jnp.concatenate(
            [
                jax.vmap(lambda z: place(correct(z)))(scan.detections),
                place(missed)[None],
            ]
        )

    point = jax.vmap(places)(sighting.views, sighting.missed)  # [N, K + 1, P]
    there = sighting.log_exists > -jnp.inf
    taker = trades(events, jax.lax.stop_gradient(point), there)
    share = _shares(events, taker, point.shape[1])  # [N, N, K + 1]

    def settle(share: Array) -> PyTree:
        blended = jax.vmap(target.blend, (None, 0, 0, 0, None))(
            params, sighting.views, sighting.missed, safe_log(share), scan.detections
        )
        return target.collapse(safe_log(share.sum(1)), blended)

    return jax.vmap(settle)(share)


def trades(events: Events, point: Array, there: Array) -> Array:
    """Finds which track takes each place in each event.

    Args:
        events: E joint events of N tracks.
        point: Position of each track with each column, [N, K + 1, P].
        there: Which slots hold a track; the others keep their places, [N] (bool).

    Returns:
        [E, N] (int), a permutation in every event.
    """
    num = len(there)
    prob = jnp.exp(events.log_prob)
    own = jnp.eye(num, dtype=bool)
    allowed = own | (there[:, None] & there[None])
    at = jax.vmap(lambda column: point[jnp.arange(num), column])(events.column)

    def round_of(taker: Array, _: None) -> tuple[Array, None]:
        taken = jnp.take_along_axis(at, taker[:, :, None], axis=1)
        mean = (prob[:, None, None] * taken).sum(0)

        def best(at: Array) -> Array:
            gap = mean[:, None] - at[None]
            cost = jnp.where(allowed, (gap * gap).sum(-1), jnp.inf)
            score = jnp.concatenate([-cost, jnp.full((num, 1), -jnp.inf)], axis=1)
            return assign.best.best(score).column.astype(taker.dtype)

        return jax.vmap(best)(at), None

    start = jnp.broadcast_to(jnp.arange(num), events.column.shape)
    taker, _ = jax.lax.scan(round_of, start, length=ROUNDS)
    return taker


def _shares(events: Events, taker: Array, num_columns: int) -> Array:
    """Returns how likely each place is taken by each track with each column."""
    num = taker.shape[1]
    column = jnp.take_along_axis(events.column, taker, axis=1)  # [E, N]
    prob = jnp.broadcast_to(jnp.exp(events.log_prob)[:, None], column.shape)
    place = jnp.arange(num)[None]
    none = jnp.zeros((num, num, num_columns), prob.dtype)
    return none.at[place, taker, column].add(prob)
