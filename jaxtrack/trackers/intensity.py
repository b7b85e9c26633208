"""Intensities: how many targets to expect where, for the PHD and the CPHD filter.

An intensity is a sum of N weighted components, each a belief of `jaxtrack.targets` and
not about one target in particular: the weights add up to the expected number of
targets. Each component has a label, handed on from ancestor to offspring.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import intensity
    >>> two = intensity.Components(jnp.log(jnp.array([0.9, 1.6])), None, jnp.arange(2))
    >>> print(two.expected.round(3))
    2.5

References: Mahler, "Multitarget Bayes filtering via first-order multitarget moments",
IEEE Trans. Aerospace and Electronic Systems 39(4), 2003; Vo and Ma, "The Gaussian
mixture probability hypothesis density filter", IEEE Trans. Signal Processing 54(11),
2006.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import gate
from jaxtrack.linalg import safe_log
from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.trackers import bernoulli
from jaxtrack.trackers.association import LEAST_LOG_WEIGHT
from jaxtrack.types import Array, PyTree, Scan, Target

Birth = MultiBernoulliBirth | PoissonBirth | DetectionBirth


class Components(NamedTuple):
    """N slots.

    Attributes:
        log_weight: Of the expected number of targets; -inf marks an empty slot, [N].
        belief: [N, ...].
        label: Which target it is, by ancestry, [N] (int).
    """

    log_weight: Array
    belief: PyTree
    label: Array

    @property
    def expected(self) -> Array:
        """Returns the expected number of targets, a scalar."""
        return jnp.exp(self.log_weight).sum()


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        target: The `Params` of the target.
        birth: `models.birth.MultiBernoulliBirth` or `PoissonBirth` (known places, after
            the prediction), or `DetectionBirth` (where the last scan left detections
            unexplained).
        clutter: Of `models.clutter`.
    """

    target: Any
    birth: Birth
    clutter: Any


class Sighting(NamedTuple):
    """A scan as N components see it, in logarithms.

    Attributes:
        missed: What the components become if they were missed, [N, ...].
        views: The components as the sensor sees them, [N, ...].
        log_weight: [N].
        log_miss: Probability that a target of the component was missed, [N].
        log_score: Density of its detection, times the probability of one, [N, K].
        log_clutter: Density of a false detection, [K]; at least that of a miracle.
    """

    missed: PyTree
    views: PyTree
    log_weight: Array
    log_miss: Array
    log_score: Array
    log_clutter: Array


class Update(NamedTuple):
    """The intensity after a scan, before any of it is reduced.

    Attributes:
        missed: The components if they were missed, [N, ...].
        views: The components as the sensor sees them, [N, ...].
        log_missed: Weights of the missed components, [N].
        log_hit: Weight of component n corrected by detection k, [N, K].
        unexplained_prob: Probability that no known target caused the detection, [K].
        log_evidence: Log-density of the scan.
    """

    missed: PyTree
    views: PyTree
    log_missed: Array
    log_hit: Array
    unexplained_prob: Array
    log_evidence: Array


def nobody(
    target: Target, params: Params, size: int, max_births: int, key: Array
) -> Components:
    """Makes empty slots: `size`, and some for births that detections tell of."""
    driven = isinstance(params.birth, DetectionBirth)
    mode_prob = params.birth.mode_prob if driven else params.birth.mode_prob[0]
    slots = size + (max_births if driven else 0)
    empty = bernoulli.nobody(target, params.target, mode_prob, slots, key)
    return Components(safe_log(empty.existence_prob), empty.belief, empty.label)


def predict(
    target: Target, params: Any, components: Components, interval: Array
) -> tuple[Components, Array]:
    """Lets targets survive and move.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        components: N.
        interval: Seconds.

    Returns:
        The components, and the probability that any target survived (1 if there are
        none).
    """
    belief, log_survive = jax.vmap(target.predict, (None, 0, None))(
        params, components.belief, interval
    )
    log_weight = components.log_weight + log_survive
    survivors = components._replace(log_weight=log_weight, belief=belief)
    before = components.expected
    there = before > 0
    return survivors, jnp.where(
        there, survivors.expected / jnp.where(there, before, 1.0), 1.0
    )


def add_births(
    target: Target,
    params: Any,
    components: Components,
    births: MultiBernoulliBirth | PoissonBirth,
    next_label: Array,
    key: Array,
) -> tuple[Components, Array]:
    """Appends a component for each of B places where targets are born.

    Args:
        target: How one target is filtered.
        params: The target's `Params`.
        components: N.
        births: B places; their expected numbers are the weights.
        next_label: The first free label; each newborn has its own.
        key: Random key.

    Returns:
        N + B components, and the next free label.
    """
    if isinstance(births, PoissonBirth):
        births = MultiBernoulliBirth(births.rate, *births[1:])
    born = bernoulli.begin(target, params, births, next_label, key)
    newborn = Components(safe_log(born.existence_prob), born.belief, born.label)
    return append(components, newborn), next_label + born.label.size


def propose(
    birth: DetectionBirth, params: Any, update: Update, scan: Scan, max_births: int
) -> tuple[MultiBernoulliBirth, Array]:
    """Proposes births where a scan left detections unexplained.

    Args:
        birth: How likely, and how fast.
        params: The target's `Params`.
        update: What the scan explained.
        scan: K detections.
        max_births: Places kept, the likeliest.

    Returns:
        `max_births` places, and the expected number of births that found no room.
    """
    return bernoulli.from_unexplained(
        birth, params, scan, update.unexplained_prob, max_births
    )


def append(components: Components, born: Components) -> Components:
    """Joins N and B components into N + B."""
    return jax.tree.map(lambda old, new: jnp.concatenate([old, new]), components, born)


def scaled(components: Components, num_mean: Array) -> Components:
    """Scales the weights so that they add up to an expected number, if to any."""
    expected = components.expected
    some = (expected > 0) & (num_mean > 0)
    factor = jnp.where(some, num_mean, 1.0) / jnp.where(some, expected, 1.0)
    return components._replace(log_weight=components.log_weight + jnp.log(factor))


def see(
    target: Target,
    params: Params,
    components: Components,
    scan: Scan,
    max_scored: int | None = None,
) -> Sighting:
    """Asks each component what it thinks of a scan.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        components: N, predicted.
        scan: K detections.
        max_scored: Of them scored in full by each component, see `gate.scores`.

    Returns:
        What the update needs. An invalid detection has score and clutter -inf and 0;
        where no clutter or no miss can be, it costs e^-200 instead of being impossible.
    """
    missed, log_miss = jax.vmap(target.miss, (None, 0))(
        params.target, components.belief
    )
    views = jax.vmap(target.look, (None, 0))(params.target, components.belief)
    score = gate.scores(target, params.target, views, log_miss, scan, max_scored)
    clutter = jax.vmap(params.clutter.log_density)(scan.detections)
    return Sighting(
        missed=missed,
        views=views,
        log_weight=components.log_weight,
        log_miss=jnp.maximum(log_miss, LEAST_LOG_WEIGHT),
        log_score=jnp.where(scan.valid[None], score, -jnp.inf),
        log_clutter=jnp.where(scan.valid, jnp.maximum(clutter, LEAST_LOG_WEIGHT), 0.0),
    )
