"""Which components of an intensity to report, how often, and under which labels.

A component that stands for w targets is reported as often as the whole number nearest
to w, but at most `COPIES` times, each time with an equal share of w.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import extraction
    >>> from jaxtrack.trackers.intensity import Components
    >>> one = Components(jnp.log(jnp.array([1.7, 0.4])), None, jnp.array([3, 5]))
    >>> picked = extraction.above(one, threshold=0.5)
    >>> print(picked.slot, picked.share.round(2), picked.exists)
    [0 0] [0.85 0.85] [ True  True]

References: Vo and Ma 2006, Table III; Vo, Vo and Cantoni 2007, section IV-D.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.trackers.bernoulli import Estimate, repeats
from jaxtrack.trackers.intensity import Components
from jaxtrack.types import Array, Target

COPIES = 3  # most targets that one component is reported as


class Picked(NamedTuple):
    """N slots of an estimate.

    Attributes:
        slot: The component, [N] (int).
        copy: Which of its targets, [N] (int).
        share: Expected number of targets that it stands for, [N].
        exists: Report this one, [N] (bool).
    """

    slot: Array
    copy: Array
    share: Array
    exists: Array


def check(report_threshold: float) -> None:
    """Raises a ValueError for a threshold that makes no sense."""
    if not 0 <= report_threshold < 1:
        raise ValueError(
            f"report_threshold is {report_threshold}; give an expected number of "
            "targets from 0 up to 1, e.g. 0.5"
        )


def above(components: Components, threshold: float) -> Picked:
    """Reports what stands for more than so many targets, and each further one.

    Further ones come after all components, so that they take nobody's slot.
    """
    reported = jnp.exp(components.log_weight) > threshold
    slot, copy, share = _copies(components, reported)
    return Picked(slot, copy, share, reported[slot] & (share > 0))


def heaviest(components: Components, count: Array) -> Picked:
    """Reports so many targets, where most of them are expected."""
    slot, copy, share = _copies(components)
    exists = (jnp.arange(share.size) < count) & (share > 0)
    return Picked(slot, copy, share, exists)


def _copies(
    components: Components, reported: Array | None = None
) -> tuple[Array, Array, Array]:
    """Returns component, copy and its share, each [N], the greatest first.

    A first copy counts as its whole component, further ones as their share. If it is
    known what is reported [N], first copies of this come first, and then further ones.
    """
    weight = jnp.exp(components.log_weight)
    copies = jnp.clip(jnp.round(weight), 1, COPIES)
    there = jnp.arange(COPIES)[None] < copies[:, None]
    share = jnp.where(there, (weight / copies)[:, None], 0.0)
    rank = share.at[:, 0].set(weight)
    if reported is not None:
        tier = jnp.ones_like(rank).at[:, 0].add(1.0)
        rank = rank / (1 + rank) + jnp.where(reported[:, None] & there, tier, 0.0)
    _, index = jax.lax.top_k(rank.ravel(), weight.size)
    return index // COPIES, index % COPIES, share.ravel()[index]


def tell_apart(
    components: Components, picked: Picked, next_label: Array
) -> tuple[Components, Array, Array]:
    """Finds the labels under which to report, no two of them alike.

    A component whose label a heavier one is reported under has a new one from now on;
    a copy has a new one each time, since nothing is known of it alone.

    Args:
        components: N.
        picked: What is reported of them.
        next_label: The first free label.

    Returns:
        The components with their labels, the labels to report [N], and the next free
        label.
    """
    label = components.label[picked.slot]
    again = repeats(label, picked.exists, jnp.arange(label.size))
    fresh = next_label + jnp.cumsum(again) - 1
    shown = jnp.where(again, fresh, label)
    where = jnp.where(again & (picked.copy == 0), picked.slot, label.size)
    renamed = components.label.at[where].set(fresh, mode="drop")
    return components._replace(label=renamed), shown, next_label + again.sum()


def report(
    target: Target,
    components: Components,
    picked: Picked,
    shown: Array,
    num_var: Array,
    log_evidence: Array,
    dropped: Array,
) -> Estimate:
    """Reports what was picked, at the means of the components.

    Args:
        target: How one target is filtered.
        components: N.
        picked: What is reported of them.
        shown: Labels to report, [N].
        num_var: Variance of the number of targets.
        log_evidence: Log-density of the scan.
        dropped: Expected number of targets that the capacities threw away.

    Returns:
        The estimate.
    """
    belief = jax.tree.map(
        lambda x: x[picked.slot], jax.vmap(target.moments)(components.belief)
    )
    return Estimate(
        mean=belief.mean,
        cov=belief.cov,
        label=shown,
        exists=picked.exists,
        existence_prob=jnp.minimum(picked.share, 1.0),
        mode_prob=jax.vmap(target.modes)(components.belief)[picked.slot],
        effective_size=jax.vmap(target.effective_size)(components.belief)[picked.slot],
        num_mean=components.expected,
        num_var=num_var,
        log_evidence=log_evidence,
        dropped=dropped,
    )
