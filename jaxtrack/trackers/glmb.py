"""The delta-generalized labeled multi-Bernoulli filter: GLMB, in one step a scan.

Targets have labels from birth. What is known of them all is a mixture over hypotheses
about who is there and which detections each has had; given one, they are independent.
Every scan each hypothesis is followed by some of its children: each target is gone, or
missed, or has a detection of its own, and so has each that may be born now.

That is the mixture of `mbm.mbm01`, whose tracks exist for certain or not at all and are
in a labeled filter the targets (Garcia-Fernandez et al. 2018, section IV, who show that
`mbm` says the same with fewer hypotheses). What differs is how the literature goes on
from there: children are drawn by Gibbs sampling or found by Murty's ranking, and
reported is the likeliest hypothesis of those with the likeliest number of targets.

`log_evidence` is as in `pmbm`, over the children that were found. Where they are drawn,
`dropped` counts those found and not kept, but none that no chain came to.

    >>> from jaxtrack import targets
    >>> from jaxtrack.trackers import glmb
    >>> tracker = glmb.glmb(targets.single.single(), max_hypotheses=200, num_sweeps=5)

References: Vo, Vo and Phung, "Labeled random finite sets and the Bayes multi-target
tracking filter", IEEE Trans. Signal Processing 62(24), 2014; Vo, Vo and Hoang, "An
efficient implementation of the generalized labeled multi-Bernoulli filter", the same
65(8), 2017; Garcia-Fernandez, Williams, Granstrom and Svensson, "Poisson multi-
Bernoulli mixture filter: direct derivation and implementation", IEEE Trans. Aerospace
and Electronic Systems 54(4), 2018.
"""

import functools

from jaxtrack import gate
from jaxtrack.trackers import association, bernoulli_mixture, thinning
from jaxtrack.types import Target, Tracker

METHODS = "gibbs", "k-best"


@functools.cache
def glmb(
    target: Target,
    method: str = "gibbs",
    num_sweeps: int = 10,
    max_hypotheses: int = 200,
    max_children: int | None = None,
    max_tracks: int = 32,
    max_leaves: int = 12,
    gate_prob: float = 0.999,
    prune_threshold: float = 1e-5,
    merge_threshold: float = 0.0,
) -> Tracker:
    """Makes a GLMB filter.

    Its `undetected.Params` have a `MultiBernoulliBirth`, and nobody undetected.

    Args:
        target: How one target is filtered, e.g. `targets.single.single()`.
        method: How children are found: "gibbs", in as many chains as there is room for
            children, shared out by the square roots of the parents' weights; or
            "k-best", the heaviest of all.
        num_sweeps: Children that each chain comes to.
        max_hypotheses: See `pmbm.pmbm`, as for all others.
        max_children: Children kept in a scan, before hypotheses are pruned.
        max_tracks: Targets kept, those just born not counted before the end of the
            scan.
        max_leaves: Different histories kept of each.
        gate_prob: P_G; 1 for no gate.
        prune_threshold: Hypotheses of less probability go.
        merge_threshold: Histories of one target become one; 0 for never.

    Raises:
        ValueError: A setting that makes no sense.
    """
    gate.check(gate_prob)
    check(method, num_sweeps)
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
        estimator="number",
        report_threshold=0.5,
        num_sweeps=num_sweeps if method == "gibbs" else 0,
    )
    return bernoulli_mixture.make(settings)


def check(method: str, num_sweeps: int, methods: tuple[str, ...] = METHODS) -> None:
    """Raises a ValueError for a way to find joint events that there is not."""
    if method not in methods:
        raise ValueError(f"method is {method!r}; give one of {', '.join(methods)}")
    if num_sweeps < 1:
        raise ValueError(f"num_sweeps is {num_sweeps}; give at least 1")
