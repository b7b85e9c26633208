"""Best joint events in which one track may not have what it has, and some are fixed.

A joint event of most weight and its prices are known. If track t must leave its column,
it takes another; who had that takes a third, and so on, until somebody takes a
detection that nobody had, is missed, or takes what t has left. That is a shortest path
in reduced costs, one Dijkstra search of a few steps where solving anew takes as many
searches as there are tracks. Here it is done for every t, side by side, with all tracks
before t staying where they are.

The places of a search are the tracks, where the column is that each has, and the pool,
where all detections are that nobody has, and all misses. Who comes to the pool finds
room, but from there a detection may be given up, or somebody who was missed may come.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import best, detours
    >>> cost = jnp.array([[1.0, 2.0, 9.0], [1.0, 4.0, 9.0]])
    >>> event = detours.Event(jnp.array([1, 0]), jnp.array([-3.0, 0.0]))
    >>> found = detours.detours(cost, event, jnp.zeros((2, 3), bool), jnp.inf)
    >>> print(found.column.tolist(), found.loss)
    [[0, 1], [1, 2]] [2. 8.]

Reference: Miller, Stone and Cox, "Optimizing Murty's ranked assignment method", IEEE
Trans. Aerospace and Electronic Systems 33(3), 1997.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.types import Array


class Event(NamedTuple):
    """A joint event, and what proves it the best.

    Attributes:
        column: Of each track, K for the miss, [N] (int).
        price: Dual potential of each detection, never positive, 0 where nobody has it,
            [K].
    """

    column: Array
    price: Array


class Detours(NamedTuple):
    """The best events without one track's column, one for every track.

    Attributes:
        column: [N (which must leave), N] (int).
        price: [N, K].
        loss: How much more each costs; inf where there is none or it costs too much.
    """

    column: Array
    price: Array
    loss: Array


class _Graph(NamedTuple):
    """Reduced costs between places, none negative; R = N searches side by side.

    Attributes:
        cost: Of each track going to each place, [N, N + 1]; the pool is last.
        door: The column by which each track comes to the pool, [N].
        fall: What giving up each track's detection costs; inf if it has none, [N].
        late: The missed track after t that comes cheapest to each place, [N, R].
        late_cost: At what cost, [N, R].
        goal: Where the search of t ends: at its own place, N for the pool, [R].
    """

    cost: Array
    door: Array
    fall: Array
    late: Array
    late_cost: Array
    goal: Array


class _State(NamedTuple):
    """Where the searches stand.

    Attributes:
        distance: Of each place, [N + 1, R].
        closed: Whether that is final, or the place out of bounds, [N + 1, R].
        source: From where: track n is n, the pool itself N, a missed track N + 1 + n,
            [N + 1, R].
        end: Distance of the goal, once it is reached; inf before, [R].
        done: [R].
    """

    distance: Array
    closed: Array
    source: Array
    end: Array
    done: Array


def detours(cost: Array, event: Event, barred: Array, most: Array) -> Detours:
    """Finds, for each track, the best event in which it leaves its column.

    Args:
        cost: [N, K + 1], the miss last, inf where impossible.
        event: The best event, with its prices.
        barred: Columns that the track, leaving, may not take either, [N, K + 1].
        most: Losses above this are of no interest.
    """
    num_tracks, num_columns = cost.shape
    taken = event.column[:, None] == _count(num_columns)[None]
    reduced = _reduce(cost, event.price, taken)
    graph = _graph(reduced, event, taken)
    start = jnp.where(taken | barred, jnp.inf, reduced)
    first, door = _to_places(start, event.column, taken)
    state = jax.lax.while_loop(
        lambda state: ~state.done.all(),
        lambda state: _step(graph, most, state),
        _begin(first.T, event.column == num_columns - 1),
    )
    column = _backtrack(graph, state, event.column, door)
    # Prices change by how much nearer a place is than the goal; the pool's stays 0.
    end = jnp.where(state.end < jnp.inf, state.end, 0.0)
    nearer = jnp.maximum(end[None] - state.distance, 0.0)
    change = nearer[-1:] - nearer[:-1]  # [N, R]
    held = jnp.where(taken[:, :-1, None], change[:, None], 0.0).sum(0)  # [K, R]
    price = jnp.minimum(event.price[:, None] + held, 0.0)
    return Detours(column.T, price.T, state.end)


def _reduce(cost: Array, price: Array, taken: Array) -> Array:
    """Returns how much worse each column is for a track than its own, [N, K + 1]."""
    left = cost - jnp.append(price, 0.0)[None]
    own = jnp.where(taken, left, 0.0).sum(1)
    own = jnp.where(own < jnp.inf, own, 0.0)
    return jnp.maximum(left - own[:, None], 0.0)  # rounding aside, it is


def _graph(reduced: Array, event: Event, taken: Array) -> _Graph:
    """Returns the graph in which all tracks search."""
    num_tracks, num_columns = reduced.shape
    cost, door = _to_places(reduced, event.column, taken)
    missed = event.column == num_columns - 1
    price = jnp.where(taken[:, :-1], event.price[None], 0.0).sum(1)

    come = jnp.where(missed[:, None], cost[:, :-1], jnp.inf)
    first = jnp.broadcast_to(_count(num_tracks)[:, None], come.shape)
    late_cost, late = jax.lax.associative_scan(
        _cheaper, (come, first), reverse=True
    )  # of t and all after it
    last = jnp.full((1, num_tracks), jnp.inf, cost.dtype)
    return _Graph(
        cost=cost,
        door=door,
        fall=jnp.where(missed, jnp.inf, -price),
        late=jnp.concatenate([late[1:], late[:1]]).T,
        late_cost=jnp.concatenate([late_cost[1:], last]).T,
        goal=jnp.where(missed, num_tracks, _count(num_tracks)),
    )


def _to_places(reduced: Array, column: Array, taken: Array) -> tuple[Array, Array]:
    """Returns the costs of going to each place, and by which column to the pool.

    Nobody goes to the place of a missed track: that is the pool.
    """
    num_columns = reduced.shape[1]
    free = ~taken.any(0).at[-1].set(False)
    to_pool = jnp.where(free[None], reduced, jnp.inf)
    pool = to_pool.min(1)
    columns = _count(num_columns)[None]
    door = jnp.where(to_pool <= pool[:, None], columns, num_columns).min(1)
    places = jnp.where(column[None] < num_columns - 1, reduced[:, column], jnp.inf)
    return jnp.concatenate([places, pool[:, None]], axis=1), door


def _cheaper(one: tuple[Array, Array], two: tuple[Array, Array]) -> tuple:
    """Returns the lesser costs and whose they are."""
    better = one[0] <= two[0]
    return tuple(jnp.where(better, x, y) for x, y in zip(one, two, strict=True))


def _count(number: int) -> Array:
    return jnp.arange(number, dtype=jnp.int32)


def _begin(first: Array, missed: Array) -> _State:
    """Has every track look around from where it stands.

    Args:
        first: Costs of the first steps, [N + 1, R].
        missed: Which tracks are missed, [N] (bool).
    """
    num_places, number = first.shape
    track = _count(number)
    place = _count(num_places)[:, None]
    return _State(
        distance=first,
        # Those before t stay where they are.
        closed=(place < track[None]) | jnp.append(missed, False)[:, None],
        source=jnp.broadcast_to(track[None], first.shape),
        end=jnp.full(number, jnp.inf, first.dtype),
        done=jnp.zeros(number, bool),
    )


def _step(graph: _Graph, most: Array, state: _State) -> _State:
    """Goes to the nearest place of each search, and looks around from there."""
    num_tracks = graph.cost.shape[0]
    place = _count(num_tracks + 1)[:, None]
    ahead = jnp.where(state.closed, jnp.inf, state.distance)
    reach = ahead.min(0)
    head = jnp.where(ahead <= reach[None], place, num_tracks).min(0)
    wanted = (reach < jnp.inf) & (reach <= most)
    ended = wanted & (head == graph.goal) & ~state.done
    done = state.done | ended | ~wanted

    in_pool = head == num_tracks
    from_track = graph.cost[jnp.minimum(head, num_tracks - 1)].T  # [N + 1, R]
    comes = graph.late_cost < graph.fall[:, None]
    from_pool = jnp.where(comes, graph.late_cost, graph.fall[:, None])
    from_pool = jnp.pad(from_pool, ((0, 1), (0, 0)), constant_values=jnp.inf)
    of_pool = jnp.where(comes, num_tracks + 1 + graph.late, num_tracks)
    of_pool = jnp.pad(of_pool, ((0, 1), (0, 0)))
    way = reach[None] + jnp.where(in_pool[None], from_pool, from_track)
    closed = state.closed | (place == head[None])
    nearer = ~closed & ~done[None] & (way < state.distance)
    source = jnp.where(in_pool[None], of_pool, head[None])
    return _State(
        distance=jnp.where(nearer, way, state.distance),
        closed=closed,
        source=jnp.where(nearer, source, state.source),
        end=jnp.where(ended, reach, state.end),
        done=done,
    )


def _backtrack(graph: _Graph, state: _State, column: Array, door: Array) -> Array:
    """Walks back from the goals, moving every track on the way.

    Args:
        graph: The graph.
        state: Where the searches ended.
        column: Of each track, before, [N].
        door: By which column each comes to the pool in its own first step, [N].

    Returns:
        [N, R].
    """
    num_tracks = graph.cost.shape[0]
    row, place = _count(num_tracks)[:, None], _count(num_tracks + 1)[:, None]
    search = _count(num_tracks)

    def back(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        at, new, walking = carry
        source = jnp.where(place == at[None], state.source, 0).sum(0, dtype=jnp.int32)
        came = source > num_tracks  # having been missed
        track = jnp.where(came, source - num_tracks - 1, source)
        known = jnp.minimum(track, num_tracks - 1)
        entry = jnp.where(track == search, door, graph.door[known])
        to = jnp.where(
            at == num_tracks, entry, column[jnp.minimum(at, search.size - 1)]
        )
        new = jnp.where((row == track[None]) & walking[None], to[None], new)
        at = jnp.where(source >= num_tracks, num_tracks, track)
        return at, new, walking & (track != search)

    start = jnp.broadcast_to(column[:, None], (num_tracks, num_tracks))
    carry = graph.goal, start, state.end < jnp.inf
    return jax.lax.while_loop(lambda carry: carry[2].any(), back, carry)[1]
