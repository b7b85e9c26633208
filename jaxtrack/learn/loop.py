"""The loop of a fit: slopes, a step of the optimiser, and what is told of them.

>>> import numpy as np
>>> from jaxtrack.learn import history, loop
>>> told = history.History(np.array([3.0, 1.0, 2.0]), values={}, free={})
>>> loop.best_of(told, noisy=False), loop.best_of(told, noisy=True)
(1, 2)
"""

import functools
import hashlib
import pathlib
import re
import time
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
import optax

from jaxtrack.learn import history, leaves, slopes
from jaxtrack.study import parts
from jaxtrack.types import Array, PyTree

Stopped = Literal["converged", "diverged", "out of steps"]
Progress = Callable[[int, int, float], None]
KEPT_EVERY = 10.0  # seconds
SAME = 1e3  # roundings by which another processor may tell the same loss


class Rules(NamedTuple):
    """When a fit ends.

    Attributes:
        num_steps: At most so many steps, also counting those before it was resumed.
        patience: Steps without progress after which it has converged; None for never.
        tolerance: Less than this is no progress.
    """

    num_steps: int
    patience: int | None
    tolerance: float


class Task(NamedTuple):
    """A fit from its start.

    Attributes:
        problem: What is made small.
        optimizer: Of optax.
        params: Those at the start.
        data: Of all recordings.
        seed: Of batches, windows and draws.
    """

    problem: slopes.Problem
    optimizer: optax.GradientTransformation
    params: PyTree
    data: slopes.Data
    seed: int


class Walk(NamedTuple):
    """A fit that came to its end.

    Attributes:
        places: What was told at each step, all finite.
        stopped: Why it ended.
        message: The same in a sentence.
    """

    places: list[slopes.Slope]
    stopped: Stopped
    message: str


def walk(
    task: Task,
    rules: Rules,
    progress: Progress | None = None,
    directory: parts.Directory | None = None,
) -> Walk:
    """Goes on from the start, or from where the fit stands that is kept.

    Args:
        task: What is fitted.
        rules: When it ends.
        progress: Called with steps done and to be done, and the loss.
        directory: Where the fit is kept, None for nowhere.

    Raises:
        ValueError: Another fit is kept there.
    """
    store = None if directory is None else (_path(directory), _identity(task))
    base = jax.random.key(task.seed)
    now = _begin(task, store, jax.random.fold_in(base, 0))
    kept = time.monotonic()
    try:
        while (end := _end(now.places, task.problem, rules)) is None:
            done = len(now.places)
            key = jax.random.fold_in(base, done)
            there = slopes.slope(task.problem, task.params, task.data, now.free, key)
            place = jax.device_get(there)
            if wrong := history.fault(place):
                message = f"diverged at step {done}: {wrong} is not finite"
                return Walk(now.places, "diverged", message)
            free, state = advance(*task[:4], there, now.state, key)
            now = history.Now([*now.places, place], free, state)
            if progress is not None:
                progress(done + 1, rules.num_steps, float(place.loss))
            if store is not None and time.monotonic() - kept > KEPT_EVERY:
                history.write(*store, now)
                kept = time.monotonic()
        return end
    finally:
        if store is not None:
            history.write(*store, now)


def _path(directory: parts.Directory) -> pathlib.Path:
    return pathlib.Path(directory, "fit.npz")


def _identity(task: Task) -> dict[str, Any]:
    """Returns what tells this fit from others."""
    problem = task.problem
    data = task.data
    values = task.params, data.scans, data.truth, data.length
    return {
        "seed": task.seed,
        "batch": problem.batch,
        "window": problem.window,
        "block": problem.block,
        "segment": problem.segment,
        "tracker": hashlib.sha256(_name(problem.tracker).encode()).hexdigest()[:16],
        "loss": _name(problem.loss),
        "prior": _name(problem.prior),
        "learned": [leaf.path for leaf in problem.plan],
        "fingerprint of code and values": parts.fingerprint(values),
    }


def _name(function: Any) -> str:
    """Returns what a function is called, and the settings that are bound to it."""
    return re.sub(" at 0x[0-9a-f]+", "", repr(function))  # another in each process


def _begin(task: Task, store: Any, key: Array) -> history.Now:
    """Returns where a fit begins, or goes on; `key` is that of its first step."""
    free = leaves.unconstrain(task.problem.plan, task.params)
    start = history.Now([], free, jax.jit(task.optimizer.init)(free))
    if store is None:
        return start
    ask = functools.partial(slopes.slope, task.problem)
    given = task.params, task.data, free, key
    path, identity = store
    now = history.read(path, identity, start, jax.eval_shape(ask, *given))
    if now.places:
        # What a closure holds has no name; the first loss tells it.
        here, kept = jax.device_get(ask(*given)).loss, now.places[0].loss
        if not abs(here - kept) <= SAME * np.finfo(here.dtype).eps * (1 + abs(kept)):
            why = f"the first loss is {kept!s}, not {here!s}"
            raise history.foreign(path, why)
    return now


def _end(
    places: list[slopes.Slope], problem: slopes.Problem, rules: Rules
) -> Walk | None:
    """Returns the end of a fit that has come to it."""
    losses = np.array([float(place.loss) for place in places])
    noisy = slopes.is_noisy(problem)
    if history.settled(losses, rules.patience, rules.tolerance, noisy):
        message = (
            f"the loss did not fall by {rules.tolerance:g} in {rules.patience} steps"
        )
        return Walk(places, "converged", message)
    if len(places) >= rules.num_steps:
        return Walk(places, "out of steps", f"all {rules.num_steps} steps are done")
    return None


@functools.partial(jax.jit, static_argnums=(0, 1))
def advance(
    problem: slopes.Problem,
    optimizer: optax.GradientTransformation,
    params: PyTree,
    data: slopes.Data,
    place: slopes.Slope,
    state: PyTree,
    key: Array,
) -> tuple[leaves.Free, PyTree]:
    """Takes a step of the optimiser; one that wants to may ask for more values."""

    def value(free: leaves.Free) -> Array:
        return slopes.value_of(problem, params, free, data, key)

    told = {"value": place.loss, "grad": place.gradient, "value_fn": value}
    extended = optax.with_extra_args_support(optimizer)
    updates, state = extended.update(place.gradient, state, place.free, **told)
    moved: Any = optax.apply_updates(place.free, updates)
    return moved, state


def best_of(told: history.History, noisy: bool) -> int:
    """Returns the step with the least loss; the last where each draws anew."""
    return len(told.loss) - 1 if noisy else int(np.argmin(told.loss))
