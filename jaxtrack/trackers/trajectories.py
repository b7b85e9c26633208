"""Trajectories: where each target has been since it was first detected.

A tracker that follows hypotheses reports with every scan the paths of its tracks
through the last W scans, smoothed, in the best hypothesis. Before these nothing
changes, so that whole trajectories of any length are put together from what was
reported when their scans left the window (`assemble`), and a scan costs the same
however long they are.

When a target that has not been detected since has ended is uncertain: it ended after
scan t with the probability that it was there then and not one scan later. A path ends
where that is likeliest, or goes on. Where only trajectories of targets that are there
now are asked for, a path is there from its beginning until now, or not at all.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import trajectories
    >>> alive = jnp.array([1.0, 1.0, 0.3, 0.25])  # in each of four scans
    >>> print(trajectories.ended(alive, jnp.ones(4, bool)))
    [ True  True False False]

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, sections III and VI.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.trackers import retrodiction
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.remembering import History
from jaxtrack.types import Array, Target

ROUNDING = 10.0  # errors of a probability


class Paths(NamedTuple):
    """N tracks through the last W scans, the newest last.

    Attributes:
        mean: Smoothed, [N, W, D].
        cov: [N, W, D, D].
        filtered: The mean by the detections until then, not smoothed, [N, W, D].
        alive_prob: That the target was there, if the best hypothesis is true, [N, W];
            of alive trajectories, that it is there now.
        alive: Where the reported path is, from its beginning to where it most likely
            ended, [N, W] (bool).
        label: [N] (int).
        begun: Which scans are not before the beginning of the track, [N, W] (bool),
            where only alive trajectories are followed; else None.
        birth_prob: How likely each target was born 0, 1, ..., A - 1 or more scans
            before its first detection, [N, A], if that was asked for; else None.
    """

    mean: Array
    cov: Array
    filtered: Array
    alive_prob: Array
    alive: Array
    label: Array
    begun: Array | None = None
    birth_prob: Array | None = None


class Trajectories(NamedTuple):
    """M trajectories over T scans.

    Attributes:
        label: [M] (int), -1 where there are not so many.
        mean: [T, M, D].
        alive: [T, M] (bool).
        dropped: How many found no room.
        birth_prob: How likely each was born so many scans before its first detection,
            [M, A], if the paths say so; else None.
    """

    label: Array
    mean: Array
    alive: Array
    dropped: Array
    birth_prob: Array | None = None


def ended(alive_prob: Array, begun: Array, never: Array | float = 0.0) -> Array:
    """Tells in which of W scans a target was there, by its likeliest end, [W] (bool).

    Args:
        alive_prob: That it was there, [W].
        begun: From where on, [W] (bool).
        never: How likely there never was one; what is left ended before the window.
    """
    after = jnp.append(alive_prob[1:], 0.0)
    at_end = jnp.where(begun, alive_prob - after, -1.0)
    before = 1 - jnp.where(begun, alive_prob, 0.0).max() - never
    slack = ROUNDING * jnp.finfo(alive_prob.dtype).eps
    last = jnp.where(at_end.max() >= before - slack, jnp.argmax(at_end), -1)
    return begun & (jnp.arange(begun.size) <= last)


def paths(
    target: Target,
    params: Any,
    history: History,
    trees: Forest,
    leaf: tuple[Array, Array],
    threshold: float,
    alive_only: bool = False,
) -> Paths:
    """Reports the last W scans.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        history: Of the last W scans.
        trees: The N trees now.
        leaf: That of the best hypothesis of each, -1 for none, and the one to show,
            both [N] (int).
        threshold: Probability that there ever was a target above which a track is
            reported; of alive trajectories, that there is one now.
        alive_only: Whether only targets that are there now are asked for.
    """
    best, shown = leaf
    tree, size = jnp.arange(len(shown)), len(history.interval)
    smoothed = retrodiction.smooth(target, params, history, shown)
    every = jax.vmap(jax.vmap(target.moments))
    moments = every(smoothed)
    before = every(jax.tree.map(lambda x: x[tree, shown], history.belief)).mean
    exists, gain, seen = jax.tree.map(lambda x: x[tree, shown], history[1:4])
    each = jax.vmap(retrodiction.existed, (None, None, None, 0))
    scan = jnp.arange(size)
    since = jnp.minimum(trees.age, history.num)
    begun = (size - 1 - scan)[None] < since[:, None]
    there = begun & (trees.label >= 0)[:, None]
    means = moments.mean, moments.cov, before
    born = history.birth_prob
    if born is not None:
        born = jnp.where((trees.label >= 0)[:, None], born, 0.0)
    if alive_only:
        prob = jnp.where(there, exists[:, -1:], 0.0)
        reported = (best >= 0) & (prob[:, -1] > threshold)
        alive = there & reported[:, None]
        return Paths(*means, prob, alive, trees.label, there, born)
    prob = jnp.where(
        there, jax.vmap(each, (0, 0, 0, None))(exists, gain, seen, scan), 0.0
    )
    reported = (best >= 0) & (prob.max(1) > threshold)
    assert history.log_never is not None, "begin gives it"
    never = jnp.exp(history.log_never[tree, shown])
    alive = jax.vmap(ended)(prob, there, never) & reported[:, None]
    return Paths(*means, prob, alive, trees.label, birth_prob=born)


class Latest(NamedTuple):
    """What was last said of each of T scans, of the N tracks that were kept then.

    Attributes:
        label: [T, N] (int), -1 where there is nothing.
        mean: Smoothed, [T, N, D].
        cov: [T, N, D, D].
        exists: [T, N] (bool).
        existence_prob: That the target was there, if the best hypothesis is true,
            [T, N].
    """

    label: Array
    mean: Array
    cov: Array
    exists: Array
    existence_prob: Array


def latest(reported: Paths, now: Array | int | None = None) -> Latest:
    """Picks what is known of every scan after a scan.

    Args:
        reported: Of T scans, [T, N, W, ...].
        now: After which scan, the last if None or beyond; later ones are empty.

    Returns:
        The `Latest`; of alive trajectories, those of targets that are there then.
    """
    num_scans, _, size = reported.alive.shape[:3]
    last = num_scans - 1
    now = jnp.clip(last if now is None else now, 0, last)
    scan = jnp.arange(num_scans)
    told = jnp.minimum(scan + size - 1, now)  # when a scan was last reported
    at = jnp.clip(scan - told + size - 1, 0, size - 1)
    mean, cov, alive, prob = (
        x[told, :, at]
        for x in (reported.mean, reported.cov, reported.alive, reported.alive_prob)
    )
    past, label = (scan <= now)[:, None], reported.label[told]
    if reported.begun is not None:
        same = label[:, :, None] == reported.label[now][None, None]  # [T, N, N now]
        same = same & reported.alive[now, :, -1][None, None]
        alive = same.any(2) & reported.begun[told, :, at]
        here = reported.alive_prob[now, :, -1]
        prob = jnp.where(same, here[None, None], 0.0).sum(2)
    alive, prob = alive & past, jnp.where(past, prob, 0.0)
    label = jnp.where(alive, label, -1)
    return Latest(label, mean, cov, alive, prob)


def assemble(
    reported: Paths, max_trajectories: int, now: Array | int | None = None
) -> Trajectories:
    """Puts the trajectories together that are known after a scan.

    Args:
        reported: Of T scans, [T, N, W, ...].
        max_trajectories: M.
        now: After which scan, the last if None.

    Returns:
        The `Trajectories`, in the order in which they began; those of scans after it
        are not there, nor, if only alive ones are followed, those that ended before.
    """
    label, mean, _, alive, _ = latest(reported, now)
    high = jnp.iinfo(label.dtype).max
    listed = jnp.where(label >= 0, label, high)
    found = jnp.unique(listed, size=max_trajectories + 1, fill_value=high)
    mine = (label[:, None] == found[None, :-1, None]) & alive[:, None]  # [T, M, N]
    slot = jnp.argmax(mine, axis=2)
    here = mine.any(2)
    mean = jnp.take_along_axis(mean, slot[:, :, None], axis=1)
    kept = jnp.where(found[:-1] < high, found[:-1], -1)
    first = jnp.sort(listed.ravel())
    different = jnp.append(first[1:] != first[:-1], True) & (first < high)
    dropped = different.sum() - (kept >= 0).sum()
    mean = jnp.where(here[:, :, None], mean, 0.0)
    born = reported.birth_prob
    if born is not None:
        # The same in all reports of a track.
        every, born = reported.label.ravel(), born.reshape(-1, born.shape[-1])
        order = jnp.argsort(every)
        own = born[order[jnp.searchsorted(every[order], kept)]]
        born = jnp.where((kept >= 0)[:, None], own, 0.0)
    return Trajectories(kept, mean, here, dropped, born)
