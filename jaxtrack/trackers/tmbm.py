"""The multiscan trajectory multi-Bernoulli mixture filters: TMBM and TMBM01.

As `tpmbm`, for births that are multi-Bernoulli: in every scan at most one target is
born at each place, with a known probability. A track begins with the birth, not with a
detection, and a detection that no track has is clutter.

In TMBM01 (`certain=True`) every leaf of a track says whether its target is there, and
if not, after which scan it ended or that it was never born: existence probabilities are
0 or 1. The density is the same, in many more hypotheses, so that it needs more leaves.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import tmbm
    >>> tracker = tmbm.tmbm(targets.single.single(), num_scans=3, lag=1)

Reference: Xia, Granstrom, Svensson, Garcia-Fernandez and Williams, "Multiscan
implementation of the trajectory Poisson multi-Bernoulli mixture filter", Journal of
Advances in Information Fusion 14(2), 2019, theorems 1 to 3 and appendix C.
"""

import functools

from jaxtrack.trackers import association, thinning, track_oriented
from jaxtrack.types import Target, Tracker


@functools.cache
def tmbm(
    target: Target,
    num_scans: int = 3,
    lag: int = 1,
    solver: str = "decomposition",
    max_hypotheses: int = 32,
    max_tracks: int = 64,
    max_leaves: int = 10,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-5,
    exist_threshold: float = 1e-3,
    report_threshold: float = 0.5,
    certain: bool = False,
    trajectories: str = "all",
) -> Tracker:
    """Makes a multiscan trajectory multi-Bernoulli mixture filter.

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
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Leaves of less weight than this share of their tree's go.
        exist_threshold: A tree goes where its target exists with less probability, and,
            if all trajectories are followed, did so in all scans still to be reported.
        report_threshold: A trajectory of the best hypothesis is reported where there
            was such a target with more probability, or is one, if only alive ones are.
        certain: Whether hypotheses say who is there: TMBM01.
        trajectories: Which are followed: "all", those that ended included, or "alive",
            those of targets that are there now, in fewer trees. Hypotheses of TMBM01
            do not say then when the others ended.

    Raises:
        ValueError: A setting that makes no sense.
    """
    if lag < 0:
        raise ValueError(f"lag is {lag}; give 0 or more")
    settings = track_oriented.Settings(
        target=target,
        solver=solver,
        max_hypotheses=max_hypotheses,
        max_leaves=max_leaves,
        max_undetected=1,
        num_scans=num_scans,
        gating=association.Gating(gate_prob, in_missed=False, counts_clutter=False),
        thinning=thinning.Thinning(max_tracks, prune_threshold, exist_threshold),
        report_threshold=report_threshold,
        delay=max(num_scans + lag, 1),
        bernoulli=True,
        hides=False,
        certain=certain,
        trajectories=trajectories,
    )
    return track_oriented.make(settings)
