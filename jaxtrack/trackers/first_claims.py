"""Detections that began a track: each has exactly one owner.

With Bernoulli tracks that a detection is the first of a target, or false, is one
hypothesis: the track it began. So that track is nothing only where the detection
belongs to another one; where nobody else has it, it is the track's. As a sum of scores:
to be nothing costs a price, and whoever else has the detection earns it.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import first_claims
    >>> begun = jnp.array([2, 0])  # by places of a window; 2 of them: 2 is none
    >>> used = jnp.array([[[0], [2]], [[0], [0]]])  # two trees, two leaves, a scan
    >>> print(first_claims.earned(begun, used, 2))
    [[1 0]
     [0 0]]
    >>> rows = jnp.array([[0, -1], [1, -1]])  # the second row leaves detection 0 free
    >>> print(first_claims.free(begun, used, rows, 2))
    [[False False]
     [False  True]]

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, equation 34, with an equality.
"""

import jax.numpy as jnp

from jaxtrack.trackers.forest import Forest
from jaxtrack.types import Array


def places(trees: Forest, num: int) -> Array:
    """Returns the place in the window of each leaf's detections, [N, L, S] (int).

    Place s K + k is detection k of scan s, S K is none.

    Args:
        trees: N trees with L leaves, of S scans.
        num: K, detections of a scan.
    """
    scans = trees.past.shape[2]
    here = jnp.arange(scans)[None, None] * num + trees.past
    return jnp.where(trees.past >= 0, here, scans * num)


def begun(trees: Forest, sure: Array, num: int) -> Array:
    """Returns the place of the detection that began each tree, [N] (int).

    None, where it is settled whose that is, or came before the window.

    Args:
        trees: N trees with L leaves, of S scans.
        sure: Those that are in every hypothesis, [N] (bool).
        num: K, detections of a scan.
    """
    scans, tree = trees.past.shape[2], jnp.arange(len(sure))
    when = scans - trees.age
    leaf = jnp.argmax(trees.log_score > -jnp.inf, axis=1)  # all have the same first
    open_ = (trees.label >= 0) & ~sure & (trees.age > 0) & (when >= 0)
    first = places(trees, num)[tree, leaf, jnp.clip(when, 0, scans - 1)]
    return jnp.where(open_, first, scans * num)


def earned(begun: Array, used: Array, none: int) -> Array:
    """Returns how many detections that began other trees each leaf has, [N, L].

    Args:
        begun: See `begun`, [N].
        used: See `places`, [N, L, S].
        none: S K.
    """
    wanted = jnp.zeros(none + 1, bool).at[begun].set(True).at[none].set(False)
    theirs = wanted[used] & (used != begun[:, None, None])
    return theirs.sum(2)


def free(begun: Array, used: Array, leaf: Array, none: int) -> Array:
    """Tells which trees are nothing although nobody has their detection, [H, N].

    Args:
        begun: See `begun`, [N].
        used: See `places`, [N, L, S].
        leaf: Of each tree, in H hypotheses, -1 for none, [H, N].
        none: S K.
    """
    row, tree = jnp.arange(len(leaf))[:, None, None], jnp.arange(len(begun))[None]
    has = jnp.where((leaf >= 0)[..., None], used[tree, jnp.maximum(leaf, 0)], none)
    taken = jnp.zeros((len(leaf), none + 1), bool).at[row, has].set(True)
    taken = taken.at[:, none].set(True)
    return (leaf < 0) & ~taken[:, begun]
