"""Track trees: what each target may have been, in padded arrays.

A tree is one possible target, begun by its first detection; a leaf is which detection
of each scan it has had since, with a belief, the probability that the target still
exists, and a score. N trees have room for L leaves each. Trackers that follow
hypotheses say which leaves go on with which detections; here they are moved, scored and
corrected, by the verbs of any target algebra.

The score is the log-likelihood ratio of the track against all its detections being
false, so that it has no unit and a false alarm scores 0.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import forest
    >>> forest.Forest._fields
    ('log_score', 'existence_prob', 'belief', 'past', 'label', 'age')

Reference: Chong, Mori and Reid, "Forty years of multiple hypothesis tracking", Journal
of Advances in Information Fusion 14(2), 2019, equations 6 to 12.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth
from jaxtrack.trackers import bernoulli
from jaxtrack.trackers.association import Sighting
from jaxtrack.trackers.undetected import Firsts, Params
from jaxtrack.types import Array, PyTree, Scan, Target


class Forest(NamedTuple):
    """N trees with L leaves each.

    Attributes:
        log_score: Against all its detections being false; -inf marks an empty leaf,
            [N, L].
        existence_prob: That the target still exists, if the leaf is true, [N, L].
        belief: About that target, [N, L, ...].
        past: Which detection it had in each of the last S scans, the newest last, -1
            for none, [N, L, S] (int).
        label: Which target it is, -1 for an empty tree, [N] (int).
        age: How many scans ago its first detection was, that scan counted, [N] (int).
    """

    log_score: Array
    existence_prob: Array
    belief: PyTree
    past: Array
    label: Array
    age: Array


def nobody(
    target: Target, params: Any, mode_prob: Array, shape: tuple, key: Array
) -> Forest:
    """Makes empty trees.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        mode_prob: Any mode probabilities, [M]; they say how many modes there are.
        shape: N, L and S.
        key: Random key.
    """
    num, leaves, scans = shape
    empty = bernoulli.nobody(target, params, mode_prob, num * leaves, key)
    belief = jax.tree.map(lambda x: x.reshape(num, leaves, *x.shape[1:]), empty.belief)
    exists = empty.existence_prob.reshape(num, leaves)
    return Forest(
        log_score=jnp.full_like(exists, -jnp.inf),
        existence_prob=exists,
        belief=belief,
        past=jnp.full((num, leaves, scans), -1, jnp.int32),
        label=jnp.full(num, -1, int),
        age=jnp.zeros(num, jnp.int32),
    )


def at_start(
    target: Target, params: Any, start: MultiBernoulliBirth, forest: Forest, key: Array
) -> Forest:
    """Puts the targets that may be known before the first scan into empty trees.

    Raises:
        ValueError: There are more than the capacity.
    """
    size, room = len(start.existence_prob), len(forest.label)
    if size > room:
        raise ValueError(
            f"start has {size} targets and max_tracks is {room}; make room for them"
        )
    known = bernoulli.begin(target, params, start, jnp.array(0), key)
    return forest._replace(
        log_score=forest.log_score.at[:size, 0].set(0.0),
        existence_prob=forest.existence_prob.at[:size, 0].set(known.existence_prob),
        belief=jax.tree.map(
            lambda x, y: x.at[:size, 0].set(y), forest.belief, known.belief
        ),
        label=forest.label.at[:size].set(known.label),
        age=forest.age.at[:size].set(forest.past.shape[2] + 1),
    )


def begin(target: Target, params: Params, shape: tuple, key: Array) -> Forest:
    """Makes the trees before the first scan.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        shape: N, L and S.
        key: Random key.

    Raises:
        ValueError: More targets are known than the capacity.
    """
    keys, birth = jax.random.split(key), params.birth
    driven = isinstance(birth, DetectionBirth)
    mode_prob = birth.mode_prob if driven else birth.mode_prob[0]
    trees = nobody(target, params.target, mode_prob, shape, keys[0])
    if params.start is None:
        return trees
    return at_start(target, params.target, params.start, trees, keys[1])


def follow(
    target: Target,
    params: Any,
    forest: Forest,
    sight: Sighting,
    scan: Scan,
    parent: Array,
    column: Array,
    there: Array,
) -> Forest:
    """Makes the new leaves: each an old one, followed by a detection or by none.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        forest: N trees with L leaves, predicted.
        sight: The scan as they see it.
        scan: K detections.
        parent: The old leaf of each new one, [N, L'].
        column: Its detection, K for none, [N, L'].
        there: Whether there is such a new leaf, [N, L'] (bool).

    Returns:
        N trees with L' leaves.
    """
    last = len(scan.valid)
    none = sight.log_score[:, :, -1]
    kept = none > -jnp.inf
    log_exists = sight.log_exists + sight.log_miss - jnp.where(kept, none, 0.0)
    exists_if_missed = jnp.where(kept, jnp.exp(log_exists), 0.0)

    def leaf(view: PyTree, missed: PyTree, column: Array, exists: Array) -> PyTree:
        seen = scan.detections[jnp.minimum(column, last - 1)]
        hit = target.correct(params, view, seen)
        belief = jax.tree.map(lambda x, y: jnp.where(column == last, x, y), missed, hit)
        return target.adapt(params, belief, exists)

    def tree(
        old: tuple, sight: tuple, parent: Array, column: Array, there: Array
    ) -> tuple:
        log_score, exists_if_missed, past = (x[parent] for x in old)
        views, missed = jax.tree.map(lambda x: x[parent], sight[:2])
        exists = jnp.where(column == last, exists_if_missed, 1.0)
        exists = jnp.where(there, exists, 0.0).astype(log_score.dtype)
        score = jnp.where(there, log_score + sight[2][parent, column], -jnp.inf)
        now = jnp.where(column == last, -1, column).astype(past.dtype)
        belief = jax.vmap(leaf)(views, missed, column, exists)
        return score, exists, belief, jnp.concatenate([past[:, 1:], now[:, None]], 1)

    old = forest.log_score, exists_if_missed, forest.past
    seen = sight.views, sight.missed, sight.log_score
    made = jax.vmap(tree)(old, seen, parent, column, there)
    age = jnp.where(forest.age > 0, forest.age + 1, 0)
    # A tree that lost all its leaves is gone.
    alive = there.any(1)
    return Forest(
        log_score=made[0],
        existence_prob=made[1],
        belief=made[2],
        past=made[3],
        label=jnp.where(alive, forest.label, -1),
        age=jnp.where(alive, age, 0),
    )


def add_born(forest: Forest, born: bernoulli.Tracks) -> Forest:
    """Adds a tree for each target that may be born now, before any detection of it.

    Args:
        forest: N trees with L leaves.
        born: B tracks.

    Returns:
        N + B trees.
    """
    size, (_, leaves, scans) = born.label.size, forest.past.shape
    there = (jnp.arange(leaves) == 0)[None] & (born.label >= 0)[:, None]
    trees = Forest(
        log_score=jnp.where(there, 0.0, -jnp.inf),
        existence_prob=jnp.where(there, born.existence_prob[:, None], 0.0),
        belief=jax.tree.map(
            lambda x: jnp.broadcast_to(x[:, None], (size, leaves, *x.shape[1:])),
            born.belief,
        ),
        past=jnp.full((size, leaves, scans), -1),
        label=born.label,
        age=jnp.ones(size),
    )
    return jax.tree.map(
        lambda x, y: jnp.concatenate([x, y.astype(x.dtype)]), forest, trees
    )


def plant(
    forest: Forest,
    firsts: Firsts,
    next_label: Array,
    existence_prob: Array | None = None,
    detection: Array | None = None,
) -> tuple[Forest, Array]:
    """Adds a tree for each detection, of a target detected for the first time.

    Args:
        forest: N trees with L leaves.
        firsts: K first detections.
        next_label: The first free label.
        existence_prob: That there is such a target, [K]; 1 if None.
        detection: Which ones of the scan these are, [K] (int); all if None.

    Returns:
        N + K trees, of which those of impossible detections are empty, and the next
        free label.
    """
    num = len(firsts.log_score)
    _, leaves, scans = forest.past.shape
    here = jnp.arange(leaves)[None] == 0
    there = here & (firsts.log_score > -jnp.inf)[:, None]
    past = jnp.full((num, leaves, scans), -1, forest.past.dtype)
    mine = jnp.arange(num) if detection is None else detection
    alive = there[:, 0]
    sure = jnp.ones_like(firsts.log_score)
    exists = sure if existence_prob is None else existence_prob
    trees = Forest(
        log_score=jnp.where(there, firsts.log_score[:, None], -jnp.inf),
        existence_prob=jnp.where(there, exists[:, None], 0.0),
        belief=jax.tree.map(
            lambda x: jnp.broadcast_to(x[:, None], (num, leaves, *x.shape[1:])),
            firsts.belief,
        ),
        past=past.at[:, 0, -1].set(jnp.where(alive, mine.astype(past.dtype), -1)),
        label=jnp.where(alive, next_label + jnp.cumsum(alive) - 1, -1),
        age=alive.astype(forest.age.dtype),
    )
    both = jax.tree.map(
        lambda x, y: jnp.concatenate([x, y.astype(x.dtype)]), forest, trees
    )
    return both, next_label + alive.sum()
