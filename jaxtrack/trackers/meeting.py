"""A scan meets track trees and undetected targets: everything that scores hypotheses.

>>> from jaxtrack.trackers import meeting
>>> meeting.Meeting._fields
('trees', 'sight', 'firsts', 'log_constant')

Reference: Chong, Mori and Reid, "Forty years of multiple hypothesis tracking", Journal
of Advances in Information Fusion 14(2), 2019, equations 1 and 6 to 12.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.trackers import association, undetected
from jaxtrack.trackers.association import Gating, Sighting
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.trackers.forest import Forest
from jaxtrack.trackers.undetected import Firsts, Params, Undetected
from jaxtrack.types import Array, PyTree, Scan, Target


class Meeting(NamedTuple):
    """A scan, and all that is there to meet it.

    Attributes:
        trees: Predicted, [N, L].
        sight: The scan as they see it.
        firsts: First detections, and what stays undetected.
        log_constant: What all hypotheses have in common, so that they add up to the
            log-density of the scan.
    """

    trees: Forest
    sight: Sighting
    firsts: Firsts
    log_constant: Array


def meet(
    gating: Gating,
    target: Target,
    params: Params,
    forest: Forest,
    hidden: Undetected,
    scan: Scan,
    key: Array,
) -> Meeting:
    """Predicts trees and undetected targets, and lets them see a scan.

    Args:
        gating: Which pairs to look at.
        target: How one target is filtered.
        params: The tracker's `Params`.
        forest: N trees with L leaves.
        hidden: Undetected targets.
        scan: K detections.
        key: Random key.
    """
    keys = jax.random.split(key)
    hidden = undetected.predict(target, params, hidden, scan.interval, keys[0])
    firsts = undetected.see(target, params, hidden, scan, keys[1])
    trees = predict(target, params.target, forest, scan.interval)
    sight = look(gating, target, params, trees, scan)
    log_constant = sight.log_clutter.sum() - params.clutter.rate - firsts.found
    return Meeting(trees, sight, firsts, log_constant)


def predict(target: Target, params: Any, forest: Forest, interval: Array) -> Forest:
    """Lets every leaf's target survive with its probability, and move."""
    each = jax.vmap(target.predict, (None, 0, None))
    belief, log_survive = jax.vmap(each, (None, 0, None))(
        params, forest.belief, interval
    )
    survived = forest.existence_prob * jnp.exp(log_survive)
    return forest._replace(existence_prob=survived, belief=belief)


def look(
    gating: Gating, target: Target, params: Any, forest: Forest, scan: Scan
) -> Sighting:
    """Scores all pairs of a leaf and a detection.

    Args:
        gating: Which pairs to look at.
        target: How one target is filtered.
        params: The tracker's `Params`: target and clutter.
        forest: Predicted.
        scan: K detections.

    Returns:
        Of all leaves: scores [N, L, K + 1], views and missed beliefs [N, L, ...]; the
        log-clutter is [K].
    """

    def tree(existence_prob: Array, belief: PyTree) -> Sighting:
        none = jnp.zeros(existence_prob.size, int)
        tracks = Tracks(existence_prob, belief, none, none)
        return association.look(gating, True, target, params, tracks, scan)

    sight = jax.vmap(tree)(forest.existence_prob, forest.belief)
    return sight._replace(log_clutter=sight.log_clutter[0])
