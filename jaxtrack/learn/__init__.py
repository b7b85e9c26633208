"""Learning parameters by gradient, through any tracker.

Parameters say what values they may have (`jaxtrack.constraints`). `unconstrain` turns
them into free numbers, and back, for an optimiser of one's own.

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
from collections.abc import Callable

from jaxtrack.learn import leaves, supports
from jaxtrack.types import PyTree

__all__ = ["leaves", "supports", "unconstrain"]


def unconstrain(
    params: PyTree, where: leaves.Where | None = None
) -> tuple[leaves.Free, Callable[[leaves.Free], PyTree]]:
    """Returns free numbers for what is learned, and the way back.

    Args:
        params: Any tracker's `Params`, with numbers.
        where: Takes something like `params` and returns what of it is learned, arrays
            or subtrees, one or a tuple of them: `lambda p: (p.clutter.rate,
            p.target.sensor)`. By default all. The rest stays as it is; so do entries
            on the boundary of what they may be, whole numbers, and what is declared
            `Fixed` unless it is named itself.

    Returns:
        Vectors by the path of their array ("clutter.rate"), and a function from such to
        `params`, which may be jitted and differentiated; of these vectors it gives
        `params` itself.

    Raises:
        ValueError: Nothing is left to be learned, `where` returns something else, or a
            value breaks its constraint.
    """
    plan = leaves.plan(params, where)
    free = leaves.unconstrain(plan, params)
    return free, functools.partial(leaves.constrain, plan, params)
