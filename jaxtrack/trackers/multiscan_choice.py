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
from jaxtrack.trackers import first_claims, verdict
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
        claimed: Trees that are nothing only where their first detection is another's,
            [N] (bool).
    """

    leaf: Array
    log_weight: Array
    label: Array
    best: Array
    log_joint: Array
    log_loss: Array
    claimed: Array

    @property
    def log_total(self) -> Array:
        """Returns the log-weight of all that were found."""
        return _total(self.log_weight, self.label)

    @property
    def views(self) -> verdict.Views:
        """Returns their probabilities."""
        norm = jax.vmap(mixture.log_normalise, 1, 1)
        return verdict.Views(self.leaf, norm(self.log_weight), self.label)


# A sure tree, whose target is known to be there, is nothing at this price in nats only:
# where few leaves are kept there may be no hypothesis in which all of them have one. It
# is more than any detections of a few scans are worth, against impossible clutter too,
# or else it would pay to lose a tree and begin another with its detections.
LOSS = 1e4

ROUNDING = 100.0  # errors of a sum

# What a Bernoulli track pays, in nats, to be nothing, and who has its first detection
# earns: so much is no hypothesis worth that has it twice, and so little costs few
# digits of the sum.
CLAIM = 200.0

PRICED = multiscan.lagrangian.lagrangian, multiscan.decomposition.decomposition

Chooser = Callable[[Forest, Array, Array, int], Choice]


def chooser(solver: str, max_hypotheses: int, bernoulli: bool = False) -> Chooser:
    """Returns a function (trees, sure [N], held [N], num_detections) -> `Choice`.

    `sure` trees are in every hypothesis unless their leaves leave no room for it; the
    others may be nothing. `held` ones are, with their first leaves, a hypothesis that
    is possible at any rate; the first leaf of a sure one is missed in the scan.

    Args:
        solver: "lagrangian", "decomposition", "greedy" or "exact".
        max_hypotheses: H; with 1 only the best is found.
        bernoulli: Whether a track is nothing only where its first detection belongs to
            another, see `first_claims`.

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
    return functools.partial(_choose, solvers[solver], max_hypotheses, bernoulli)


def _choose(
    solve: Callable,
    max_hypotheses: int,
    bernoulli: bool,
    trees: Forest,
    sure: Array,
    held: Array,
    num: int,
) -> Choice:
    """Finds the best hypothesis, and others."""
    problem, lost, begun = _problem(bernoulli, trees, sure, num)
    none = problem.log_score[:, -1]
    # Where a solver finds nothing there is what is possible at any rate.
    last = problem.log_score.shape[1] - 1
    safe = jnp.where(held, 0, jnp.where(trees.label < 0, -1, last)).astype(jnp.int32)
    places = num * trees.past.shape[2]
    # Who began a tree and who else wants the detection have the claim, so it costs it.
    claim = jnp.zeros(places + 1, none.dtype).at[begun].set(CLAIM)[:-1]
    guess = {"price": claim.reshape(-1, num), "leaf": safe} if solve in PRICED else {}
    found = solve(problem, num, **guess)
    label = multiscan.problem.label(problem, num)
    leaf = jnp.stack([found.leaf, safe])
    possible = _possible(problem, found.leaf, num, label)
    there = jnp.stack([possible, jnp.ones_like(possible)])
    beam = None
    if max_hypotheses > 1:
        # Those that find no prices leave it to the beam to find some.
        price = found.price if solve in PRICED else None
        beam = multiscan.beam.beam(problem, num, max_hypotheses, price)
        leaf = jnp.concatenate([leaf, beam.leaf])
        there = jnp.concatenate([there, beam.log_score > -jnp.inf])
    there = there & ~_repeated(leaf, there, trees.label < 0, label)
    leaf = jnp.where(leaf < trees.log_score.shape[1], leaf, -1)
    claimed = begun < places
    if bernoulli:
        used = first_claims.places(trees, num)
        free = first_claims.free(begun, used, leaf, places)
        there = there & _everywhere(~free, label)
    log_weight = jnp.where(there, _weigh(trees, leaf, lost, label), -jnp.inf)
    best = leaf[jnp.argmax(log_weight, axis=0), jnp.arange(len(none))]
    top = log_weight.max(0)
    total = jnp.where(label == jnp.arange(len(none)), top, 0.0).sum()
    log_loss = jnp.maximum(found.log_bound - jax.lax.stop_gradient(total), 0.0)
    if beam is None:
        one = best[None], top[None], label, best, total[None]
        return Choice(*one, log_loss, claimed)
    log_joint = _with_best(multiscan.beam.together(beam).log_score, total)
    return Choice(leaf, log_weight, label, best, log_joint, log_loss, claimed)


def _with_best(log_joint: Array, best: Array) -> Array:
    """Returns a list [H] that begins with the best, which the solver may have alone."""
    slack = ROUNDING * jnp.finfo(best.dtype).eps * jnp.abs(best)
    longer = jnp.concatenate([best[None], log_joint[:-1]])
    return jnp.where(best > log_joint[0] + slack, longer, log_joint)


def _problem(
    bernoulli: bool, trees: Forest, sure: Array, num: int
) -> tuple[Problem, Array, Array]:
    """Returns what to solve, what trees that are nothing weigh, and their claims."""
    fixed = jax.lax.stop_gradient(trees.log_score)
    missed = trees.log_score[:, 0]  # of a sure tree, in the best hypothesis so far
    lost = jnp.where(sure & (missed > -jnp.inf), missed - LOSS, 0.0)
    none = jnp.where(trees.label < 0, -jnp.inf, jax.lax.stop_gradient(lost))
    places = num * trees.past.shape[2]
    begun = jnp.full(len(sure), places)
    if bernoulli:
        begun = first_claims.begun(trees, sure, num)
        used = first_claims.places(trees, num)
        fixed = fixed + CLAIM * first_claims.earned(begun, used, places)
        none = none - jnp.where(begun < places, CLAIM, 0.0)
    score = jnp.concatenate([fixed, none[:, None].astype(fixed.dtype)], axis=1)
    past = jnp.pad(trees.past, ((0, 0), (0, 1), (0, 0)), constant_values=-1)
    return Problem(score, past), lost, begun


def _possible(problem: Problem, leaf: Array, num: int, label: Array) -> Array:
    """Tells in which clusters every tree has a leaf and no detection two trees, [N]."""
    tree = jnp.arange(leaf.size)
    used = problem.detection[tree, jnp.maximum(leaf, 0)]  # [N, S]
    used = jnp.where((leaf >= 0)[:, None] & (used >= 0), used, num)
    scan = jnp.broadcast_to(jnp.arange(used.shape[1])[None], used.shape)
    times = jnp.zeros((used.shape[1], num + 1), int).at[scan, used].add(1)
    clash = ((times[scan, used] > 1) & (used < num)).any(1)
    empty = (problem.log_score == -jnp.inf).all(1)
    fits = ~clash & ((leaf >= 0) | empty)
    return _everywhere(fits[None], label)[0]


def _repeated(leaf: Array, there: Array, empty: Array, label: Array) -> Array:
    """Tells which rows, in a cluster, are the same as the first or second, [H, N]."""
    row = jnp.arange(len(leaf))[:, None]
    again = jnp.zeros(leaf.shape, bool)
    for k in range(2):
        same = _everywhere((leaf == leaf[k][None]) | empty[None], label)
        again = again | (same & there[k][None] & (row > k))
    return again


def remaining(choice: Choice, trees: Forest, kept: Array, stays: Array) -> Array:
    """Returns the log-weight of the hypotheses about what was kept of the trees.

    A tree that goes does so with what the best hypothesis says of it; what else was
    thought of it goes, too.

    Args:
        choice: What was found.
        trees: The trees, with the scores and the leaves that they have from now on.
        kept: Which trees are, [N] (bool).
        stays: Which trees are in all hypotheses, [N] (bool).
    """
    tree = jnp.arange(len(kept))[None]
    score = trees.log_score[tree, jnp.maximum(choice.leaf, 0)]
    held = (choice.leaf < 0) | (score > -jnp.inf)
    # Who else has a detection does not change when the track that it began goes.
    gone = (choice.leaf == choice.best[None]) | (
        choice.claimed[None] & (choice.leaf < 0)
    )
    fits = jnp.where(kept[None], held, gone)
    leaf = jnp.where(kept[None], choice.leaf, -1)
    fits = fits & ~((choice.leaf < 0) & (kept & stays)[None])
    there = _everywhere(fits, choice.label) & (choice.log_weight > -jnp.inf)
    nothing = jnp.zeros(len(kept), trees.log_score.dtype)
    weight = _weigh(trees, leaf, nothing, choice.label)
    return _total(jnp.where(there, weight, -jnp.inf), choice.label)


def _weigh(trees: Forest, leaf: Array, none: Array, label: Array) -> Array:
    """Returns the sums of scores over each tree's cluster, [H, N]."""
    tree = jnp.arange(leaf.shape[1])[None]
    own = trees.log_score[tree, jnp.maximum(leaf, 0)]
    known = (leaf >= 0) & (own > -jnp.inf)
    own = jnp.where(known, jnp.where(known, own, 0.0), none[None])
    same = label[:, None] == label[None]
    return jnp.where(same[None], own[:, :, None], 0.0).sum(1)


def _everywhere(flags: Array, label: Array) -> Array:
    """Returns whether a flag [H, N] holds for all trees of the cluster, [H, N]."""
    same = label[:, None] == label[None]
    return (flags[:, :, None] | ~same[None]).all(1)


def _total(log_weight: Array, label: Array) -> Array:
    """Returns the log of the product of the clusters' sums."""
    sums = mixture.total(log_weight)
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
