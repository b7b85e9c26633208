"""Whether tracks keep to their targets: IDF1 and CLEAR MOT. Runs on the host.

IDF1 pairs whole true trajectories with whole tracks, one to one, so that as many
detections as possible are explained, and then counts over all frames. Switches are
counted frame by frame: a target keeps the label it had while that label is near
enough, otherwise it takes one from a matching of what is left, and each change of its
label is a switch. MOTA and MOTP sum that matching up.

    >>> import numpy as np
    >>> from jaxtrack.metrics import identity
    >>> here = np.zeros((1, 2))
    >>> frames = [identity.Frame(np.array([7]), here, np.array([label]), here)
    ...           for label in (1, 1, 1, 2)]
    >>> scores = identity.id_scores(frames, max_distance=10.0)
    >>> print(scores.idf1, scores.num_switches)
    0.75 1

References: Ristani, Solera, Zou, Cucchiara and Tomasi, "Performance measures and a
data set for multi-target, multi-camera tracking", ECCV workshops, 2016 (IDF1);
Bernardin and Stiefelhagen, "Evaluating multiple object tracking performance: the
CLEAR MOT metrics", EURASIP J. Image and Video Processing, 2008.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist


class Frame(NamedTuple):
    """What was there and what was reported at one time; only what exists, no padding.

    Attributes:
        true_id: Whole numbers or strings, each at most once, [n].
        true_position: [n, P].
        label: Of the tracks; whole numbers or strings, each at most once, [m].
        position: [m, P].
    """

    true_id: np.ndarray
    true_position: np.ndarray
    label: np.ndarray
    position: np.ndarray


class IdScores(NamedTuple):
    """Scores over all frames. A ratio 0 / 0 (nothing to get wrong) is 1.

    Attributes:
        idf1: Share of truths and reports that the right identity explains, 0 to 1.
        idp: The same share of the reports alone (precision).
        idr: The same share of the truths alone (recall).
        num_switches: How often a target's label changed.
        num_matched: Truths matched frame by frame, whatever the label.
        num_missed: Truths not so matched.
        num_false: Reports not so matched.
        num_truths: Truths in all frames.
        mota: 1 - (num_missed + num_false + num_switches) / num_truths, at most 1; where
            there are no truths, 1 if nothing is reported either and else 0.
        motp: Mean distance of the matched, in the unit of the points; 0 if there are
            none.
    """

    idf1: float
    idp: float
    idr: float
    num_switches: int
    num_matched: int
    num_missed: int
    num_false: int
    num_truths: int
    mota: float
    motp: float


class _Near(NamedTuple):
    """One frame with identities as indices, and the pairs that are near enough."""

    target: np.ndarray  # [n] int
    track: np.ndarray  # [m] int
    row: np.ndarray  # of each pair, an index into target
    column: np.ndarray  # of each pair, an index into track
    distance: np.ndarray  # of each pair


def id_scores(frames: Iterable[Frame], max_distance: float) -> IdScores:
    """Scores labelled tracks against true identities.

    Args:
        frames: One a time step, in order.
        max_distance: A report farther than this from a truth cannot be that truth.

    Returns:
        The scores; all positions of all frames count alike.

    Raises:
        ValueError: A bad `max_distance`, an identity that is twice in a frame, or not
            as many positions as identities.
    """
    if not 0 < max_distance < math.inf:
        raise ValueError(
            f"max_distance is {max_distance}; it must be positive and finite."
        )
    frames = list(frames)
    targets = numbered([frame.true_id for frame in frames], "true_id")
    tracks = numbered([frame.label for frame in frames], "label")
    nears = [
        _measure(target, track, frame, max_distance)
        for target, track, frame in zip(targets, tracks, frames, strict=True)
    ]
    num_truths = sum(near.target.size for near in nears)
    num_reports = sum(near.track.size for near in nears)
    num_explained = _explained(nears)
    num_matched, num_switches, far = _follow(nears, max_distance)
    num_wrong = num_truths + num_reports - 2 * num_matched + num_switches
    return IdScores(
        idf1=_ratio(2 * num_explained, num_truths + num_reports),
        idp=_ratio(num_explained, num_reports),
        idr=_ratio(num_explained, num_truths),
        num_switches=num_switches,
        num_matched=num_matched,
        num_missed=num_truths - num_matched,
        num_false=num_reports - num_matched,
        num_truths=num_truths,
        mota=1 - num_wrong / num_truths if num_truths else float(not num_reports),
        motp=far / num_matched if num_matched else 0.0,
    )


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else 1.0


def numbered(names: Sequence[np.ndarray], what: str) -> list[np.ndarray]:
    """Numbers the identities in the arrays of all frames from 0.

    Args:
        names: Of each frame, each identity at most once.
        what: Their name in an error.

    Raises:
        ValueError: An identity is twice in a frame.
    """
    names = [np.asarray(name) for name in names]
    for time, name in enumerate(names):
        if np.unique(name).size < name.size:
            raise ValueError(
                f"{what} of frame {time} has an identity twice; give each once at most."
            )
    filled = [name for name in names if name.size]
    if not filled:
        return [np.zeros(0, int) for _ in names]
    _, index = np.unique(np.concatenate(filled), return_inverse=True)
    ends = np.cumsum([name.size for name in names])
    return np.split(index, ends[:-1])


def _measure(
    target: np.ndarray, track: np.ndarray, frame: Frame, max_distance: float
) -> _Near:
    """Finds the pairs of one frame that are near enough."""
    for name, position in (target, frame.true_position), (track, frame.position):
        if len(position) != name.size:
            raise ValueError(
                f"a frame has {name.size} identities and {len(position)} positions; "
                f"give one position for each."
            )
    if not target.size or not track.size:
        none = np.zeros(0, int)
        return _Near(target, track, none, none, np.zeros(0))
    distance = cdist(frame.true_position, frame.position)
    row, column = np.nonzero(distance <= max_distance)
    return _Near(target, track, row, column, distance[row, column])


def _explained(nears: Sequence[_Near]) -> int:
    """Counts the reports of the best one-to-one pairing of trajectories (IDTP).

    Least false plus missed of Ristani et al. is most explained, as both sums are fixed.
    """
    num_targets = max((near.target.max(initial=-1) for near in nears), default=-1) + 1
    num_tracks = max((near.track.max(initial=-1) for near in nears), default=-1) + 1
    together = np.zeros((num_targets, num_tracks), int)
    for near in nears:
        together[near.target[near.row], near.track[near.column]] += 1
    rows, columns = linear_sum_assignment(together, maximize=True)
    return int(together[rows, columns].sum())


def _follow(nears: Sequence[_Near], max_distance: float) -> tuple[int, int, float]:
    """Counts matches and switches frame by frame, and sums the distances of matches.

    A target's last label is remembered over any gap. Where two targets remember the
    same one, the target that had it last goes first.
    """
    num_matched, num_switches, far = 0, 0, 0.0
    last: dict[int, tuple[int, int]] = {}  # target: (time, track)
    for time, near in enumerate(nears):
        row, column = _keep(near, last)
        more_row, more_column = _match(near, row, column, max_distance)
        row, column = row + more_row, column + more_column
        num_matched += len(row)
        matched = set(zip(row, column, strict=True))
        far += sum(
            distance
            for *pair, distance in zip(
                near.row, near.column, near.distance, strict=True
            )
            if tuple(pair) in matched
        )
        pairs = zip(near.target[row].tolist(), near.track[column].tolist(), strict=True)
        for target, track in pairs:
            num_switches += target in last and last[target][1] != track
            last[target] = (time, track)
    return num_matched, num_switches, far


def _keep(near: _Near, last: dict[int, tuple[int, int]]) -> tuple[list[int], list[int]]:
    """Finds the pairs of earlier frames that are still near enough."""
    allowed = set(zip(near.row.tolist(), near.column.tolist(), strict=True))
    place = {track: j for j, track in enumerate(near.track.tolist())}
    known = [(last[t], i) for i, t in enumerate(near.target.tolist()) if t in last]
    pairs: dict[int, int] = {}  # column: row
    for (_, track), i in sorted(known, reverse=True):
        j = place.get(track, -1)
        if (i, j) in allowed and j not in pairs:
            pairs[j] = i
    return list(pairs.values()), list(pairs)


def _match(
    near: _Near, rows: list[int], columns: list[int], max_distance: float
) -> tuple[list[int], list[int]]:
    """Matches what is left: most pairs near enough first, then least distance."""
    free = ~np.isin(near.row, rows) & ~np.isin(near.column, columns)
    row, i = np.unique(near.row[free], return_inverse=True)
    column, j = np.unique(near.column[free], return_inverse=True)
    # More than the distances of all the pairs made could amount to.
    forbidden = max_distance * (min(row.size, column.size) + 1)
    cost = np.full((row.size, column.size), forbidden)
    cost[i, j] = near.distance[free]
    i, j = linear_sum_assignment(cost)
    found = cost[i, j] < forbidden
    return row[i[found]].tolist(), column[j[found]].tolist()
