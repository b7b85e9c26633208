"""Tracks of RMM-MHT: their state, how they share the window, and which of them stay.

>>> from jaxtrack.trackers import rmm_tracks
>>> rmm_tracks.Tracks._fields
('stack', 'existence_prob', 'label', 'misses')

Reference: Liu, Shen, Wang and Meng, "Randomized multimodel multiple hypothesis
tracking", 2021, supplement, appendices C and D.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.linalg import safe_log
from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.trackers import rmm_association, rmm_leaves, rmm_stack
from jaxtrack.trackers.rmm_birth import New
from jaxtrack.trackers.rmm_leaves import Leaves, Window
from jaxtrack.trackers.rmm_stack import Stack
from jaxtrack.types import Array, Gaussian


class Tracks(NamedTuple):
    """N tracks.

    Attributes:
        stack: What is believed of all targets together.
        existence_prob: [N].
        label: Which target it is, -1 for an empty slot, [N] (int).
        misses: Scans in a row in which it was missed, [N] (int).
    """

    stack: Stack
    existence_prob: Array
    label: Array
    misses: Array


class Course(NamedTuple):
    """What the scans of a window say of N tracks.

    Attributes:
        hits: How likely each caused each detection, [N, S, K].
        models: How likely it moved by each model, [N, S, M].
        missed: How likely it was missed in the first scan, [N].
        then: That its target exists after the first scan, [N].
        now: And after the last, [N].
        log_left: What the later scans contribute to the log-value, [N].
    """

    hits: Array
    models: Array
    missed: Array
    then: Array
    now: Array
    log_left: Array


class Limits(NamedTuple):
    """Which tracks stay: settings, all of them static.

    Attributes:
        max_tracks: Capacity N.
        max_misses: A track goes that was missed in so many scans in a row.
        exist_threshold: So does one that exists with less probability.
    """

    max_tracks: int
    max_misses: int
    exist_threshold: float


def begin(start: MultiBernoulliBirth | None, size: int, like: Array) -> Tracks:
    """Makes the tracks of the targets that are known, and empty slots.

    Args:
        start: Targets that may be known, or None.
        size: Capacity N.
        like: Any array [D] of the wanted kind.

    Raises:
        ValueError: More targets are known than the capacity.
    """
    eye = jnp.eye(like.size, dtype=like.dtype)
    mean = jnp.zeros((size, like.size), like.dtype)
    cov = jnp.broadcast_to(eye[None], (size, *eye.shape))
    prob, label = jnp.zeros(size, like.dtype), jnp.full(size, -1, int)
    if start is not None:
        known = len(start.existence_prob)
        if known > size:
            raise ValueError(
                f"start has {known} targets and max_tracks is {size}; make room for "
                "them"
            )
        mean, cov = mean.at[:known].set(start.mean), cov.at[:known].set(start.cov)
        prob = prob.at[:known].set(start.existence_prob)
        label = label.at[:known].set(jnp.arange(known))
    stack = rmm_stack.stack(Gaussian(mean, cov))
    return Tracks(stack, prob, label, jnp.zeros(size, jnp.int32))


def associate(
    params: Any, tracks: Tracks, leaves: Leaves, window: Window, max_contested: int
) -> tuple[Course, rmm_association.Shares]:
    """Shares tracks out on their leaves (eq. 32).

    The score of a leaf is that of the supplement's A11 where the target exists, and
    that of its detections being false, 0, where it does not: the log of the mean.

    Args:
        params: The tracker's `Params`.
        tracks: Before the window.
        leaves: Of each track, [N, L].
        window: S scans.
        max_contested: As in `rmm_association.share`.
    """
    there, prob = tracks.label >= 0, tracks.existence_prob
    log_survive = _survival(params, tracks, window)  # [N, S]
    log_absent = _log_rest(prob, log_survive[:, 0])[:, None]
    possible = there[:, None] & (leaves.log_score > -jnp.inf)
    ratio = jnp.where(possible, leaves.log_score, 0.0)
    score = jnp.logaddexp(safe_log(prob)[:, None] + ratio, log_absent)
    score = jnp.where(possible, score, -jnp.inf)
    past, num = leaves.past, window.valid.shape[1]
    found = rmm_association.share(score, past, num, max_contested)
    hits = rmm_association.hits(found.leaf, past, num)
    models = rmm_association.models(found.leaf, leaves.mode_prob)
    share = found.leaf
    first, whole = _mean(share, leaves.log_first), _mean(share, leaves.log_score)
    then, log_norm = _revised(prob, first, log_survive[:, 0])
    now, _ = _revised(then, whole - first, log_survive[:, 1:].sum(1))
    left = jnp.where(there, _mean(share, score) - log_norm, 0.0)
    missed = 1 - hits[:, 0].sum(1)
    empty = jnp.zeros_like(then)
    then, now = (jnp.where(there, x, empty) for x in (then, now))
    return Course(hits, models, missed, then, now, left), found


def past_first(
    tracks: Tracks, stack: Stack, course: Course, window: Window, missed_prob: float
) -> Tracks:
    """Returns the tracks after the first scan of the window.

    Args:
        tracks: Before it.
        stack: What is believed after it.
        course: What the window says of them.
        window: S scans.
        missed_prob: A track was missed where that is likelier.
    """
    looked = window.looked[0]
    missed = looked & (course.missed > missed_prob)
    misses = jnp.where(looked & ~missed, 0, tracks.misses + missed)
    misses = misses.astype(tracks.misses.dtype)
    return Tracks(stack, course.then, tracks.label, misses)


def begun(
    params: Any, new: New, window: Window, next_label: Array
) -> tuple[Tracks, Course, Array]:
    """Makes tracks, after the first scan, of those that begin in it.

    Args:
        params: The tracker's `Params`.
        new: J tracks that may begin.
        window: S scans.
        next_label: The first free label.

    Returns:
        J tracks, with empty slots among them; what the later scans say of them; and
        what all scans contribute to the log-value.
    """
    stack = rmm_stack.stack(new.belief)
    then = jnp.where(new.begins, jax.nn.sigmoid(new.log_first), 0.0)
    none = jnp.zeros(len(then), jnp.int32)
    label = jnp.where(new.begins, next_label + jnp.cumsum(new.begins) - 1, -1)
    tracks = Tracks(stack, then, label, none)
    rest = jax.tree.map(lambda x: x[1:], window)
    log_survive = _survival(params, tracks, rest).sum(1)
    total = new.share.sum(1)
    share = new.share / jnp.where(total > 0, total, 1.0)[:, None]
    gain = _mean(share, new.leaves.log_score)
    now, _ = _revised(then, gain, log_survive)
    num, first = window.valid.shape[1], jnp.zeros((len(then), 1), then.dtype)
    hits = rmm_association.hits(share, new.leaves.past, num)
    models = rmm_association.models(share, new.leaves.mode_prob)
    fill = ((0, 0), (1, 0), (0, 0))
    log_left = jnp.where(new.begins, jax.nn.log_sigmoid(new.log_first) + gain, 0.0)
    course = Course(
        jnp.pad(hits, fill), jnp.pad(models, fill), first[:, 0], then, now, log_left
    )
    odds = jnp.where(new.begins, new.log_first, -jnp.inf)
    return tracks, course, (log_left + jnp.logaddexp(odds, 0.0)).sum()


def kept(
    limits: Limits, tracks: tuple[Tracks, Tracks], courses: tuple[Course, Course]
) -> tuple[Tracks, Course, Array]:
    """Keeps the likeliest tracks, old or new; the oldest come first.

    Args:
        limits: Settings.
        tracks: Old and new, N and J.
        courses: What the window says of them.

    Returns:
        N tracks, what the window says of them, and the expected number of targets that
        found no room.
    """
    stack = rmm_stack.joined(*(x.stack for x in tracks))
    both = jax.tree.map(lambda *x: jnp.concatenate(x), *(x[1:] for x in tracks))
    course = jax.tree.map(lambda *x: jnp.concatenate(x), *courses)
    prob, label, misses = both
    stays = (label >= 0) & (misses < limits.max_misses)
    stays = stays & (course.now >= limits.exist_threshold)
    rank = jax.lax.stop_gradient(jnp.where(stays, course.now, -1.0))
    index = jnp.sort(jax.lax.top_k(rank, limits.max_tracks)[1])
    there = stays[index]
    course = jax.tree.map(lambda x: x[index], course)
    now = jnp.where(there, course.now, 0.0)
    course = course._replace(now=now, log_left=jnp.where(there, course.log_left, 0.0))
    found = Tracks(
        rmm_stack.cleared(rmm_stack.chosen(stack, index), there),
        jnp.where(there, prob[index], 0.0),
        jnp.where(there, label[index], -1),
        jnp.where(there, misses[index], 0),
    )
    hits = jnp.where(there[:, None, None], course.hits, 0.0)
    over = jnp.where(stays, rank, 0.0).sum() - now.sum()
    return found, course._replace(hits=hits), jnp.maximum(over, 0.0)


def _survival(params: Any, tracks: Tracks, window: Window) -> Array:
    """Returns log-probabilities to survive each interval, over all models, [N, S]."""

    def one(mean: Array, interval: Array, looked: Array) -> Array:
        each = rmm_leaves.survival(params.target, mean, interval, looked)
        return safe_log(jnp.exp(each).mean())

    across = jax.vmap(one, (None, 0, 0))
    return jax.vmap(across, (0, None, None))(
        tracks.stack.mean, window.interval, window.looked
    )


def _mean(share: Array, score: Array) -> Array:
    """Returns the means of scores [N, L] by shares [N, L], of leaves that have any."""
    used = share > 0
    return jnp.where(used, share * jnp.where(used, score, 0.0), 0.0).sum(1)


def _log_rest(prob: Array, log_survive: Array) -> Array:
    """Returns the log-probability that a target does not exist after an interval."""
    return safe_log(jnp.maximum(1 - prob * jnp.exp(log_survive), 0.0))


def _revised(prob: Array, log_ratio: Array, log_survive: Array) -> tuple[Array, Array]:
    """Returns probabilities to exist, given what scans say, and the log-normaliser.

    Args:
        prob: Before, [N].
        log_ratio: Log-likelihood ratio, to survive included, [N].
        log_survive: Log-probability to survive, [N].
    """
    alive, absent = safe_log(prob) + log_ratio, _log_rest(prob, log_survive)
    none = (alive == -jnp.inf) & (absent == -jnp.inf)
    norm = jnp.logaddexp(alive, jnp.where(none, 0.0, absent))
    return jnp.exp(alive - norm), norm
