"""Learning parameters by gradient, through any tracker.

    free, constrain = learn.unconstrain(params)       # for an optimiser of one's own
    result = learn.fit(tracker, params, scans)        # the whole of it

Parameters say what values they may have (`jaxtrack.constraints`); `learn.loss` has what
can be made small, by default the negative log-evidence, so that a fit is one of maximum
likelihood. `docs/learning.md` says what can be known from scans and what cannot.

    >>> import numpy as np
    >>> from jaxtrack import learn
    >>> from jaxtrack.models.clutter import UniformClutter
    >>> clutter = UniformClutter(np.array(6.0), low=np.zeros(2), high=np.ones(2))
    >>> free, constrain = learn.unconstrain(clutter)  # the box is fixed
    >>> for name, numbers in free.items():
    ...     print(name, numbers.round(2))
    rate [1.79]
    >>> print(constrain({"rate": np.array([0.0])}).rate)
    1.0
"""

import functools
import os
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import optax

from jaxtrack.learn import (
    bar,
    em,
    history,
    information,
    intervals,
    leaves,
    loop,
    loss,
    recordings,
    roughness,
    segments,
    sizes,
    slopes,
    supports,
)
from jaxtrack.learn.bar import progress_bar
from jaxtrack.learn.history import History
from jaxtrack.learn.information import Information
from jaxtrack.learn.loss import Loss, counted, evidence
from jaxtrack.learn.roughness import Rough
from jaxtrack.types import Array, PyTree, Tracker

__all__ = [
    "Fit",
    "Rough",
    "bar",
    "em",
    "fit",
    "history",
    "information",
    "intervals",
    "leaves",
    "loop",
    "loss",
    "progress_bar",
    "recordings",
    "roughness",
    "segments",
    "sizes",
    "slopes",
    "supports",
    "unconstrain",
]

DEFAULT = optax.adam(0.05)


class Fit(NamedTuple):
    """What a fit found.

    Attributes:
        params: Those of the least loss; with `batch` or `window`, whose losses cannot
            be compared, and after a divergence the last ones that were finite. Of a
            rough fit that did not diverge the mean of the last ones.
        history: What it came through.
        information: Standard errors and intervals of what was learned by path, and
            what they follow from; None where the loss is not the evidence, of all scans
            or of those held out, or there was no step.
        num_steps: How many steps it took.
        stopped: "converged", "diverged" or "out of steps".
        message: The same in a sentence.
    """

    params: PyTree
    history: History | None
    information: Information | None
    num_steps: int
    stopped: loop.Stopped
    message: str


def unconstrain(
    params: PyTree, where: leaves.Where | None = None
) -> tuple[leaves.Free, Callable[[leaves.Free], PyTree]]:
    """Returns free numbers for what is learned, and the way back.

    Args:
        params: Any tracker's `Params`, with numbers.
        where: Takes something like `params` and returns what of it is learned, arrays
            or subtrees, one or a tuple of them: `lambda p: (p.clutter.rate,
            p.target.sensor)`. By default all. The rest stays as it is; so do entries
            on the boundary of what they may be, what is declared `Fixed` unless it is
            named itself, and whole numbers, unless their field says what real numbers
            it may have: a `Positive` rate of 6 is learned as one of 6.0.

    Returns:
        Vectors by the path of their array ("clutter.rate"), and a function from such to
        `params`, which may be jitted and differentiated; of these vectors it gives
        `params` again, to rounding.

    Raises:
        ValueError: Nothing is left to be learned, `where` returns something else, a
            value breaks its constraint, or it is called while jax traces.
    """
    plan = leaves.plan(params, where)
    free = leaves.unconstrain(plan, params)
    return free, functools.partial(leaves.constrain, plan, params)


def fit(
    tracker: Tracker,
    params: PyTree,
    scans: PyTree,
    optimizer: optax.GradientTransformation = DEFAULT,
    *,
    where: leaves.Where | None = None,
    loss: Loss = evidence,
    truth: PyTree = None,
    prior: Callable[[Any], Array] | None = None,
    num_steps: int = 300,
    patience: int | None = 50,
    tolerance: float = 1e-6,
    batch: int | None = None,
    window: int | None = None,
    seed: int = 0,
    block: int = 16,
    segment: int | None = 1,
    errors: bool = True,
    rough: Rough | None = None,
    directory: str | os.PathLike[str] | None = None,
    progress: loop.Progress | None = None,
) -> Fit:
    """Learns parameters from recordings.

    Steps are compiled once for a tracker, an optimiser (the same object), a loss, a
    choice of what is learned and the sizes of the data.

    Args:
        tracker: Any tracker.
        params: Where to start, with numbers. The loss has many valleys: start near.
        scans: One recording [T], several of the same length [R, T], or a list of
            recordings [T_r] of any length and number of slots; every scan counts the
            same.
        optimizer: Of optax. It sees free numbers (`unconstrain`), most of them logs or
            log-odds, so that a step of 0.05 is some 5 percent.
        where: What is learned, see `unconstrain`.
        loss: Of `learn.loss`, or one's own.
        truth: Arrays [T] or [R, T] as the scans, or a list of them, which the loss
            gets as a third argument; None for none.
        prior: (params) -> log-density of the parameters themselves, for a fit of
            maximum a posteriori.
        num_steps: Steps at most.
        patience: After so many steps in a row that did not lower the loss by
            `tolerance` it has converged; None for never. Give more with small steps:
            Adam overshoots before it settles, and then takes more of them.
        tolerance: See `patience`; in units of the loss, which is per scan.
        batch: Recordings drawn anew for each step; by default all.
        window: Consecutive scans of each that are drawn anew for each step, at whose
            first the tracker begins afresh; by default all.
        seed: Of what is drawn, and of the trackers that draw: recording r has the same
            key in every step, unless `rough` says how many draws.
        block: Recordings that are computed side by side, see `engine.map_runs`.
        segment: Scans of which the way back begins with the state alone, which saves
            memory, and time too; see `segments.run`. None keeps all.
        errors: Whether to measure standard errors, by two gradients of all scans for
            each number that is learned.
        rough: For an evidence that is rough, of particles or of hypotheses that come
            and go: `Rough()` averages the last places, of an optimiser that comes to
            rest, and takes standard errors from slopes that lie apart, by some four
            gradients of each number for each draw. Patience is then at least that of
            twice as many steps. None for none of it.
        directory: Where the fit is kept, in `fit.npz`; run again, it goes on and gives
            the same numbers. The optimiser's settings are taken to be the same.
        progress: Called with the number of steps done, that of all, and the loss;
            `progress_bar` makes one.

    Returns:
        The parameters, and how well they are known.

    Raises:
        ValueError: A number that makes no sense, scans that do not fit, a loss that
            does not go with `truth` or returns no scalar, a directory that holds
            another fit, or a reason of `unconstrain`.
    """
    sizes.check_end(num_steps, tolerance)
    roughness.check(rough, num_steps)
    scans, truth, length = recordings.stack(scans, truth)
    several, number, total = sizes.recordings(scans, truth)
    uneven = length is not None and window is None
    sizes.check_functions(optimizer, loss, prior, truth is not None, uneven)
    shortest = total if length is None else int(length.min())
    rest = {"num_steps": num_steps, "patience": patience, "segment": segment}
    sizes.check(number, shortest, batch, window, block=block, **rest)
    plan = leaves.plan(params, where)
    redraw = rough is not None and rough.draws is not None
    of_a_step = batch, window, block, segment, redraw
    problem = slopes.Problem(tracker, plan, loss, prior, *of_a_step)
    data = slopes.gather(scans, truth, seed, several, length)
    task = loop.Task(problem, optimizer, params, data, seed)
    if rough is not None and patience is not None:
        patience = max(patience, 2 * rough.average)
    rules = loop.Rules(num_steps, patience, tolerance)
    end = loop.walk(task, rules, progress, directory)
    if not end.places:
        return Fit(params, None, None, 0, end.stopped, end.message)
    told = history.stacked(end.places)
    last = slopes.is_noisy(problem) or end.stopped == "diverged"
    free = end.places[loop.best_of(told, last)].free
    if rough is not None and end.stopped != "diverged":
        free = roughness.mean_of(told, rough)
    found = jax.jit(leaves.constrain, static_argnums=0)(plan, params, free)
    known = None
    if errors and counted(loss, total) is not None:
        known = information.observed(problem, params, data, free, rough)
    return Fit(found, told, known, len(told.loss), end.stopped, end.message)
