"""Hypotheses about track trees, found when needed: one leaf for each tree.

>>> from jaxtrack.trackers import multiscan_choice
>>> multiscan_choice.chooser("simplex", max_hypotheses=1)
Traceback (most recent call last):
...
ValueError: solver is 'simplex'; give one of lagrangian, decomposition, greedy, exact

The solvers are those of `jaxtrack.assign.multiscan`.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import mixture
from jaxtrack.assign import multiscan
from jaxtrack.assign.multiscan.problem import Problem
from jaxtrack.trackers import verdict
from jaxtrack.trackers.forest import Forest
from jaxtrack.types import Array


class Choice(NamedTuple):
    """What was found: hypotheses about each cluster of trees, and about all.

    Attributes:
        leaf: Of each tree, in H hypotheses about its cluster, -1 for none, [H, N].
        log_weight: Of these, equal in all trees of a cluster; -inf for none, [H, N].
        label: Which cluster each tree is in, by its first tree, [N].
        best: The leaf that the best hypothesis has, -1 for none, [N].
        log_joint: Weights of the likeliest hypotheses about all trees together, [H].
        log_loss: How much better than the best of them another may be, the log of a
            ratio of weights; 0 if there is none.
    """

    leaf: Array
    log_weight: Array
    label: Array
    best: Array
    log_joint: Array
    log_loss: Array

    @property
    def log_total(self) -> Array:
        """Returns the log-weight of all that were found."""
        return _total(self.log_weight, self.label)

    @property
    def views(self) -> verdict.Views:
        """Returns their probabilities."""
        norm = jax.vmap(mixture.log_normalise, 1, 1)
        return verdict.Views(self.leaf, norm(self.log_weight), self.label)


Chooser = Callable[[Forest, Array, int], Choice]


def chooser(solver: str, max_hypotheses: int) -> Chooser:
    """Returns a function (trees, sure [N], num_detections) -> `Choice`.

    `sure` trees must be in every hypothesis, and their first leaves exclude nobody's;
    the others may be nothing.

    Args:
        solver: "lagrangian", "decomposition", "greedy" or "exact".
        max_hypotheses: H; with 1 only the best is found.

    Raises:
        ValueError: There is no such solver.
    """
    solvers = {
        "lagrangian": multiscan.lagrangian.lagrangian,
        "decomposition": multiscan.decomposition.decomposition,
        "greedy": multiscan.greedy.greedy,
        "exact": _exact,
    }
    if solver not in solvers:
        raise ValueError(f"solver is {solver!r}; give one of {', '.join(solvers)}")
    return functools.partial(_choose, solvers[solver], max_hypotheses)


def _choose(
    solve: Callable, max_hypotheses: int, trees: Forest, sure: Array, num: int
) -> Choice:
    """Finds the best hypothesis, and others."""
    none = jnp.where(sure | (trees.label < 0), -jnp.inf, 0.0)
    fixed = jax.lax.stop_gradient(trees.log_score)
    score = jnp.concatenate([fixed, none[:, None].astype(fixed.dtype)], axis=1)
    past = jnp.pad(trees.past, ((0, 0), (0, 1), (0, 0)), constant_values=-1)
    problem = Problem(score, past)
    found = solve(problem, num)
    # A solver that finds nothing leaves what is possible at any rate.
    safe = jnp.where(sure, 0, jnp.where(trees.label < 0, -1, score.shape[1] - 1))
    leaf = jnp.where(found.feasible, found.leaf, safe.astype(jnp.int32))[None]
    there = jnp.ones((1, len(none)), bool)
    label, beam = multiscan.problem.label(problem, num), None
    if max_hypotheses > 1:
        # Those that find no prices leave it to the beam to find some.
        price = None if solve in (_exact, multiscan.greedy.greedy) else found.price
        beam = multiscan.beam.beam(problem, num, max_hypotheses - 1, price)
        others = ~_everywhere((beam.leaf == leaf) | (trees.label < 0)[None], label)
        leaf = jnp.concatenate([leaf, beam.leaf])
        there = jnp.concatenate([there, (beam.log_score > -jnp.inf) & others])
    leaf = jnp.where(leaf < trees.log_score.shape[1], leaf, -1)
    log_weight = jnp.where(there, _weigh(trees, leaf, label), -jnp.inf)
    best = leaf[jnp.argmax(log_weight, axis=0), jnp.arange(len(none))]
    top = jnp.where(label == jnp.arange(len(none)), log_weight.max(0), 0.0).sum()
    log_loss = jnp.maximum(found.log_bound - jax.lax.stop_gradient(top), 0.0)
    log_joint = top[None] if beam is None else multiscan.beam.together(beam).log_score
    return Choice(leaf, log_weight, label, best, log_joint, log_loss)


def remaining(choice: Choice, trees: Forest, kept: Array, stays: Array) -> Array:
    """Returns the log-weight of the hypotheses about what was kept of the trees.

    A tree that goes is one that is nothing, or a sure one with its best leaf; what else
    was thought of it goes with it.

    Args:
        choice: What was found.
        trees: The trees, with the scores and the leaves that they have from now on.
        kept: Which trees are, [N] (bool).
        stays: Which trees are in all hypotheses, [N] (bool).
    """
    default = jnp.where(stays, choice.best, -1)
    tree = jnp.arange(len(kept))[None]
    score = trees.log_score[tree, jnp.maximum(choice.leaf, 0)]
    held = (choice.leaf < 0) | (score > -jnp.inf)
    fits = jnp.where(kept[None], held, choice.leaf == default[None])
    leaf = jnp.where(kept[None], choice.leaf, -1)
    there = _everywhere(fits, choice.label) & (choice.log_weight > -jnp.inf)
    weight = _weigh(trees, leaf, choice.label)
    return _total(jnp.where(there, weight, -jnp.inf), choice.label)


def _weigh(trees: Forest, leaf: Array, label: Array) -> Array:
    """Returns the sums of scores over each tree's cluster, [H, N]."""
    tree = jnp.arange(leaf.shape[1])[None]
    own = trees.log_score[tree, jnp.maximum(leaf, 0)]
    known = (leaf >= 0) & (own > -jnp.inf)
    own = jnp.where(known, jnp.where(known, own, 0.0), 0.0)
    return own @ (label[:, None] == label[None]).astype(own.dtype)


def _everywhere(flags: Array, label: Array) -> Array:
    """Returns whether a flag [H, N] holds for all trees of the cluster, [H, N]."""
    same = (label[:, None] == label[None]).astype(jnp.float32)
    return (~flags).astype(jnp.float32) @ same == 0


def _total(log_weight: Array, label: Array) -> Array:
    """Returns the log of the product of the clusters' sums."""
    sums = jax.vmap(mixture.total, 1)(log_weight)
    first = label == jnp.arange(label.size)
    return jnp.where(first, jnp.where(first, sums, 0.0), 0.0).sum()


def _exact(problem: Problem, num_detections: int) -> multiscan.problem.Answer:
    """Calls the exact solver on the host."""
    shapes = jax.eval_shape(
        functools.partial(multiscan.greedy.greedy, num_detections=num_detections),
        problem,
    )

    def call(log_score: Array, detection: Array) -> multiscan.problem.Answer:
        found = multiscan.host.exact(Problem(log_score, detection), num_detections)
        return jax.tree.map(lambda x, s: np.asarray(x, s.dtype), found, shapes)

    return jax.pure_callback(call, shapes, *problem, vmap_method="sequential")
