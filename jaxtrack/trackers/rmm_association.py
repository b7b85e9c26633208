"""Randomized association: shares of leaves by a linear programme, and what they say.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import rmm_association
    >>> log_score = jnp.array([[0.0, 3.0], [0.0, 2.0]])  # two trees, two leaves each
    >>> past = jnp.array([[[-1], [4]], [[-1], [4]]])  # both want the same detection
    >>> found = rmm_association.share(log_score, past, 6, max_contested=2)
    >>> print(found.leaf.round(2).tolist(), found.log_value.round(2), found.integral)
    [[0.0, 1.0], [1.0, 0.0]] 3.0 True

Only detections that more than one tree wants need a constraint, so the programme is
small.

Reference: Liu et al. 2021, equations 32, 33 and 35.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.assign.multiscan.problem import Problem
from jaxtrack.assign.multiscan.relax import relax
from jaxtrack.types import Array

LEAST_SHARE = 0.01  # less than the programme is solved to counts as nothing


class Shares(NamedTuple):
    """How trees share themselves out on their leaves.

    Attributes:
        leaf: Rows sum to one, or to zero where a tree is empty, [N, L].
        log_value: Sum of share * score, the expected log-likelihood ratio.
        integral: Whether each tree has a single leaf (bool).
    """

    leaf: Array
    log_value: Array
    integral: Array


def share(
    log_score: Array, past: Array, num_detections: int, max_contested: int
) -> Shares:
    """Solves the linear programme (eq. 32).

    Shares are constants to derivatives, so that the gradient of `log_value` is theirs:
    right wherever the solution is unique.

    Args:
        log_score: Of the leaves of N trees, -inf for none, [N, L].
        past: Their detections, -1 for none, [N, L, S].
        num_detections: K.
        max_contested: Detections of a scan that several trees may share; of any beyond,
            only the tree with the best leaf may have them.
    """
    fixed = jax.lax.stop_gradient(log_score)
    size = min(max_contested, num_detections)
    fixed, slot = _contested(fixed, past, num_detections, size)
    found = relax(Problem(fixed, slot), size)
    # A tree that nobody contests has its best leaf, to the last digit.
    best = jnp.argmax(fixed, axis=1)[:, None] == jnp.arange(fixed.shape[1])[None]
    possible = fixed > -jnp.inf
    free = ~((slot >= 0).any(2) & possible).any(1, keepdims=True)
    shared = jnp.where(found.share >= LEAST_SHARE, found.share, 0.0)
    leaf = jnp.where(free, (best & possible).astype(shared.dtype), shared)
    whole = leaf.sum(1, keepdims=True)
    leaf = leaf / jnp.where(whole > 0, whole, 1.0)
    leaf = jax.lax.stop_gradient(leaf)
    value = jnp.where(leaf > 0, jnp.where(leaf > 0, log_score, 0.0) * leaf, 0.0)
    return Shares(leaf, value.sum(), ((leaf == 0) | (leaf == 1)).all())


def hits(leaf: Array, past: Array, num_detections: int) -> Array:
    """Returns how likely each tree has each detection (eq. 33), [N, S, K].

    Args:
        leaf: Shares, [N, L].
        past: Detections, -1 for none, [N, L, S].
        num_detections: K.
    """
    tree = jnp.arange(len(leaf))[:, None, None]
    scan = jnp.arange(past.shape[2])[None, None]
    column = jnp.where(past < 0, num_detections, past)
    table = jnp.zeros((len(leaf), past.shape[2], num_detections + 1), leaf.dtype)
    many = jnp.broadcast_to(leaf[:, :, None], past.shape)
    return table.at[tree, scan, column].add(many)[:, :, :-1]


def models(leaf: Array, mode_prob: Array) -> Array:
    """Returns how likely each tree has each model in each scan (eq. 35), [N, S, M].

    Args:
        leaf: Shares, [N, L]; where they sum to less than one, all models are likely.
        mode_prob: Of each leaf, [N, L, S, M].
    """
    rest = (1 - leaf.sum(1))[:, None, None] / mode_prob.shape[3]
    return jnp.einsum("nl,nlsm->nsm", leaf, mode_prob) + rest


def _contested(
    log_score: Array, past: Array, num_detections: int, size: int
) -> tuple[Array, Array]:
    """Gives slots to the detections that several trees want.

    Returns:
        Scores, -inf for leaves that lost a detection for want of slots, [N, L], and the
        slots of their detections, -1 for none or uncontested, [N, L, S].
    """
    num_trees, num_leaves, num_scans = past.shape
    tree = jnp.arange(num_trees)[:, None, None]
    scan = jnp.arange(num_scans)[None, None]
    column = jnp.where(past < 0, num_detections, past)
    score = jnp.broadcast_to(log_score[:, :, None], past.shape)
    # Each tree's best leaf with each detection, [N, S, K]
    best = jnp.full((num_trees, num_scans, num_detections + 1), -jnp.inf, score.dtype)
    best = best.at[tree, scan, column].max(score)[:, :, :-1]
    many = (best > -jnp.inf).sum(0) > 1  # [S, K]
    rank = jnp.cumsum(many, axis=1) - 1
    slot = jnp.where(many & (rank < size), rank, -1)
    over = many & (rank >= size)
    owner = jnp.argmax(best, axis=0)
    slot, over, owner = (
        jnp.pad(x, ((0, 0), (0, 1)), constant_values=fill)[scan, column]
        for x, fill in ((slot, -1), (over, False), (owner, -1))
    )
    lost = (over & (owner != tree)).any(2)
    return jnp.where(lost, -jnp.inf, log_score), slot.astype(jnp.int32)
