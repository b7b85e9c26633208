"""HOTA: how well targets are detected and how well tracks keep to them, in one number.

For points, the similarity of a truth and a report at distance d is 1 - d / c, c the
cut-off, and 0 beyond it. At each of nineteen thresholds a pair counts as a true
positive if it is as similar as that; then

    detection   = TP / (TP + FN + FP)
    association = mean over all true positives of TPA / (TPA + FNA + FPA)
    hota        = sqrt(detection * association)

where TPA are the true positives of the same target and track, FNA what else there is of
the target and FPA of the track. Frames are matched once, for all thresholds, so that
pairs which fit over all time come first, as the authors' code does. Runs on the host.

    >>> import numpy as np
    >>> from jaxtrack.metrics import hota
    >>> from jaxtrack.metrics.identity import Frame
    >>> here = np.zeros((1, 2))
    >>> frames = [Frame(np.array([7]), here, np.array([label]), here)
    ...           for label in (1, 1, 1, 2)]
    >>> scores = hota.hota(frames, cutoff=10.0)
    >>> print(scores.detection, scores.association)  # (3 * 3/4 + 1 * 1/4) / 4
    1.0 0.625

Reference: Luiten, Osep, Dendorfer, Torr, Geiger, Leal-Taixe and Leibe, "HOTA: a higher
order metric for evaluating multi-object tracking", Int. J. Computer Vision 129, 2021.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from jaxtrack.metrics.identity import Frame, numbered

THRESHOLDS = np.arange(1, 20) / 20  # of the similarity
SLACK = np.finfo(float).eps  # a pair at the threshold counts


class Hota(NamedTuple):
    """Means over the thresholds, each from 0 to 1.

    Attributes:
        hota: The geometric mean of detection and association, then averaged.
        detection: DetA.
        association: AssA; 0 at a threshold that no pair reaches.
        localisation: LocA, the mean similarity of true positives; 1 if there are none.
        curve: `hota` at each threshold, [19].
    """

    hota: float
    detection: float
    association: float
    localisation: float
    curve: np.ndarray


class _Seen(NamedTuple):
    """One frame: its targets [n] and tracks [m] as indices, and similarities [n, m]."""

    target: np.ndarray
    track: np.ndarray
    similarity: np.ndarray


def hota(frames: Iterable[Frame], cutoff: float) -> Hota:
    """Scores labelled tracks against true identities.

    Args:
        frames: One a time step, in order.
        cutoff: Distance at which a pair is not similar at all.

    Returns:
        The scores; 1 where there was nothing to get wrong.

    Raises:
        ValueError: A bad `cutoff`, or an identity that is twice in a frame.
    """
    if not 0 < cutoff < math.inf:
        raise ValueError(f"cutoff is {cutoff}; it must be positive and finite.")
    frames = list(frames)
    targets = numbered([frame.true_id for frame in frames], "true_id")
    tracks = numbered([frame.label for frame in frames], "label")
    seen = [
        _Seen(target, track, _similarity(frame, cutoff))
        for target, track, frame in zip(targets, tracks, frames, strict=True)
    ]
    target_count, track_count = _counts(targets), _counts(tracks)
    num_truths, num_reports = int(target_count.sum()), int(track_count.sum())
    if not num_truths + num_reports:
        return Hota(1.0, 1.0, 1.0, 1.0, np.ones(len(THRESHOLDS)))

    target, track, similarity = _matched(seen, target_count, track_count)
    scores = []
    for threshold in THRESHOLDS:
        hit = similarity >= threshold - SLACK
        together = np.zeros((len(target_count), len(track_count)))
        np.add.at(together, (target[hit], track[hit]), 1)
        apart = target_count[:, None] + track_count[None] - together
        number = int(hit.sum())
        detection = number / (num_truths + num_reports - number)
        kept = (together**2 / apart).sum() / max(number, 1)
        near = similarity[hit].mean() if number else 1.0
        scores.append((math.sqrt(detection * kept), detection, kept, near))
    table = np.array(scores)
    return Hota(*map(float, table.mean(0)), curve=table[:, 0])


def _similarity(frame: Frame, cutoff: float) -> np.ndarray:
    """Returns the similarities [n, m] of a frame; 0 where a place is not finite."""
    if not len(frame.true_id) or not len(frame.label):
        return np.zeros((len(frame.true_id), len(frame.label)))
    distance = cdist(frame.true_position, frame.position)
    return np.maximum(1 - np.where(np.isfinite(distance), distance, cutoff) / cutoff, 0)


def _counts(indices: Sequence[np.ndarray]) -> np.ndarray:
    """Counts the frames in which each identity is."""
    return np.bincount(np.concatenate([np.zeros(0, int), *indices]))


def _matched(
    seen: Sequence[_Seen], target_count: np.ndarray, track_count: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matches frame by frame: target, track and similarity of each pair made.

    Pairs are worth their similarity times how well the two fit over all frames: the
    frames that they could share, each by its share of the similarities around it,
    relative to the frames of either.
    """
    shared = np.zeros((len(target_count), len(track_count)))
    for target, track, similarity in seen:
        around = similarity.sum(0)[None] + similarity.sum(1)[:, None] - similarity
        share = similarity / np.where(around > SLACK, around, 1)
        shared[target[:, None], track[None]] += share
    fit = shared / (target_count[:, None] + track_count[None] - shared)

    pairs = []
    for target, track, similarity in seen:
        worth = fit[target[:, None], track[None]] * similarity
        row, column = linear_sum_assignment(worth, maximize=True)
        pairs.append((target[row], track[column], similarity[row, column]))
    if not pairs:
        none = np.zeros(0, int)
        return none, none, np.zeros(0)
    one, other, similarity = (np.concatenate(x) for x in zip(*pairs, strict=True))
    return one, other, similarity
