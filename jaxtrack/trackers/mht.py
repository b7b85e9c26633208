"""Multiple hypothesis tracking, track by track: trees of track hypotheses.

Every track tree keeps the likeliest of its leaves, whichever global hypothesis they may
belong to. Hypotheses are made only when they are needed: an assignment over the last
scans gives each tree one leaf, and no detection to two. The best of them decides what
lies `num_scans` scans back: leaves that say otherwise go. One scan is

    trees, hidden = predict(trees, hidden)
    scores, firsts = look(trees, hidden, scan)
    trees = each leaf followed by the detections in its gate, the likeliest kept
    hypotheses = assign(trees)                    # over num_scans + 1 scans
    trees = those that agree with the best hypothesis, num_scans ago

With `num_scans=0` it decides at once, as global nearest neighbour does.
`mht(target=imm())` is IMM-MHT.

`log_evidence` is the log-density of the scan given the leaves that were kept, summed
over the hypotheses that were found; `log_loss` tells how much better than the best of
these another one may be.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import mht
    >>> tracker = mht.mht(targets.single.single(), num_scans=2)

References: Kurien, "Issues in the design of practical multitarget tracking algorithms",
in Multitarget-Multisensor Tracking, ed. Bar-Shalom, 1990; Poore, "Multidimensional
assignment formulation of data association problems arising from multitarget and
multisensor tracking", Computational Optimization and Applications 3, 1994; Chong, Mori
and Reid, "Forty years of multiple hypothesis tracking", Journal of Advances in
Information Fusion 14(2), 2019, section IV.
"""

import functools

from jaxtrack.trackers import association, thinning, track_oriented
from jaxtrack.types import Target, Tracker


@functools.cache
def mht(
    target: Target,
    num_scans: int = 2,
    solver: str = "lagrangian",
    max_hypotheses: int = 32,
    max_tracks: int = 64,
    max_leaves: int = 10,
    max_undetected: int = 16,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-5,
    exist_threshold: float = 1e-3,
    report_threshold: float = 0.5,
    delay: int | None = None,
) -> Tracker:
    """Makes a track-oriented multiple hypothesis tracker.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        num_scans: Scans after which the best hypothesis decides; 0 decides at once.
        solver: How that is found: "lagrangian", "decomposition", "greedy", or "exact",
            which calls SciPy's HiGHS on the host.
        max_hypotheses: Hypotheses by which probabilities are found, the likeliest; with
            1 the best is believed.
        max_tracks: Trees kept after a scan.
        max_leaves: Leaves kept of each, the likeliest; that nothing more was detected
            may always be one of them.
        max_undetected: Components kept of the intensity of undetected targets.
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Leaves of less weight than this share of their tree's go.
        exist_threshold: A tree goes where its target exists with less probability.
        report_threshold: A track of the best hypothesis is reported where its target
            exists with more probability.
        delay: Scans after which where the targets were is reported once more, smoothed;
            at least `num_scans`. None for no such output.

    Raises:
        ValueError: A setting that makes no sense.
    """
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
        delay=delay,
    )
    return track_oriented.make(settings)
