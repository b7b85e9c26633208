"""The multiscan trajectory Poisson multi-Bernoulli mixture filter: TPMBM.

What `pmbm` knows of targets, with all their past: each leaf of a track tree is a
trajectory that exists or not, and hypotheses are made when they are needed, by an
assignment over the last `num_scans` scans, as track-oriented multiple hypothesis
tracking (`mht`) makes them. The best one decides what lies further back. What differs
from `mht` is that a detection nobody else has begins one Bernoulli, a target or none,
where `mht` has two hypotheses; the density of all hypotheses together is the same, the
best one is another.

With every scan it reports the paths of its tracks through the last `num_scans + lag`
scans, smoothed (`estimate.paths`); `trajectories.assemble` makes whole trajectories of
them, those that ended included; with `trajectories="alive"` those of targets that are
there now, and ended ones take no room. They begin where they were first detected.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import tpmbm
    >>> tracker = tpmbm.tpmbm(targets.single.single(), num_scans=3, lag=1)

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019.
"""

import functools

from jaxtrack.trackers import association, thinning, track_oriented
from jaxtrack.types import Target, Tracker


@functools.cache
def tpmbm(
    target: Target,
    num_scans: int = 3,
    lag: int = 1,
    solver: str = "decomposition",
    max_hypotheses: int = 32,
    max_tracks: int = 64,
    max_leaves: int = 10,
    max_undetected: int = 16,
    max_begun: int | None = None,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-5,
    exist_threshold: float = 1e-3,
    report_threshold: float = 0.5,
    trajectories: str = "all",
    num_birth_times: int = 0,
) -> Tracker:
    """Makes a multiscan trajectory Poisson multi-Bernoulli mixture filter.

    Args:
        target: How one target is filtered; it must have `smooth`, as
            `targets.single.single()` and `targets.imm.imm()` have.
        num_scans: N, scans after which the best hypothesis decides.
        lag: L, scans before those that are still smoothed by what comes.
        solver: How the best hypothesis is found, see `mht.mht`.
        max_hypotheses: Hypotheses by which probabilities are found, the likeliest; with
            1 the best is believed.
        max_tracks: Trees kept after a scan.
        max_leaves: Leaves kept of each, the likeliest.
        max_undetected: Components kept of the intensity of undetected targets.
        max_begun: Trees begun in a scan at most, those likeliest to be a target; None
            for one with each detection. The others count as false in `log_evidence`.
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Leaves of less weight than this share of their tree's go.
        exist_threshold: A tree goes where its target exists with less probability, and,
            if all trajectories are followed, did so in all scans still to be reported.
        report_threshold: A trajectory of the best hypothesis is reported where there
            was such a target with more probability, or is one, if only alive ones are.
        trajectories: Which are followed: "all", those that ended included, or "alive",
            those of targets that are there now, in fewer trees.
        num_birth_times: A, how many scans are told apart in which a target may have
            been born: that of its first detection, the one before, ..., the last of
            them or an earlier one; 0 for no such answer (`paths.birth_prob`, which
            later detections do not change).

    Raises:
        ValueError: A setting that makes no sense.
    """
    for name, number in (("lag", lag), ("num_birth_times", num_birth_times)):
        if number < 0:
            raise ValueError(f"{name} is {number}; give 0 or more")
    settings = track_oriented.Settings(
        target=target,
        solver=solver,
        max_hypotheses=max_hypotheses,
        max_leaves=max_leaves,
        max_undetected=max_undetected,
        num_scans=num_scans,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        thinning=thinning.Thinning(max_tracks, prune_threshold, exist_threshold),
        report_threshold=report_threshold,
        delay=max(num_scans + lag, 1),
        bernoulli=True,
        max_begun=max_begun,
        trajectories=trajectories,
        num_birth_times=num_birth_times,
    )
    return track_oriented.make(settings)
