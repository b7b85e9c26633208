"""How many targets there are: one file, one algorithm, one `Tracker`.

>>> from jaxtrack import targets, trackers
>>> sorted(trackers.cbmember.cbmember(targets.single.single())._fields)
['init', 'step']
"""

from jaxtrack.trackers import (
    association,
    bernoulli,
    cbmember,
    clustering,
    counting,
    cphd,
    extraction,
    gnn,
    hypotheses,
    initiation,
    intensity,
    jpda,
    jpda_star,
    management,
    nearest,
    options,
    pda,
    phd,
    reduction,
    set_jpda,
    single_scan,
)

__all__ = [
    "association",
    "bernoulli",
    "cbmember",
    "clustering",
    "counting",
    "cphd",
    "extraction",
    "gnn",
    "hypotheses",
    "initiation",
    "intensity",
    "jpda",
    "jpda_star",
    "management",
    "nearest",
    "options",
    "pda",
    "phd",
    "reduction",
    "set_jpda",
    "single_scan",
]
