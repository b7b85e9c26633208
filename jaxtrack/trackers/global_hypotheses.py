"""Global hypotheses: a table of which leaf each has of each track tree.

    children = follow(hypotheses, scores)         # the likeliest joint events of each
    wanted = leaves(children)                     # the distinct leaves that they need
    hypotheses = merge(hypotheses)                # equal rows are one hypothesis

All in padded arrays: H rows, of log-weight -inf where there is none, and N columns.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import global_hypotheses
    >>> rows = jnp.array([[0, -1], [1, 0], [0, -1]])
    >>> given = global_hypotheses.Hypotheses(jnp.log(jnp.array([0.5, 0.2, 0.3])), rows)
    >>> merged = global_hypotheses.merge(given)
    >>> print(jnp.exp(merged.log_weight).round(3))
    [0.8 0.2 0. ]

References: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979; Cox and Hingorani, "An efficient implementation of Reid's multiple
hypothesis tracking algorithm", IEEE Trans. Pattern Analysis and Machine Intelligence
18(2), 1996.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.assign.k_best import k_best
from jaxtrack.types import Array


class Hypotheses(NamedTuple):
    """H hypotheses about N trees, heaviest first.

    Attributes:
        log_weight: -inf marks an empty row, [H].
        leaf: Which one it has of each tree, -1 for none, [H, N] (int).
    """

    log_weight: Array
    leaf: Array


class Children(NamedTuple):
    """The hypotheses that stay, each a parent and a joint event.

    Attributes:
        log_weight: [H].
        parent: [H].
        column: Which detection each tree has, K for none, [H, N].
        log_total: Log-weight of all that were proposed.
    """

    log_weight: Array
    parent: Array
    column: Array
    log_total: Array


class Leaves(NamedTuple):
    """The leaves that some hypotheses have, in L places a tree.

    Attributes:
        code: Of each, as given to `distinct`, -1 for an empty place, [N, L].
        hypotheses: The hypotheses, in terms of these places; those of which a leaf
            found no place are empty.
    """

    code: Array
    hypotheses: Hypotheses


def first(num_rows: int, start: Array, dtype: jnp.dtype) -> Hypotheses:
    """Returns one hypothesis: the trees [N] (bool) have their first leaf."""
    log_weight = jnp.where(jnp.arange(num_rows) == 0, 0.0, -jnp.inf)
    leaf = jnp.broadcast_to(jnp.where(start, 0, -1)[None], (num_rows, start.size))
    return Hypotheses(log_weight.astype(dtype), leaf.astype(jnp.int32))


def score(hypotheses: Hypotheses, log_score: Array, log_first: Array) -> Array:
    """Returns what each hypothesis says of a scan, trees it may begin now included.

    Args:
        hypotheses: H, of N trees.
        log_score: Of every leaf, [N, L, K + 1].
        log_first: Of a target detected for the first time, [K].

    Returns:
        [H, N + K, K + 1]; a tree that a hypothesis has not is missed with 0.
    """
    num_trees, _, num_columns = log_score.shape
    dtype = log_score.dtype
    nothing = jnp.full(num_columns, -jnp.inf, dtype).at[-1].set(0.0)
    tree = jnp.arange(num_trees)[None]
    own = log_score[tree, jnp.maximum(hypotheses.leaf, 0)]  # [H, N, K + 1]
    own = jnp.where((hypotheses.leaf >= 0)[..., None], own, nothing[None, None])
    new = jnp.diag(log_first) if log_first.size else jnp.zeros((0, 0), dtype)
    off = ~jnp.eye(log_first.size, dtype=bool)
    new = jnp.where(off, -jnp.inf, new)
    new = jnp.concatenate([new, jnp.zeros((log_first.size, 1), dtype)], axis=1)
    new = jnp.broadcast_to(new[None], (len(own), *new.shape))
    return jnp.concatenate([own, new], axis=1)


def follow(hypotheses: Hypotheses, log_score: Array, max_children: int) -> Children:
    """Finds the heaviest children of all hypotheses.

    Args:
        hypotheses: H.
        log_score: What each says of the scan, [H, N, K + 1].
        max_children: Joint events by which each may be followed, the likeliest.
    """
    events = jax.vmap(lambda scores: k_best(scores, max_children))(log_score)
    weights = hypotheses.log_weight[:, None] + events.log_score
    kept, index = jax.lax.top_k(weights.ravel(), hypotheses.log_weight.size)
    parent, event = jnp.divmod(index, max_children)
    total = mixture.total(weights.ravel())
    return Children(kept, parent, events.column[parent, event], total)


def distinct(hypotheses: Hypotheses, size: int, num_codes: int) -> Leaves:
    """Finds the distinct leaves that hypotheses have, the likeliest L of each tree.

    Args:
        hypotheses: H, with a code for each leaf instead of its place, -1 for none.
        size: L.
        num_codes: All codes are less.
    """
    weight = jnp.exp(mixture.log_normalise(hypotheses.log_weight))
    # XLA on CPU finds the best of many in float32 only without sorting them all.
    weight = jax.lax.stop_gradient(weight).astype(jnp.float32)
    heaviest = jnp.argmax(hypotheses.log_weight)
    live = hypotheses.log_weight > -jnp.inf
    place = jnp.arange(size)

    def tree(code: Array) -> tuple[Array, Array, Array]:
        there = live & (code >= 0)
        at = jnp.where(there, code, num_codes)
        # More than nothing even if the weight is too small for a number.
        likely = jnp.full(num_codes, -1.0, weight.dtype).at[at].max(0.0, mode="drop")
        likely = likely.at[at].add(weight, mode="drop")
        likely = likely.at[at[heaviest]].set(2.0, mode="drop")  # stays at any rate
        best, found = jax.lax.top_k(likely, min(size, num_codes))
        short = size - found.size
        found = jnp.pad(jnp.where(best >= 0, found, num_codes), (0, short), "edge")
        found = jnp.where(place < size - short, found, num_codes)
        to = jnp.full(num_codes + 1, -1).at[found].set(place, mode="drop")
        leaf = jnp.where(there, to[at], -1)
        return jnp.where(found < num_codes, found, -1), leaf, there & (leaf < 0)

    code, leaf, lost = jax.vmap(tree, in_axes=1)(hypotheses.leaf)
    log_weight = jnp.where(lost.any(0), -jnp.inf, hypotheses.log_weight)
    return Leaves(code, Hypotheses(log_weight, leaf.T.astype(hypotheses.leaf.dtype)))


def merge(hypotheses: Hypotheses) -> Hypotheses:
    """Makes one of all rows that have the same leaves; the heaviest comes first."""
    log_weight, leaf = hypotheses
    same = (leaf[:, None] == leaf[None]).all(2)
    row = jnp.arange(len(leaf))
    again = (same & (row[None] < row[:, None])).any(1)
    together = jax.vmap(
        lambda mine: mixture.total(jnp.where(mine, log_weight, -jnp.inf))
    )
    total = jnp.where(again, -jnp.inf, together(same))
    order = jnp.argsort(-total)
    return Hypotheses(total[order], leaf[order])


def prune(hypotheses: Hypotheses, threshold: float) -> Hypotheses:
    """Drops rows of less than this share of the weight, and normalises the rest."""
    log_prob = mixture.log_normalise(hypotheses.log_weight)
    kept = (log_prob >= jnp.log(threshold)) | (jnp.arange(log_prob.size) == 0)
    log_prob = jnp.where(kept, log_prob, -jnp.inf)
    return hypotheses._replace(log_weight=mixture.log_normalise(log_prob))
