"""The Poisson multi-Bernoulli mixture filter: PMBM.

What is known of all targets after a scan is the union of two independent sets: a
Poisson number of those never detected, and of those that were a mixture, over all
hypotheses about which detection was whose, of independent tracks that exist or not.
For births of a Poisson number that is closed under prediction and update, so that
nothing is approximate but what is cut; see `bernoulli_mixture`, `offspring`.

`pmbm(target=imm())` is a multiple-model PMBM. A track's label is its own for all time.

`log_evidence` is the log-density of the scan given the hypotheses that were kept,
summed over the joint events that were found: exact while there is room for all.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import pmbm
    >>> tracker = pmbm.pmbm(targets.single.single(), max_hypotheses=200)

References: Williams, "Marginal multi-Bernoulli filters: RFS derivation of MHT, JIPDA,
and association-based MeMBer", IEEE Trans. Aerospace and Electronic Systems 51(3), 2015;
Garcia-Fernandez, Williams, Granstrom and Svensson, "Poisson multi-Bernoulli mixture
filter: direct derivation and implementation", the same 54(4), 2018; Xia, Granstrom,
Svensson, Garcia-Fernandez and Williams, "Multiscan implementation of the trajectory
Poisson multi-Bernoulli mixture filter", Journal of Advances in Information Fusion
14(2), 2019.
"""

import functools

from jaxtrack import gate
from jaxtrack.trackers import association, bernoulli_mixture, thinning
from jaxtrack.types import Target, Tracker


@functools.cache
def pmbm(
    target: Target,
    max_hypotheses: int = 100,
    max_children: int | None = None,
    max_tracks: int = 32,
    max_leaves: int = 12,
    max_undetected: int = 16,
    max_contested: int | None = None,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-4,
    exist_threshold: float = 1e-4,
    recycle_threshold: float = 0.0,
    merge_threshold: float = 0.0,
    estimator: str = "heaviest",
    report_threshold: float = 0.5,
) -> Tracker:
    """Makes a Poisson multi-Bernoulli mixture filter.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_hypotheses: Hypotheses kept after a scan, the heaviest.
        max_children: Joint events found in a scan, the likeliest of all hypotheses
            together; None for as many as hypotheses are kept.
        max_tracks: Trees kept, those most likely to be a target that is still there.
        max_leaves: Different histories kept of each, the likeliest.
        max_undetected: Components kept of the intensity of undetected targets.
        max_contested: Trees that may be given detections in a scan, and detections that
            may be given to them; None for all.
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Hypotheses of less probability go.
        exist_threshold: A track goes from a hypothesis where its target exists with
            less probability.
        recycle_threshold: And where it exists with less than this, it becomes part of
            the undetected targets; 0 for never.
        merge_threshold: Histories of one target become one where the squared
            Mahalanobis distance of their states is less; 0 for never.
        estimator: What is reported: "heaviest", "number" or "certain", see
            `estimators`.
        report_threshold: With "heaviest", a track of the best hypothesis is reported
            where its target exists with more probability.

    Raises:
        ValueError: A setting that makes no sense.
    """
    gate.check(gate_prob)
    settings = bernoulli_mixture.Settings(
        target=target,
        hides=True,
        certain=False,
        max_hypotheses=max_hypotheses,
        max_children=max_hypotheses if max_children is None else max_children,
        max_leaves=max_leaves,
        max_undetected=max_undetected,
        max_contested=max_contested,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        thinning=thinning.Thinning(
            max_tracks, prune_threshold, exist_threshold, merge_threshold
        ),
        recycle_threshold=recycle_threshold,
        estimator=estimator,
        report_threshold=report_threshold,
    )
    return bernoulli_mixture.make(settings)
