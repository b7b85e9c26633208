"""How well learned numbers are known: standard errors from the observed information.

The information is the Hessian of the total negative log-evidence, less the log-prior,
in the free numbers, by central differences of its exact slopes: next to each other, or
far enough apart to see over what makes them rough. Standard errors are
those of the parameters themselves, by the delta method. A parameter that the scans tell
nothing about, alone or apart from others, has an infinite one; one that lies along a
direction in which the information is negative, so that the place is not at a maximum,
has NaN, unless this would be a hundredth of its variance if it were positive. Where the
evidence is an approximation they are as good as that.

    >>> import numpy as np
    >>> from jaxtrack.learn import information
    >>> told = np.array([[4.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    >>> print(information.std_of(np.eye(3), told))  # of the last two only the sum
    [0.5 inf inf]
    >>> print(information.std_of(np.eye(2), np.diag([4.0, -1.0])))
    [0.5 nan]

Reference: Efron and Hinkley, "Assessing the accuracy of the maximum likelihood
estimator: observed versus expected Fisher information", Biometrika 65(3), 1978.
"""

import functools
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxtrack.learn import intervals, leaves, roughness, slopes
from jaxtrack.learn.loss import evidence
from jaxtrack.types import PyTree

# By what share of its variance a direction of negative information may bear on a
# parameter, were it positive, before nothing is told of that one.
ASIDE = 0.01
APART = 3  # no key of a step


class Information(NamedTuple):
    """What n free numbers are known by.

    Attributes:
        names: The entry that each stands at, [n].
        hessian: The observed information, [n, n].
        cov: Covariance of the free numbers, its inverse, [n, n]; what there is no
            information about has an infinite variance, and counts as independent;
            so does what has NaN.
        std_error: Of the learned arrays by path; 0 where an entry does not move,
            infinite where nothing is known, NaN where negative information bears on it
            (in float32 rounding may make it so where next to nothing is known).
            They are meant for a maximum: a fit that ran out of steps may not be at one,
            even if they are finite.
        interval: Two of these to each side, on a scale that goes with what the number
            may be (`intervals`), [..., 2] by path.
    """

    names: list[str]
    hessian: np.ndarray
    cov: np.ndarray
    std_error: dict[str, np.ndarray]
    interval: dict[str, np.ndarray]


def observed(
    problem: slopes.Problem,
    params: PyTree,
    data: slopes.Data,
    free: leaves.Free,
    rough: roughness.Rough | None = None,
) -> Information:
    """Measures the information at free numbers, by 2 n gradients.

    Args:
        problem: With a loss that is log-evidence, see `loss.counted`; all of the data
            count, but for the scans that come before those held out. Where windows
            were drawn these come to be held out, too.
        params: Those at the start.
        data: Of all recordings.
        free: Where.
        rough: How far apart slopes are compared, by some 4 n gradients, and over how
            many draws, each with as many; None for as near as rounding allows.
    """
    whole = problem._replace(batch=None, window=None)
    if problem.window is not None:
        whole = whole._replace(loss=evidence)
    vector, unravel = ravel_pytree(free)
    centre = np.asarray(vector)
    draws = None if rough is None else rough.draws
    key = jax.random.fold_in(data.keys[0], APART)
    keys = jax.random.split(key, draws or 1)
    total = int(slopes.num_scans(whole, data))

    def gradient(vector: Any) -> np.ndarray:
        at = functools.partial(slopes.slope, whole, params, data, unravel(vector))
        told = [at(key).gradient for key in keys]
        each = [[np.ravel(x[name]) for name in sorted(x)] for x in told]
        return total * np.mean([np.concatenate(x) for x in each], axis=0)

    if rough is None:
        hessian = _near(gradient, centre)
    else:
        hessian = roughness.secants(gradient, centre, rough.apart)
    hessian = (hessian + hessian.T) / 2
    rate = _jacobian(problem.plan, params, free)
    tolerance = 10 * float(np.sqrt(np.finfo(centre.dtype).eps))
    std_error = {
        name: std_of(
            np.asarray(rows, float).reshape(-1, len(centre)), hessian, tolerance
        ).reshape(rows.shape[:-1])
        for name, rows in rate.items()
    }
    names, cov = leaves.entries(problem.plan, params), cov_of(hessian, tolerance)
    interval = _intervals(problem.plan, params, free, std_error)
    return Information(names, hessian, cov, std_error, interval)


def _near(gradient: roughness.Gradient, centre: np.ndarray) -> np.ndarray:
    """Returns the Hessian from slopes as near as rounding allows."""
    step = np.finfo(centre.dtype).eps ** (1 / 3) * np.maximum(1, np.abs(centre))
    rows = [
        roughness.difference(gradient, centre, i, float(size))
        for i, size in enumerate(step)
    ]
    return np.stack(rows)


def std_of(
    rows: np.ndarray, hessian: np.ndarray, tolerance: float = 1.5e-7
) -> np.ndarray:
    """Returns the standard deviations of linear functions of the free numbers.

    Args:
        rows: The functions, [E, n].
        hessian: The information, [n, n].
        tolerance: Information below this, where each number alone has 1, is none.

    Returns:
        [E]; infinite for what depends on something that there is no information about,
        NaN for what depends on something of which it is negative, by more than
        `ASIDE` of the variance, and for everything if some of it is not finite.
    """
    if not np.isfinite(hessian).all():
        return np.full(len(rows), np.nan)
    value, vector = _axes(hessian)
    square = (rows @ vector) ** 2
    known, negative = value > tolerance, value < -tolerance
    matters = square > tolerance * square.sum(1, keepdims=True)
    each = square / np.where(known | negative, np.abs(value), 1.0)
    variance = np.where(known, each, 0.0).sum(1)
    std = np.where((matters & ~known & ~negative).any(1), np.inf, np.sqrt(variance))
    bears = (matters & negative).any(1)
    bears = bears & (np.where(negative, each, 0.0).sum(1) > ASIDE * variance)
    return np.where(bears, np.nan, std)


def cov_of(hessian: np.ndarray, tolerance: float = 1.5e-7) -> np.ndarray:
    """Returns the covariance of the free numbers, see `Information`."""
    if not np.isfinite(hessian).all():
        return np.full(hessian.shape, np.nan)
    value, vector = _axes(hessian)
    known = value > tolerance
    cov = (vector * np.where(known, 1 / np.where(known, value, 1.0), 0.0)) @ vector.T
    std = std_of(np.eye(len(hessian)), hessian, tolerance)
    apart = ~np.isfinite(std)
    cov[apart] = cov[:, apart] = 0.0
    cov[apart, apart] = std[apart]
    return cov


def _axes(hessian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the information along axes [n] and these, the columns of [n, n].

    Axes of numbers scaled so that each alone has an information of 1.
    """
    alone = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    scale = np.where(alone > 0, alone, 1.0)
    value, vector = np.linalg.eigh(hessian / np.outer(scale, scale))
    return value, vector / scale[:, None]


def _intervals(
    plan: leaves.Plan,
    params: PyTree,
    free: leaves.Free,
    std_error: dict[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Returns the intervals of the learned arrays, bounded by what was found."""
    values = jax.tree.leaves(params)
    for leaf, value in zip(plan, _values(plan, params, free), strict=True):
        values[leaf.index] = np.asarray(value, float)
    intervals_of = {}
    for leaf in plan:
        bounds = leaves.bounds_of(leaf, values.__getitem__)
        told = values[leaf.index], std_error[leaf.path], bounds.low, bounds.high
        intervals_of[leaf.path] = intervals.interval(leaf.constraint.kind, *told)
    return intervals_of


@functools.partial(jax.jit, static_argnums=0)
def _values(plan: leaves.Plan, params: PyTree, free: leaves.Free) -> list[jax.Array]:
    told = leaves.values_of(plan, params, free)
    return [told[leaf.path] for leaf in plan]


@functools.partial(jax.jit, static_argnums=0)
def _jacobian(
    plan: leaves.Plan, params: PyTree, free: leaves.Free
) -> dict[str, jax.Array]:
    """Returns the slopes of the learned arrays, each [..., n]."""
    vector, unravel = ravel_pytree(free)
    return jax.jacfwd(lambda x: leaves.values_of(plan, params, unravel(x)))(vector)
