"""All hypotheses about which detections of a few scans have a common cause.

A track is which detection of each scan a target caused; a hypothesis is a set of tracks
that share none, and what is in no track is false. The number of hypotheses grows beyond
all bounds, so this is for a few scans of a few detections.

    >>> from jaxtrack.trackers import enumeration
    >>> table = enumeration.table((1, 1))  # a detection in each of two scans
    >>> print(table.track.tolist())
    [[-1, 0], [0, -1], [0, 0]]
    >>> print(table.member.astype(int).tolist())
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]]

Reference: Mori, Chong and Chang, "Three mathematical formalisms of multiple hypothesis
tracking", Journal of Advances in Information Fusion 14(2), 2019, equations 13 to 16.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

MAX_HYPOTHESES = 100_000


class Table(NamedTuple):
    """All tracks and hypotheses; NumPy arrays.

    Attributes:
        track: Which detection of each scan, -1 for none, [A, S].
        member: Which tracks each hypothesis has, [H, A] (bool).
        num_tracks: How many these are, [H].
        num_false: How many detections of each scan it calls false, [H, S].
    """

    track: np.ndarray
    member: np.ndarray
    num_tracks: np.ndarray
    num_false: np.ndarray


@functools.cache
def table(num_detections: tuple[int, ...]) -> Table:
    """Lists all tracks and hypotheses.

    Args:
        num_detections: Of each scan.

    Raises:
        ValueError: There are too many.
    """
    if (number := count(num_detections)) > MAX_HYPOTHESES:
        raise ValueError(
            f"num_detections is {num_detections}, which makes {number} hypotheses; "
            f"give fewer or shorter scans, up to {MAX_HYPOTHESES} hypotheses"
        )
    tracks = list(itertools.product(*(range(-1, m) for m in num_detections)))[1:]
    uses = [
        frozenset((k, j) for k, j in enumerate(track) if j >= 0) for track in tracks
    ]
    sets: list[tuple[int, ...]] = []

    def extend(chosen: tuple[int, ...], used: frozenset) -> None:
        sets.append(chosen)
        for after in range(chosen[-1] + 1 if chosen else 0, len(tracks)):
            if not used & uses[after]:
                extend((*chosen, after), used | uses[after])

    extend((), frozenset())
    sets.sort(key=lambda chosen: chosen[::-1])
    member = np.zeros((len(sets), len(tracks)), bool)
    for row, chosen in enumerate(sets):
        member[row, list(chosen)] = True
    track = np.array(tracks, int).reshape(len(tracks), len(num_detections))
    explained = member.astype(int) @ (track >= 0).astype(int)
    return Table(track, member, member.sum(1), np.array(num_detections) - explained)


def count(num_detections: Sequence[int]) -> int:
    """Returns how many hypotheses there are, without listing them."""
    numbers = {0: 1}  # how many hypotheses have so many tracks
    for size in num_detections:
        after: dict[int, int] = {}
        for old, ways in numbers.items():
            for again in range(min(old, size) + 1):
                pairs = math.comb(old, again) * math.perm(size, again)
                for new in range(size - again + 1):
                    here = ways * pairs * math.comb(size - again, new)
                    after[old + new] = after.get(old + new, 0) + here
        numbers = after
    return sum(numbers.values())
