"""From all that a scan makes of an intensity to a few components again.

    the heaviest corrected components are worked out    # of pairs, or by detection
    light ones go, those that are close merge           # as mixtures are reduced
    the heaviest are kept

    >>> import jax.numpy as jnp
    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import reduction
    >>> from jaxtrack.trackers.intensity import Components
    >>> from jaxtrack.types import Gaussian
    >>> near = Gaussian(jnp.array([[0.0], [1.0], [9.0]]), jnp.ones((3, 1, 1)))
    >>> three = Components(jnp.log(jnp.array([0.5, 0.5, 0.4])), near, jnp.arange(3))
    >>> size = reduction.make(max_components=2)
    >>> two, dropped = reduction.merge(size, targets.single.single(), three)
    >>> print(jnp.exp(two.log_weight).round(3), two.belief.mean[:, 0])
    [1.  0.4] [0.5 9. ]

Reference: Vo and Ma 2006, Table II, with the spread of the means kept.
"""

from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate, mixture
from jaxtrack.trackers import bernoulli
from jaxtrack.trackers.intensity import Components, Update, append
from jaxtrack.types import Array, Mixture, PyTree, Scan, Target

Partition = Literal["pairs", "detections"]


class Reduction(NamedTuple):
    """How an intensity is kept small; see `phd.phd`."""

    max_components: int
    max_updated: int
    prune_threshold: float
    merge_threshold: float
    partition: Partition
    max_parents: int
    max_scored: int | None


def make(
    max_components: int,
    max_updated: int | None = None,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 4.0,
    partition: Partition = "pairs",
    max_parents: int = 8,
    max_scored: int | None = None,
) -> Reduction:
    """Checks the settings of `phd.phd` that say how an intensity is kept small.

    Raises:
        ValueError: A size, threshold or partition that makes no sense.
    """
    updated = max_components if max_updated is None else max_updated
    sizes = {"max_components": max_components, "max_updated": updated}
    for name, size in {**sizes, "max_parents": max_parents}.items():
        if size < 1:
            raise ValueError(f"{name} is {size}; give at least 1")
    if not 0 <= prune_threshold < 1:
        raise ValueError(
            f"prune_threshold is {prune_threshold}; give an expected number of targets "
            "from 0 up to 1, e.g. 1e-5"
        )
    if not merge_threshold >= 0:
        raise ValueError(
            f"merge_threshold is {merge_threshold}; give a squared distance of 0 or "
            "more, e.g. 4"
        )
    gate.check_scored(max_scored)
    if partition not in ("pairs", "detections"):
        raise ValueError(
            f'partition is {partition!r}; give "pairs" (a component for each parent '
            'and detection) or "detections" (one for each detection)'
        )
    return Reduction(
        max_components,
        updated,
        prune_threshold,
        merge_threshold,
        partition,
        max_parents,
        max_scored,
    )


def check_births(max_births: int) -> None:
    """Raises a ValueError for a number of newborn components that makes no sense."""
    if max_births < 1:
        raise ValueError(f"max_births is {max_births}; give at least 1")


def reduce(
    size: Reduction,
    target: Target,
    params: Any,
    label: Array,
    update: Update,
    scan: Scan,
) -> tuple[Components, Array]:
    """Works out the components that matter after a scan, merges and keeps a few.

    Args:
        size: How many.
        target: How one target is filtered.
        params: The target's `Params`.
        label: Of the components that were updated, [N].
        update: Their weights if missed and if corrected.
        scan: The K detections.

    Returns:
        `max_components` components, heaviest first, and the expected number of targets
        that were pruned or found no room.
    """
    light = jnp.log(jnp.asarray(size.prune_threshold, update.log_missed.dtype))
    log_missed, log_hit = (
        jnp.where(x >= light, x, -jnp.inf) for x in (update.log_missed, update.log_hit)
    )
    pruned = sum(
        jnp.where(x < light, jnp.exp(x), 0.0).sum()
        for x in (update.log_missed, update.log_hit)
    )
    missed = Components(log_missed, update.missed, label)
    correct = by_pair if size.partition == "pairs" else by_detection
    hits, unmade = correct(size, target, params, label, update.views, log_hit, scan)
    kept, lost = merge(size, target, append(missed, hits))
    exists = jnp.minimum(jnp.exp(kept.log_weight), 1.0)
    belief = jax.vmap(target.adapt, (None, 0, 0))(params, kept.belief, exists)
    shrunk = jnp.exp(kept.log_weight) * jax.vmap(target.lost)(kept.belief)
    dropped = pruned + unmade + lost + shrunk.sum()
    return kept._replace(belief=belief), dropped


def by_pair(
    size: Reduction,
    target: Target,
    params: Any,
    label: Array,
    views: PyTree,
    log_hit: Array,
    scan: Scan,
) -> tuple[Components, Array]:
    """Corrects the heaviest pairs of a component and a detection, each for itself.

    Returns the corrected components, and the expected number of targets in the others.
    """
    num_detections = log_hit.shape[1]
    most = min(size.max_updated, log_hit.size)
    log_weight, pair = jax.lax.top_k(log_hit.ravel(), most)
    parent, detection = pair // num_detections, pair % num_detections
    belief = jax.vmap(target.correct, (None, 0, 0))(
        params, jax.tree.map(lambda x: x[parent], views), scan.detections[detection]
    )
    unmade = jnp.exp(log_hit).sum() - jnp.exp(log_weight).sum()
    hits = Components(log_weight, belief, label[parent])
    return hits, jnp.maximum(unmade, 0.0)


def by_detection(
    size: Reduction,
    target: Target,
    params: Any,
    label: Array,
    views: PyTree,
    log_hit: Array,
    scan: Scan,
) -> tuple[Components, Array]:
    """Makes one component of all that a detection corrects, for the heaviest.

    Returns the corrected components, and the expected number of targets in the others
    and in the parents that found no room.
    """
    log_total = mixture.total(log_hit)
    most = min(size.max_updated, log_total.size)
    log_weight, detection = jax.lax.top_k(log_total, most)

    def absorb(log_weight: Array, detection: Array) -> tuple[PyTree, Array, Array]:
        return bernoulli.absorb(
            target, params, views, size.max_parents, log_weight, detection
        )

    belief, ancestor, lost = jax.vmap(absorb)(
        log_hit[:, detection].T, scan.detections[detection]
    )
    # What the beliefs themselves lost goes on with them, and is counted there.
    own = jax.vmap(target.lost)(belief)
    left = jnp.where(own < 1, (lost - own) / jnp.where(own < 1, 1 - own, 1.0), 0.0)
    weight = jnp.exp(log_weight)
    unmade = jnp.exp(log_hit).sum() - weight.sum() + (weight * left).sum()
    return Components(log_weight, belief, label[ancestor]), jnp.maximum(unmade, 0.0)


def merge(
    size: Reduction, target: Target, components: Components
) -> tuple[Components, Array]:
    """Joins each component to the heaviest one nearby; keeps the heaviest of these.

    As `mixture.reduce`, by the moments of the beliefs. Each cluster keeps its weight;
    only its `max_parents` heaviest members shape its belief, and the heaviest names it.

    Args:
        size: How many to keep, and how near is near.
        target: How one target is filtered.
        components: Any number.

    Returns:
        `max_components` components, heaviest first, and the expected number of targets
        that found no room.
    """
    num, most = components.log_weight.size, size.max_components
    moments = jax.vmap(target.moments)(components.belief)
    cluster = mixture.clusters(
        Mixture(components.log_weight, *moments),
        size.merge_threshold,
        most,
        singular=True,
    )
    member = cluster[None] == jnp.arange(most)[:, None]
    log_weight = jnp.where(member, components.log_weight[None], -jnp.inf)
    log_total = jax.vmap(mixture.total)(log_weight)
    order = jnp.argsort(-log_total)
    heaviest, slot = jax.lax.top_k(log_weight[order], min(size.max_parents, num))
    # Not slot[:, 0]: XLA on CPU sorts in full if the best k are not used whole.
    first = jnp.argmax(log_weight[order], 1)
    some = jax.tree.map(lambda x: x[slot], components.belief)
    belief = jax.vmap(target.collapse)(heaviest, some)
    lost = components.expected - jnp.exp(log_total).sum()
    kept = Components(log_total[order], belief, components.label[first])
    return kept, jnp.maximum(lost, 0.0)
