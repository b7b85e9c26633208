"""Assignment over several scans: every tree of track hypotheses takes one leaf.

Every solver takes a `problem.Problem` and the number of detections a scan may have, K,
and returns a `problem.Answer`: the leaf of every tree, the sum of their scores, and a
bound that no selection exceeds. All run inside `jax.jit` and under `jax.vmap`, but for
those of `host`, which call SciPy.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.assign import multiscan
    >>> log_score = jnp.array([[3.0, 0.0], [5.0, 4.0]])  # two trees, two leaves each
    >>> detection = jnp.array([[[0, 1], [-1, -1]], [[0, 0], [-1, -1]]])  # of two scans
    >>> given = multiscan.problem.Problem(log_score, detection)
    >>> found = multiscan.lagrangian.lagrangian(given, num_detections=2)
    >>> print(found.leaf, found.log_score, found.log_bound)
    [0 1] 7.0 7.0
"""

from jaxtrack.assign.multiscan import (
    beam,
    branching,
    decomposition,
    entropic,
    greedy,
    host,
    interior,
    lagrangian,
    primal_dual,
    problem,
    relax,
    slots,
    system,
)

__all__ = [
    "beam",
    "branching",
    "decomposition",
    "entropic",
    "greedy",
    "host",
    "interior",
    "lagrangian",
    "primal_dual",
    "problem",
    "relax",
    "slots",
    "system",
]
