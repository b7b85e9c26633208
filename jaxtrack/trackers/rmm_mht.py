"""Randomized multiple-model multiple hypothesis tracking: RMM-MHT.

A window of S scans is kept. Every target may have had any sequence of models and of
detections in it; a linear programme shares targets out on these, and no detection is
used more than once in all. The shares tell how likely each detection is each target's,
and how likely each model moved it: no transition probabilities between models are
needed. By these the linear filter for random matrices moves all targets together past
the first scan of the window, which is then decided, and on to the present:

    leaves = grow(tracks, window)                 # models and detections, A11
    shares = linear programme(leaves)             # eq. 32
    hits, models = marginals(shares)              # eq. 33, 35
    tracks = filter(tracks, hits, models)         # eq. 40 to 47, one scan
    tracks = those not missed too often, and new ones, by a programme of their own (C1)
    estimate = filter(tracks, hits, models)       # over the rest of the window

Beyond the paper a track has a probability that its target exists, begun by its first
detection and updated by the expected likelihood ratio of each scan; a leaf says that it
does not. Tracks that begin by chance take nothing from the others, and are not
reported.

`log_evidence` is the log-density of the scan and of the association with the best
models, in the expectation that the programme maximises, given the past: summed over a
run it is that of the whole run. Where shares are 0 or 1 it is the joint density of the
scans and the best hypothesis of the window.

    >>> from jaxtrack.trackers import rmm_mht
    >>> tracker = rmm_mht.rmm_mht(num_scans=2, max_tracks=8)

Reference: Liu, Shen, Wang, Meng, Wang and Varshney, "Randomized multiple model multiple
hypothesis tracking", 2021, and the supplement of its journal version, Algorithm D1.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate, linearize
from jaxtrack.models.sensor import Timed
from jaxtrack.targets import imm
from jaxtrack.trackers import (
    association,
    rmm_birth,
    rmm_estimate,
    rmm_leaves,
    rmm_stack,
    rmm_tracks,
    rmm_window,
    thinning,
    undetected,
)
from jaxtrack.trackers.rmm_birth import Starts
from jaxtrack.trackers.rmm_leaves import Rules, Window
from jaxtrack.trackers.rmm_tracks import Limits, Tracks
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, Scan, Tracker


class State(NamedTuple):
    """What the next scan needs.

    Attributes:
        tracks: N tracks, before the window.
        window: The last S - 1 scans.
        undetected: U components, before the window.
        log_left: What the window contributed to the log-value, of tracks that stay.
        next_label: The first free label.
        key: Random key.
    """

    tracks: Tracks
    window: Window
    undetected: Undetected
    log_left: Array
    next_label: Array
    key: Array


class Settings(NamedTuple):
    """The maker's arguments."""

    rules: Rules
    starts: Starts
    limits: Limits
    num_scans: int
    max_detections: int
    max_undetected: int
    missed_prob: float
    report_threshold: float
    linear: bool


@functools.cache
def rmm_mht(
    num_scans: int = 2,
    method: linearize.Method = linearize.taylor,
    linear: bool = False,
    max_tracks: int = 16,
    max_leaves: int = 10,
    max_detections: int = 128,
    max_contested: int = 16,
    max_new: int = 8,
    max_undetected: int = 16,
    max_misses: int = 3,
    gate_prob: float = 0.9999,
    missed_prob: float = 0.5,
    unassigned_prob: float = 0.5,
    init_prob: float = 0.5,
    worth: float = 0.01,
    exist_threshold: float = 1e-3,
    report_threshold: float = 0.5,
) -> Tracker:
    """Makes a randomized multiple-model multiple hypothesis tracker.

    Its `Params` are those of `undetected`, with `targets.imm.Params` for the target, of
    which the switching only moves undetected ones. The values of sensor, detection and
    clutter may change from scan to scan, as where several sensors take turns: a scan in
    the window keeps its own.

    Args:
        num_scans: Scans in the window, S; the paper has 2.
        method: Of `linearize`; idle where the models are linear.
        linear: Whether the filter is linear in all detections so far, as in the paper:
            what is random then acts on the state as it was expected before any
            detection. Else it begins again from what is believed in every scan.
        max_tracks: Tracks kept, N.
        max_leaves: Sequences of detections of each, the likeliest, L; 2 at least.
        max_detections: Room for those of a scan, K.
        max_contested: Detections of a scan that several tracks may share.
        max_new: Tracks begun in a scan.
        max_undetected: Components kept of the intensity of undetected targets.
        max_misses: A track goes that was missed in so many scans in a row.
        gate_prob: P_G; 1 for no gate.
        missed_prob: A track was missed where that is likelier than this.
        unassigned_prob: A detection is free that is no track's with more probability
            than this.
        init_prob: A track begins if the programme gives it more than this share.
        worth: And if its target exists with more probability by the whole window.
        exist_threshold: A track goes where its target exists with less probability.
        report_threshold: A track is reported where it exists with more probability.

    Raises:
        ValueError: A setting that makes no sense.
    """
    sizes = {
        "num_scans": num_scans,
        "max_tracks": max_tracks,
        "max_leaves": max_leaves,
        "max_detections": max_detections,
        "max_contested": max_contested,
        "max_new": max_new,
        "max_undetected": max_undetected,
        "max_misses": max_misses,
    }
    shares = {
        "missed_prob": missed_prob,
        "unassigned_prob": unassigned_prob,
        "init_prob": init_prob,
        "exist_threshold": exist_threshold,
        "report_threshold": report_threshold,
    }
    _check(sizes, shares, gate_prob, worth)
    settings = Settings(
        Rules(method, gate_prob, max_leaves),
        Starts(max_new, max_contested, unassigned_prob, init_prob, worth),
        Limits(max_tracks, max_misses, exist_threshold),
        num_scans,
        max_detections,
        max_undetected,
        missed_prob,
        report_threshold,
        linear,
    )
    return Tracker(
        init=functools.partial(_init, settings), step=functools.partial(_step, settings)
    )


def _check(
    sizes: dict[str, int], shares: dict[str, float], gate_prob: float, worth: float
) -> None:
    """Raises a ValueError for a setting that makes no sense."""
    for name, size in sizes.items():
        # One leaf is that of no detection at all.
        least = 2 if name == "max_leaves" else 1
        if size < least:
            raise ValueError(f"{name} is {size}; give at least {least}")
    for name, share in shares.items():
        thinning.check_share(name, share)
    if not 0 < worth < 1:
        raise ValueError(f"worth is {worth}; give a probability between 0 and 1")
    gate.check(gate_prob)


def _init(settings: Settings, params: Params, key: Array) -> State:
    """Starts with the known targets, before a window in which nobody looked.

    Raises:
        ValueError: The target has no models, or what is known finds no room.
    """
    if not hasattr(params.target, "motions"):
        raise ValueError("target has no motions; give targets.imm.Params")
    keys = jax.random.split(key)
    hidden = undetected.begin(imm.imm(), params, settings.max_undetected, keys[0])
    like, dim = hidden.log_weight.dtype, params.target.layout.dim
    tracks = rmm_tracks.begin(
        params.start, settings.limits.max_tracks, jnp.zeros(dim, like)
    )
    sensor = params.target.sensor
    width = sensor.num_outputs + isinstance(sensor, Timed)
    blank = jnp.zeros(width, like)
    size, look = settings.num_scans - 1, rmm_leaves.look_of(params)
    window = rmm_window.begin(size, settings.max_detections, blank, look)
    zero, known = jnp.zeros((), like), (tracks.label >= 0).sum()
    return State(tracks, window, hidden, zero, known, keys[1])


def _step(
    settings: Settings, params: Params, state: State, scan: Scan
) -> tuple[State, rmm_estimate.Estimate]:
    """Decides the first scan of the window, and follows the tracks to the last."""
    scan, (key, seed) = association.filled(scan), jax.random.split(state.key)
    window, lost = rmm_window.push(state.window, scan, rmm_leaves.look_of(params))
    grow = jax.vmap(lambda x: rmm_leaves.grow(settings.rules, params, x, window))
    leaves = grow(rmm_stack.each(state.tracks.stack))
    course, found = rmm_tracks.associate(
        params, state.tracks, leaves, window, settings.starts.max_contested
    )
    stack = _advance(settings, params, state.tracks.stack, course, window, 0)
    tracks = rmm_tracks.past_first(
        state.tracks, stack, course, window, settings.missed_prob
    )
    how, hits = (settings.starts, settings.rules), course.hits.sum(0)
    new, hidden, unseen = rmm_birth.find(
        *how, params, state.undetected, hits, window, seed
    )
    fresh, path, log_begun = rmm_tracks.begun(params, new, window, state.next_label)
    tracks, course, over = rmm_tracks.kept(
        settings.limits, (tracks, fresh), (course, path)
    )
    hidden, out = undetected.reduce(hidden, settings.max_undetected)
    gained = found.log_value + log_begun - state.log_left - unseen
    estimate = rmm_estimate.report(
        _present(settings, params, tracks.stack, course, window),
        tracks,
        course,
        hidden.expected,
        settings.report_threshold,
        log_evidence=gained + rmm_window.log_clutter(params.clutter, scan),
        dropped=lost + out + new.dropped + over,
        integral=found.integral,
    )
    rest = jax.tree.map(lambda x: x[1:], window)
    label, left = state.next_label + new.begins.sum(), course.log_left.sum()
    return State(tracks, rest, hidden, left, label, key), estimate


def _present(
    settings: Settings,
    params: Params,
    stack: rmm_stack.Stack,
    course: rmm_tracks.Course,
    window: Window,
) -> rmm_stack.Stack:
    """Takes all targets through the rest of the window."""
    for n in range(1, settings.num_scans):
        stack = _advance(settings, params, stack, course, window, n)
    return stack


def _advance(
    settings: Settings,
    params: Params,
    stack: rmm_stack.Stack,
    course: rmm_tracks.Course,
    window: Window,
    n: int,
) -> rmm_stack.Stack:
    """Takes all targets through scan n of the window."""
    now = jax.tree.map(lambda x: x[n], window)
    target = rmm_leaves.through(params, now.through).target
    method, gate_prob, _ = settings.rules
    moved = rmm_stack.predict(method, target, stack, course.models[:, n], now.interval)
    hits = course.hits[:, n]
    total = hits.sum(0)
    prob = hits / jnp.maximum(total, 1.0)[None]
    room = min(2 * len(hits), total.size)
    some = jax.lax.top_k(total, room)[1]
    found = rmm_stack.update(
        method, target, moved, prob[:, some], now.detections[some], gate_prob
    )
    return found if settings.linear else rmm_stack.begun_again(found)
