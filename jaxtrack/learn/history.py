"""What a fit came through, when it stops, and how it is kept on disk.

>>> import numpy as np
>>> from jaxtrack.learn import history
>>> losses = np.array([3.0, 2.0, 2.5, 2.0])
>>> history.settled(losses, patience=2, tolerance=0.0, noisy=False)
True
"""

import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxtrack.learn import slopes
from jaxtrack.study import parts
from jaxtrack.types import PyTree


class History(NamedTuple):
    """The S places that a fit came to, each before its step.

    Attributes:
        loss: [S].
        values: The learned arrays by path, each [S, ...].
        free: Their free numbers by path, each [S, ...].
    """

    loss: np.ndarray
    values: dict[str, np.ndarray]
    free: dict[str, np.ndarray]


class Now(NamedTuple):
    """Where a fit stands.

    Attributes:
        places: What `slopes.slope` told at each step so far, on the host.
        free: The free numbers of the next step.
        state: The optimiser's.
    """

    places: list[slopes.Slope]
    free: Any
    state: PyTree


def stacked(places: list[slopes.Slope]) -> History:
    """Returns the places as one history."""

    def join(several: list[Any]) -> dict[str, np.ndarray]:
        return {name: np.stack([x[name] for x in several]) for name in several[0]}

    return History(
        np.array([float(place.loss) for place in places]),
        join([place.values for place in places]),
        join([place.free for place in places]),
    )


def settled(
    losses: np.ndarray, patience: int | None, tolerance: float, noisy: bool
) -> bool:
    """Returns whether the loss has not fallen for some steps.

    Args:
        losses: [S].
        patience: How many steps; None if a fit never settles.
        tolerance: By less than this it does not fall.
        noisy: Whether every step draws anew, scans or particles: then the mean of these
            steps is compared with that of as many before, otherwise the least loss.
    """
    if patience is None or len(losses) < (2 if noisy else 1) * patience + (not noisy):
        return False
    recent, before = losses[-patience:], losses[:-patience]
    if noisy:
        return bool(recent.mean() >= before[-patience:].mean() - tolerance)
    return bool(recent.min() >= before.min() - tolerance)


def fault(place: slopes.Slope) -> str | None:
    """Returns what is not finite at a place, None if all is."""
    for what, told in (("value", place.values), ("gradient", place.gradient)):
        for name, numbers in told.items():
            if not np.isfinite(numbers).all():
                return f"the {what} of {name}" if what == "gradient" else name
    return None if np.isfinite(place.loss) else "the loss"


def write(path: pathlib.Path, identity: Mapping[str, Any], now: Now) -> None:
    """Keeps where a fit stands; whoever reads finds all of it or nothing."""
    leaves = jax.tree.leaves((now.free, now.state))
    arrays = {f"now {i}": np.asarray(x) for i, x in enumerate(leaves)}
    if now.places:
        places = jax.tree.map(lambda *x: np.stack(x), *now.places)
        stack = jax.tree.leaves(places)
        arrays |= {f"place {i}": x for i, x in enumerate(stack)}
    parts.write(path, identity, parts.Part(arrays, len(now.places), 0.0, {}))


def foreign(path: pathlib.Path, why: str) -> ValueError:
    """Returns the error of a fit that must not go on as another one."""
    return ValueError(
        f"{path} keeps another fit ({why}); give another directory or remove this file"
    )


def read(
    path: pathlib.Path, identity: Mapping[str, Any], start: Now, place: slopes.Slope
) -> Now:
    """Reads where a fit stands; the start if nothing is kept.

    Args:
        path: As of `write`.
        identity: What the fit must be.
        start: A fit's beginning.
        place: Shapes of a place.

    Raises:
        ValueError: Another fit is kept there.
    """
    try:
        part = parts.read(path, identity)
    except parts.ForeignPart as error:
        told = str(error).removeprefix(f"{path.parent} holds parts of another study (")
        raise foreign(path, told.rpartition(");")[0]) from None
    if part is None:
        return start

    def rebuilt(name: str, like: PyTree) -> PyTree:
        shapes, structure = jax.tree.flatten(like)
        found = [part.scores.get(f"{name} {i}") for i in range(len(shapes))]
        return jax.tree.unflatten(structure, found)

    free, state = rebuilt("now", (start.free, start.state))
    told = [np.shape(x) for x in jax.tree.leaves((free, state))]
    if told != [np.shape(x) for x in jax.tree.leaves((start.free, start.state))]:
        raise foreign(path, "it is by another optimiser")
    places = rebuilt("place", place)
    number = int(part.seconds)
    return Now(
        [jax.tree.map(lambda x, i=i: x[i], places) for i in range(number)], free, state
    )
