"""How a scan meets the tracks of a mixture of multi-Bernoullis, and who may be new.

With a Poisson number of births somebody new may be behind every detection (`hidden`);
with multi-Bernoulli births a track begins with every birth (`born`).

    >>> from jaxtrack.trackers import arrivals
    >>> arrivals.Met._fields[:3]
    ('trees', 'sight', 'log_absent')

References: see `pmbm` and `mbm`.
"""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp

from jaxtrack.linalg import safe_log
from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.trackers import bernoulli, forest, meeting, undetected
from jaxtrack.trackers.association import Gating, Sighting
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.undetected import Firsts, Params, Undetected
from jaxtrack.types import Array, Scan, Target


class Met(NamedTuple):
    """A scan, and all that is there to meet it.

    Attributes:
        trees: Predicted, with those born, [N, L].
        sight: The scan as they see it.
        log_absent: See `offspring.follow`.
        firsts: First detections, and who stays undetected; None with multi-Bernoulli
            births.
        log_new: What a detection counts that no old tree has, [K].
        log_constant: What all hypotheses have in common.
        next_label: The first free label.
    """

    trees: Forest
    sight: Sighting
    log_absent: Array | None
    firsts: Firsts | None
    log_new: Array
    log_constant: Array
    next_label: Array


def check(params: Params, hides: bool, recycles: bool) -> None:
    """Raises a ValueError where parameters are of another tracker."""
    bernoullis = isinstance(params.birth, MultiBernoulliBirth)
    if hides:
        undetected.check(params)
        if recycles and not isinstance(params.birth, PoissonBirth):
            raise ValueError(
                "recycle_threshold is given and birth is a DetectionBirth, with which "
                "nobody is undetected; give a PoissonBirth, or 0 as recycle_threshold"
            )
    elif not bernoullis:
        kind = type(params.birth).__name__
        raise ValueError(f"birth is a {kind}; give a MultiBernoulliBirth")
    elif params.undetected is not None:
        raise ValueError(
            "undetected is given and births are multi-Bernoulli, with which nobody is; "
            "give them as start"
        )


def log_new(firsts: Firsts) -> Array:
    """Returns what the detections count that no old track has, against clutter, [K].

    The log of 1 + e / c, for e expected first detections there and clutter of density
    c: nobody but a new target or clutter may be behind them.
    """
    first = firsts.log_score
    possible = first > -jnp.inf
    safe = jnp.where(possible, first, 0.0)
    return jnp.where(possible, jax.nn.softplus(safe), 0.0)


def modes(params: Params) -> Array:
    """Returns the mode probabilities of some birth, [M]."""
    birth = params.birth
    driven = isinstance(birth, DetectionBirth)
    return birth.mode_prob if driven else birth.mode_prob[0]


def hidden(
    gating: Gating,
    target: Target,
    params: Params,
    trees: Forest,
    unseen: Undetected,
    scan: Scan,
    next_label: Array,
    key: Array,
) -> Met:
    """Lets trees and undetected targets meet a scan.

    Args:
        gating: Which pairs to look at.
        target: How one target is filtered.
        params: The tracker's `Params`.
        trees: N trees with L leaves.
        unseen: Undetected targets.
        scan: K detections.
        next_label: The first free label.
        key: Random key.
    """
    met = meeting.meet(gating, target, params, trees, unseen, scan, key)
    return Met(
        met.trees,
        met.sight,
        None,
        met.firsts,
        log_new(met.firsts),
        met.log_constant,
        next_label,
    )


def born(
    gating: Gating,
    target: Target,
    params: Params,
    trees: Forest,
    certain: bool,
    scan: Scan,
    next_label: Array,
    key: Array,
) -> Met:
    """Lets trees, and those of B targets that may be born now, meet a scan.

    Args:
        gating: Which pairs to look at.
        target: How one target is filtered.
        params: The tracker's `Params`.
        trees: N trees with L leaves.
        certain: Whether hypotheses say who is there.
        scan: K detections.
        next_label: The first free label.
        key: Random key.
    """
    trees = meeting.predict(target, params.target, trees, scan.interval)
    places = cast(MultiBernoulliBirth, params.birth)
    births = bernoulli.begin(target, params.target, places, next_label, key)
    trees = forest.add_born(trees, births)
    sight, absent = meeting.look(gating, target, params, trees, scan), None
    if certain:
        absent = safe_log(-jnp.expm1(sight.log_exists))
        missed = sight.log_exists + sight.log_miss
        sight = sight._replace(log_score=sight.log_score.at[..., -1].set(missed))
    constant = sight.log_clutter.sum() - params.clutter.rate
    label = next_label + births.label.size
    none = jnp.zeros_like(sight.log_clutter)
    return Met(trees, sight, absent, None, none, constant, label)
