"""Whether what a fit is given makes sense, before anything is compiled.

>>> import numpy as np
>>> from jaxtrack.learn import sizes
>>> from jaxtrack.types import Scan
>>> one = Scan(np.zeros((9, 3, 2)), np.ones((9, 3), bool), np.ones(9))
>>> sizes.recordings(one, truth=None)
(False, 1, 9)
"""

import inspect
from typing import Any

import jax
import numpy as np

from jaxtrack.types import PyTree


def recordings(scans: PyTree, truth: PyTree) -> tuple[bool, int, int]:
    """Returns whether there is an axis of recordings, how many, and of how many scans.

    Args:
        scans: `Scan` or `Scans` with a leading [T] or [R, T].
        truth: Arrays with the same leading axes, or None.

    Raises:
        ValueError: They have not.
    """
    told: Any = scans.each[0] if getattr(scans, "each", None) else scans
    if not hasattr(told, "interval"):
        inner = ", which has them in .scan" if hasattr(told, "scan") else ""
        raise ValueError(
            f"scans are of type {type(scans).__name__}{inner}; give a Scan or Scans "
            "whose arrays begin with [T] or [R, T], or a list of some with [T]"
        )
    shape = np.shape(told.interval)
    if len(shape) not in (1, 2) or 0 in shape:
        raise ValueError(
            f"the scans' interval has shape {shape}; give [T] for one recording or "
            "[R, T] for several, at least one scan"
        )
    for name, tree in {"scans": scans, "truth": truth}.items():
        for x in jax.tree.leaves(tree):
            if np.shape(x)[: len(shape)] != shape:
                raise ValueError(
                    f"{name} hold an array of shape {np.shape(x)} beside intervals of "
                    f"shape {shape}; give all the same leading axes"
                )
    return len(shape) == 2, (1, *shape)[-2], shape[-1]


def check(
    num_recordings: int,
    num_scans: int,
    batch: int | None,
    window: int | None,
    **counts: int | None,
) -> None:
    """Raises a ValueError for a size that makes no sense.

    Args:
        num_recordings: R.
        num_scans: T.
        batch: Of R, or None.
        window: Of T, or None.
        **counts: At least 1 each, or None.
    """
    for name, value, most, all_of in (
        ("batch", batch, num_recordings, "recordings"),
        ("window", window, num_scans, "scans of the shortest recording"),
    ):
        if value is not None and not (_whole(value) and 1 <= value <= most):
            raise ValueError(
                f"{name} is {value!r}; give a number from 1 to {most}, all {all_of}"
            )
    check_counts(**{name: x for name, x in counts.items() if x is not None})


def check_counts(**counts: Any) -> None:
    """Raises a ValueError for what is no whole number of at least 1."""
    for name, value in counts.items():
        if not (_whole(value) and value >= 1):
            raise ValueError(f"{name} is {value!r}; give at least 1, a whole number")


def check_end(num_steps: int, tolerance: float) -> None:
    """Raises a ValueError if a fit would have no end, or none that makes sense."""
    if num_steps is None:
        raise ValueError("num_steps is None; give at least 1, a whole number")
    if not (isinstance(tolerance, int | float | np.number) and 0 <= tolerance < np.inf):
        raise ValueError(
            f"tolerance is {tolerance!r}; give a finite number, at least 0"
        )


def check_functions(
    optimizer: Any, loss: Any, prior: Any, has_truth: bool, uneven: bool = False
) -> None:
    """Raises a ValueError if one is none, or the loss does not go with the data.

    Args:
        optimizer: Of optax.
        loss: See `learn.loss`.
        prior: A function, or None.
        has_truth: Whether the loss is told the truth.
        uneven: Whether it must be told which scans count, see `learn.recordings`.
    """
    if not (hasattr(optimizer, "init") and hasattr(optimizer, "update")):
        raise ValueError(
            f"optimizer is {optimizer!r}; give one of optax, such as optax.adam(0.05)"
        )
    for name, function in {"loss": loss, "prior": prior}.items():
        if not (callable(function) or (name == "prior" and prior is None)):
            raise ValueError(f"{name} is {function!r}; give a function")
    takes = [_takes(loss, x) or _takes(loss, x, counts=None) for x in (2, 3)]
    if takes == [False, True] and not has_truth:
        raise ValueError("the loss needs the truth; give truth=")
    if takes == [True, False] and has_truth:
        raise ValueError(
            "truth is given, but the loss takes none; leave truth out, or give a loss "
            "(estimates, scans, truth), such as loss.gospa(...)"
        )
    if not any(takes):
        raise ValueError(
            "the loss does not take (estimates, scans), nor (estimates, scans, truth); "
            "give one of learn.loss, or a function of these"
        )
    if uneven and not _takes(loss, 2 + has_truth, counts=None):
        raise ValueError(
            "the recordings are of unequal length, and the loss takes no counts=; give "
            "one that is told which scans count, (estimates, scans, *, counts), or "
            "windows"
        )


def needs_counts(loss: Any, num_told: int) -> bool:
    """Returns whether a loss must be told which scans count.

    Args:
        loss: See `learn.loss`.
        num_told: Arrays that it is told besides the estimates.
    """
    return not _takes(loss, 1 + num_told)


def _takes(function: Any, number: int, **named: Any) -> bool:
    """Returns whether a function may be called with so many arguments, and named."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of what was compiled elsewhere
        return True
    try:
        bound = signature.bind(*range(number), **named)
    except TypeError:
        return False
    return bound.arguments.get("counts") is None  # no other in its place


def _whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
