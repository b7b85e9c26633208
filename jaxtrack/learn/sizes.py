"""Whether the sizes of a fit make sense, before anything is compiled.

>>> import numpy as np
>>> from jaxtrack.learn import sizes
>>> from jaxtrack.types import Scan
>>> one = Scan(np.zeros((9, 3, 2)), np.ones((9, 3), bool), np.ones(9))
>>> sizes.recordings(one, truth=None)
(False, 1, 9)
"""

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
    told: Any = scans.each[0] if hasattr(scans, "each") else scans
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
    for name, value, most in (
        ("batch", batch, num_recordings),
        ("window", window, num_scans),
    ):
        if value is not None and not 1 <= value <= most:
            raise ValueError(f"{name} is {value}; give a number from 1 to {most}")
    for name, value in counts.items():
        if value is not None and value < 1:
            raise ValueError(f"{name} is {value}; give at least 1")
