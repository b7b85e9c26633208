"""Makes the trackers of `single_scan`: what may be chosen, and what is refused.

>>> from jaxtrack import targets
>>> from jaxtrack.trackers import pda
>>> pda.pda(targets.single.single(), max_tracks=0)
Traceback (most recent call last):
...
ValueError: max_tracks is 0; give at least 1
"""

import functools
from collections.abc import Callable
from typing import TypedDict

from jaxtrack import gate
from jaxtrack.trackers import association, management, single_scan
from jaxtrack.trackers.association import Association, Gating
from jaxtrack.types import Array, PyTree, Target, Tracker


class Options(TypedDict, total=False):
    """What may be chosen for every tracker of the family; see `make`."""

    rule: management.Rule
    max_tracks: int
    max_births: int
    start_threshold: float
    gate_prob: float
    gate_in_missed: bool
    counts_clutter: bool
    duplicate_threshold: float


def make(
    target: Target,
    associate: Callable[[Array], Association],
    update: Callable[..., PyTree] = association.blend,
    weighs: bool = False,
    rule: management.Rule | None = None,
    max_tracks: int = 32,
    max_births: int = 16,
    start_threshold: float = 0.5,
    gate_prob: float = 0.999,
    gate_in_missed: bool = False,
    counts_clutter: bool = False,
    duplicate_threshold: float = 0.0,
) -> Tracker:
    """Makes a tracker of the family.

    Args:
        target: How one target is filtered.
        associate: log_score [N, K + 1] -> Association: the algorithm.
        update: (target, params, sighting, answer, scan) -> beliefs [N, ...].
        weighs: Whether the scores count the probability that a track exists.
        rule: How tracks are confirmed and dropped, of `management`; by default `MofN`,
            or `Existence` where the scores count it.
        max_tracks: Tracks kept after a scan; tentative and unlikely ones go first.
        max_births: Tracks begun in a scan, where it is detections that begin them.
        start_threshold: A detection begins no track where it is unexplained with less
            probability.
        gate_prob: P_G; 1 for no gate.
        gate_in_missed: Weigh a miss by 1 - P_D P_G, not by 1 - P_D.
        counts_clutter: Take the clutter's density from the detections in the gates
            (nonparametric), not from the clutter model.
        duplicate_threshold: A track goes that is so near a confirmed or likelier one,
            in squared Mahalanobis distance by both covariances: it follows the same
            target. With 0 none goes.

    Raises:
        ValueError: A setting that makes no sense.
    """
    rule = rule or (management.Existence() if weighs else management.MofN())
    _check(max_tracks, max_births, gate_prob, start_threshold, counts_clutter)
    management.check(rule)
    if not duplicate_threshold >= 0:
        raise ValueError(
            f"duplicate_threshold is {duplicate_threshold}; give a squared distance, "
            "e.g. 1, or 0 for none"
        )
    settings = single_scan.Settings(
        target=target,
        weighs=weighs,
        associate=associate,
        update=update,
        rule=rule,
        gating=Gating(gate_prob, gate_in_missed, counts_clutter),
        max_tracks=max_tracks,
        max_births=max_births,
        start_threshold=start_threshold,
        duplicate_threshold=duplicate_threshold,
    )
    return Tracker(
        init=functools.partial(single_scan.init, settings),
        step=functools.partial(single_scan.step, settings),
    )


def _check(
    max_tracks: int,
    max_births: int,
    gate_prob: float,
    start_threshold: float,
    counts_clutter: bool,
) -> None:
    if max_tracks < 1:
        raise ValueError(f"max_tracks is {max_tracks}; give at least 1")
    if max_births < 0:
        raise ValueError(f"max_births is {max_births}; give 0 or more")
    if not 0 <= start_threshold <= 1:
        raise ValueError(
            f"start_threshold is {start_threshold}; give a probability, e.g. 0.5"
        )
    gate.check(gate_prob)
    if counts_clutter and gate_prob == 1:
        raise ValueError(
            "gate_prob is 1 and counts_clutter is set, which counts within gates; give "
            "gate_prob below 1, e.g. 0.999"
        )
