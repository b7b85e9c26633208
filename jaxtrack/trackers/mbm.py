"""Multi-Bernoulli mixture filters: MBM, and MBM01, which knows who is there.

With births at known places, at most one a scan at each, what is known of all targets is
a mixture, over all hypotheses about which detection was whose, of independent tracks
that exist or not, those begun included that no detection has been given yet. `mbm`
keeps that; nothing is approximate but what is cut. With births of small probability a
hypothesis has a track for each of them, where `pmbm` has an intensity for all.

`mbm01` says of each track in each hypothesis whether its target is there. A hypothesis
then has a child for every way in which targets may have died or been born, so that many
more are needed to tell the same.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import mbm
    >>> tracker = mbm.mbm(targets.single.single(), max_hypotheses=200)

`log_evidence` is as in `pmbm`.

References: Garcia-Fernandez, Xia, Granstrom, Svensson and Williams, "Gaussian
implementation of the multi-Bernoulli mixture filter", Proc. 22nd International
Conference on Information Fusion, 2019; Xia, Granstrom, Svensson, Garcia-Fernandez and
Williams, "Multiscan implementation of the trajectory Poisson multi-Bernoulli mixture
filter", Journal of Advances in Information Fusion 14(2), 2019, section IV.
"""

import functools

from jaxtrack import gate
from jaxtrack.trackers import association, bernoulli_mixture, thinning
from jaxtrack.types import Target, Tracker


@functools.cache
def mbm(
    target: Target,
    max_hypotheses: int = 100,
    max_children: int | None = None,
    max_tracks: int = 32,
    max_leaves: int = 12,
    max_contested: int | None = None,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-4,
    exist_threshold: float = 1e-4,
    merge_threshold: float = 0.0,
    estimator: str = "heaviest",
    report_threshold: float = 0.5,
) -> Tracker:
    """Makes a multi-Bernoulli mixture filter.

    Its `undetected.Params` have a `MultiBernoulliBirth`, and nobody undetected.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_hypotheses: See `pmbm.pmbm`, as for all others.
        max_children: Joint events found in a scan.
        max_tracks: Trees kept, those just born not counted before the end of the scan.
        max_leaves: Different histories kept of each.
        max_contested: Trees that may be given detections in a scan.
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Hypotheses of less probability go.
        exist_threshold: Tracks of less existence go.
        merge_threshold: Histories of one target become one.
        estimator: "heaviest", "number" or "certain".
        report_threshold: Of "heaviest".

    Raises:
        ValueError: A setting that makes no sense.
    """
    gate.check(gate_prob)
    settings = bernoulli_mixture.Settings(
        target=target,
        hides=False,
        certain=False,
        max_hypotheses=max_hypotheses,
        max_children=max_hypotheses if max_children is None else max_children,
        max_leaves=max_leaves,
        max_undetected=1,
        max_contested=max_contested,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        thinning=thinning.Thinning(
            max_tracks, prune_threshold, exist_threshold, merge_threshold
        ),
        recycle_threshold=0.0,
        estimator=estimator,
        report_threshold=report_threshold,
    )
    return bernoulli_mixture.make(settings)


@functools.cache
def mbm01(
    target: Target,
    max_hypotheses: int = 400,
    max_children: int | None = None,
    max_tracks: int = 32,
    max_leaves: int = 12,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 0.0,
) -> Tracker:
    """Makes a multi-Bernoulli mixture filter whose hypotheses know who is there.

    What is reported is the likeliest hypothesis.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        max_hypotheses: See `mbm`, as for all others.
        max_children: Joint events found in a scan.
        max_tracks: Trees kept.
        max_leaves: Different histories kept of each.
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Hypotheses of less probability go.
        merge_threshold: Histories of one target become one.

    Raises:
        ValueError: A setting that makes no sense.
    """
    gate.check(gate_prob)
    settings = bernoulli_mixture.Settings(
        target=target,
        hides=False,
        certain=True,
        max_hypotheses=max_hypotheses,
        max_children=max_hypotheses if max_children is None else max_children,
        max_leaves=max_leaves,
        max_undetected=1,
        max_contested=None,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        thinning=thinning.Thinning(max_tracks, prune_threshold, 0.0, merge_threshold),
        recycle_threshold=0.0,
        estimator="heaviest",
        report_threshold=0.5,
    )
    return bernoulli_mixture.make(settings)
