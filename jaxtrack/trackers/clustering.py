"""State extraction by clustering: as many places as there are targets.

All that the components of an intensity are made of, particles or Gaussians, is pooled,
and weighted k-means on positions finds a given number of clusters. It is how the first
particle PHD filters told targets apart. Components by detection need no such thing
(`partition="detections"` of `phd`) and seldom mistake two targets for one.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import clustering
    >>> place = jnp.array([[0.0], [1.0], [9.0], [10.0]])
    >>> print(clustering.kmeans(jnp.zeros(4), place, count=2, max_clusters=3))
    [0 0 1 1]

References: Clark and Bell, "Multi-target state estimation and track continuity for the
particle PHD filter", IEEE Trans. Aerospace and Electronic Systems 43(4), 2007; Arthur
and Vassilvitskii, "k-means++: the advantages of careful seeding", 2007 (the seeds, here
without chance: each next one is where most weight is farthest).
"""

from typing import Any, Literal

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.trackers import extraction
from jaxtrack.trackers.bernoulli import Estimate, repeats
from jaxtrack.trackers.intensity import Components
from jaxtrack.types import Array, Mixture, Target

NUM_STEPS = 10
Extract = Literal["components", "clusters"]


def kmeans(
    log_weight: Array,
    place: Array,
    count: Array | int,
    max_clusters: int,
    num_steps: int = NUM_STEPS,
) -> Array:
    """Returns the cluster of each of S points, [S] (int); -1 for an empty slot.

    Args:
        log_weight: -inf marks an empty slot, [S].
        place: Positions, [S, P].
        count: How many clusters, at most `max_clusters`; with 0 all points get -1.
        max_clusters: C.
        num_steps: Of Lloyd's iteration.
    """
    there = log_weight > -jnp.inf
    weight = mixture.normalise(log_weight) * there
    used = jnp.arange(max_clusters) < count

    def seed(nearest: Array, _: None) -> tuple[Array, Array]:
        centre = place[jnp.argmax(weight * nearest)]
        return jnp.minimum(nearest, _square(place, centre)), centre

    # The first seed is where the whole cloud is farthest from its mean.
    spread = _square(place, weight @ place)
    _, centre = jax.lax.scan(seed, spread, None, length=max_clusters)

    def nearest(centre: Array) -> Array:
        square = jax.vmap(_square, (None, 0))(place, centre)  # [C, S]
        return jnp.argmin(jnp.where(used[:, None], square, jnp.inf), axis=0)

    def step(_: int, centre: Array) -> Array:
        member = nearest(centre)[None] == jnp.arange(max_clusters)[:, None]
        mine = jnp.where(member, weight[None], 0.0)
        total = mine.sum(1)[:, None]
        some = total > 0
        return jnp.where(some, (mine @ place) / jnp.where(some, total, 1.0), centre)

    centre = jax.lax.fori_loop(0, num_steps, step, centre)
    return jnp.where(there & (count > 0), nearest(centre), -1)


def check(extract: Extract) -> None:
    """Raises a ValueError for a way of extraction that there is not."""
    if extract not in ("components", "clusters"):
        raise ValueError(
            f'extract is {extract!r}; give "components" (what is heavy is a target) or '
            '"clusters" (k-means of all particles)'
        )


def read(
    extract: Extract,
    target: Target,
    params: Any,
    components: Components,
    picked: extraction.Picked,
    count: Array,
    told: tuple[Array, Array, Array],
    next_label: Array,
) -> tuple[Components, Estimate, Array]:
    """Reports the components that were picked, or as many clusters as are counted.

    Args:
        extract: Which of the two.
        target: How one target is filtered.
        params: The target's `Params`.
        components: N.
        picked: What to report of them.
        count: How many clusters.
        told: Variance of the number, log-evidence and what was dropped, as they are.
        next_label: The first free label.

    Returns:
        The components, some under a new label, the estimate, and the next free label.
    """
    if extract == "clusters":
        where = params.layout.position_index
        return report(target, where, components, count, *told, next_label)
    components, shown, next_label = extraction.tell_apart(
        components, picked, next_label
    )
    estimate = extraction.report(target, components, picked, shown, *told)
    return components, estimate, next_label


def report(
    target: Target,
    where: tuple[int, ...],
    components: Components,
    count: Array,
    num_var: Array,
    log_evidence: Array,
    dropped: Array,
    next_label: Array,
) -> tuple[Components, Estimate, Array]:
    """Reports the centres of clusters, each under the label that most of it has.

    Args:
        target: How one target is filtered.
        where: Components of the state that are positions.
        components: N.
        count: Targets to report, at most N.
        num_var: Variance of the number of targets.
        log_evidence: Log-density of the scan.
        dropped: Expected number of targets that the capacities threw away.
        next_label: The first free label.

    Returns:
        The components, some under a new label, the estimate, and the next free label.
    """
    size = components.log_weight.size
    count = jnp.minimum(count, size)
    parts = jax.vmap(target.parts)(components.belief)
    log_share = jax.vmap(mixture.log_normalise)(parts.log_weight)
    filled = parts.log_weight > -jnp.inf
    log_weight = components.log_weight[:, None] + jnp.where(filled, log_share, -jnp.inf)
    pool = Mixture(*(x.reshape(-1, *x.shape[2:]) for x in (log_weight, *parts[1:])))
    cluster = kmeans(pool.log_weight, pool.mean[:, jnp.array(where)], count, size)
    joined = mixture.merge_clusters(pool, cluster, size)

    # Whose is it? weight of component n in cluster c, [C, N]; the heaviest come first.
    own = cluster.reshape(size, -1)[None] == jnp.arange(size)[:, None, None]
    part = jnp.where(own, jnp.exp(log_weight)[None], 0.0).sum(2)
    order = jnp.argsort(-part.sum(1))
    part, joined = part[order], jax.tree.map(lambda x: x[order], joined)
    total = part.sum(1)
    slot, exists = jnp.argmax(part, axis=1), total > 0
    shown, renamed, next_label = _tell_apart(components.label, slot, exists, next_label)
    whole = jnp.where(exists, total, 1.0)[:, None]
    estimate = Estimate(
        mean=joined.mean,
        cov=joined.cov,
        label=shown,
        exists=exists,
        existence_prob=jnp.minimum(total, 1.0),
        mode_prob=part / whole @ jax.vmap(target.modes)(components.belief),
        effective_size=jax.vmap(target.effective_size)(components.belief)[slot],
        num_mean=components.expected,
        num_var=num_var,
        log_evidence=log_evidence,
        dropped=dropped,
    )
    return components._replace(label=renamed), estimate, next_label


def _tell_apart(
    label: Array, slot: Array, exists: Array, next_label: Array
) -> tuple[Array, Array, Array]:
    """Gives a cluster whose label a heavier one has a new one, and its component, too.

    Returns the labels of the clusters, of the components, and the next free label.
    """
    rank = jnp.arange(slot.size)
    again = repeats(label[slot], exists, rank)
    fresh = next_label + jnp.cumsum(again) - 1
    shown = jnp.where(again, fresh, label[slot])
    theirs = again & ~repeats(slot, exists, rank)
    renamed = label.at[jnp.where(theirs, slot, slot.size)].set(fresh, mode="drop")
    return shown, renamed, next_label + again.sum()


def _square(place: Array, centre: Array) -> Array:
    """Returns squared distances of points [S, P] from one [P], [S]."""
    gap = place - centre[None]
    return (gap * gap).sum(1)
