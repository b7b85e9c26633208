"""The exact selection, its linear relaxation and the m best, on the host.

SciPy's HiGHS solves the 0-1 programme by branch and bound, over one variable for each
leaf, with one equation for each tree and one inequality for each detection. For single
problems, and as the reference of what runs inside `jax.jit`.

    >>> import numpy as np
    >>> from jaxtrack.assign.multiscan import host, problem
    >>> log_score = np.array([[3.0, 0.0], [5.0, 4.0]])
    >>> detection = np.array([[[0], [-1]], [[0], [-1]]])
    >>> given = problem.Problem(log_score, detection)
    >>> found = host.exact(given, num_detections=1)
    >>> print(found.leaf, found.log_score)
    [0 1] 7.0
    >>> print([float(one.log_score) for one in host.m_best(given, 1, m=5)])
    [7.0, 5.0, 4.0]

References: Morefield, "Application of 0-1 integer programming to multitarget tracking
problems", IEEE Trans. Automatic Control 22(3), 1977; Huangfu and Hall, "Parallelizing
the dual revised simplex method", Mathematical Programming Computation 10, 2018.
"""

import importlib
from typing import Any, NamedTuple

import numpy as np

from jaxtrack.assign.multiscan.problem import Answer, Problem

SOLVED, STOPPED = 0, 1


class Relaxation(NamedTuple):
    """The linear relaxation's optimum.

    Attributes:
        share: Of each leaf in its tree, [N, L]; zero if not `feasible`.
        log_score: Sum of share * score; -inf if not `feasible`.
        price: Of each detection, [S, K].
        feasible: Whether there are any such shares (bool).
    """

    share: np.ndarray
    log_score: float
    price: np.ndarray
    feasible: bool


class _Programme(NamedTuple):
    """Maximise score @ x, with matrix @ x from `low` to `high`, x from 0 to 1.

    Attributes:
        score: Of each leaf that is possible, [V].
        tree: Its tree, [V].
        leaf: Its number there, [V].
        matrix: Sparse, [N + S K, V].
        low: [N + S K].
        high: [N + S K].
    """

    score: np.ndarray
    tree: np.ndarray
    leaf: np.ndarray
    matrix: Any
    low: np.ndarray
    high: np.ndarray


def exact(
    problem: Problem, num_detections: int, time_limit: float | None = None
) -> Answer:
    """Finds the best selection.

    Args:
        problem: [N, L] and [N, L, S], of NumPy or JAX.
        num_detections: K, detections of a scan at most.
        time_limit: Seconds, after which the best selection so far is given, with the
            bound so far; None for as long as it takes.

    Returns:
        Arrays of NumPy. The bound is the solver's own, and prices are zero.

    Raises:
        RuntimeError: SciPy is not installed.
    """
    programme = _programme(problem, num_detections)
    return _solve(programme, problem, [], time_limit)


def m_best(problem: Problem, num_detections: int, m: int) -> list[Answer]:
    """Finds the m best selections, best first, each once; fewer if there are fewer.

    Each is a 0-1 programme of its own, in which those before it are cut off.

    Args:
        problem: [N, L] and [N, L, S], of NumPy or JAX.
        num_detections: K, detections of a scan at most.
        m: How many.

    Raises:
        RuntimeError: SciPy is not installed.
    """
    programme = _programme(problem, num_detections)
    found: list[Answer] = []
    while len(found) < m:
        before = [np.asarray(one.leaf) for one in found]
        one = _solve(programme, problem, before, None)
        if not one.feasible:
            break
        found.append(one)
        if not (one.leaf >= 0).any():
            break
    return found


def relax_exact(problem: Problem, num_detections: int) -> Relaxation:
    """Solves the linear relaxation, in which trees may share themselves out on leaves.

    Args:
        problem: [N, L] and [N, L, S], of NumPy or JAX.
        num_detections: K, detections of a scan at most.

    Raises:
        RuntimeError: SciPy is not installed.
    """
    made = _programme(problem, num_detections)
    num_trees, _, num_scans = problem.detection.shape
    share = np.zeros(problem.log_score.shape)
    price = np.zeros((num_scans, num_detections))
    if not made.score.size:
        return Relaxation(share, 0.0, price, True)
    result = _optimize().linprog(
        -made.score,
        A_eq=made.matrix[:num_trees],
        b_eq=made.low[:num_trees],
        A_ub=made.matrix[num_trees:],
        b_ub=made.high[num_trees:],
        method="highs",
    )
    if result.status != SOLVED:
        return Relaxation(share, -np.inf, price, False)
    share[made.tree, made.leaf] = result.x
    price = np.maximum(-result.ineqlin.marginals, 0.0).reshape(price.shape)
    return Relaxation(share, -float(result.fun), price, True)


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise RuntimeError(
            f"Solving on the host needs {error.name}: pip install scipy."
        ) from error


def _optimize() -> Any:
    return _module("scipy.optimize")


def _programme(problem: Problem, num_detections: int) -> _Programme:
    """Builds the 0-1 programme."""
    log_score = np.asarray(problem.log_score, float)
    detection = np.asarray(problem.detection)
    num_trees, _, num_scans = detection.shape
    usable = np.isfinite(log_score) & (detection < num_detections).all(-1)
    tree, leaf = np.nonzero(usable)
    chosen = detection[tree, leaf]  # [V, S]
    variable, scan = np.nonzero(chosen >= 0)
    own = np.arange(len(tree))
    row = num_trees + scan * num_detections + chosen[variable, scan]
    row, column = np.concatenate([tree, row]), np.concatenate([own, variable])
    shape = num_trees + num_scans * num_detections, len(tree)
    ones = np.ones(len(row))
    matrix = _module("scipy.sparse").csr_array((ones, (row, column)), shape=shape)
    one = usable.any(1).astype(float)
    often = num_scans * num_detections
    low = np.concatenate([one, np.full(often, -np.inf)])
    high = np.concatenate([one, np.ones(often)])
    return _Programme(log_score[tree, leaf], tree, leaf, matrix, low, high)


def _solve(
    made: _Programme,
    problem: Problem,
    before: list[np.ndarray],
    time_limit: float | None,
) -> Answer:
    """Solves the 0-1 programme without the selections in `before`."""
    num_trees, _, num_scans = problem.detection.shape
    leaf = np.full(num_trees, -1)
    price = np.zeros((num_scans, (len(made.low) - num_trees) // max(num_scans, 1)))
    if not made.score.size:
        return _answer(price, leaf, 0.0, 0.0, True)
    optimize = _optimize()
    limits = [optimize.LinearConstraint(made.matrix, made.low, made.high)]
    for old in before:
        again = (old[made.tree] == made.leaf).astype(float)[None]
        limits.append(optimize.LinearConstraint(again, -np.inf, again.sum() - 1))
    options: dict[str, Any] = {"mip_rel_gap": 0.0}
    if time_limit is not None:
        options["time_limit"] = time_limit
    result = optimize.milp(
        -made.score,
        integrality=np.ones_like(made.score),
        bounds=optimize.Bounds(0, 1),
        constraints=limits,
        options=options,
    )
    if result.status not in (SOLVED, STOPPED) or result.x is None:
        bound = np.inf if result.status == STOPPED else -np.inf
        return _answer(price, leaf, -np.inf, bound, False)
    taken = result.x > 0.5
    leaf[made.tree[taken]] = made.leaf[taken]
    total = float(made.score[taken].sum())
    bound = total if result.status == SOLVED else -float(result.mip_dual_bound)
    return _answer(price, leaf, total, bound, True)


def _answer(price: np.ndarray, *fields: Any) -> Answer:
    arrays: list[Any] = [np.asarray(x) for x in (*fields, price)]
    return Answer(*arrays)
