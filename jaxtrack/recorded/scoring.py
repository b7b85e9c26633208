"""Tracks scored against identities that are in the file, which no tracker sees.

The truth at the time of a scan is interpolated between an identity's reports. Scans
that end after the last detection are not scored, as nobody knows the truth there.

    >>> import numpy as np
    >>> from jaxtrack.metrics.identity import Frame
    >>> from jaxtrack.recorded import scoring
    >>> here, there = np.zeros((1, 2)), np.full((1, 2), 3.0)
    >>> frames = [Frame(np.array(["Ada"]), here, np.array([4]), there)]
    >>> print(scoring.distances(frames, cutoff=10.0).localisation)
    [18.]
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.data import scans as grouping
from jaxtrack.data.errors import DataError
from jaxtrack.data.files import Table, further_column
from jaxtrack.metrics import identity
from jaxtrack.metrics.gospa import Gospa, gospa
from jaxtrack.recorded.settings import known
from jaxtrack.recorded.tracking import Result

ORDER = 2.0  # of GOSPA


class Scores(NamedTuple):
    """How well the tracks fit the identities, over the T scans that are scored.

    Attributes:
        time: Seconds, [T].
        gospa: GOSPA and its parts, each [T].
        identity: IDF1, switches and the like, over all scans.
        num_truths: Identities that are there, [T].
        num_reported: Tracks, [T].
    """

    time: np.ndarray
    gospa: Gospa
    identity: identity.IdScores
    num_truths: np.ndarray
    num_reported: np.ndarray


def score(result: Result, table: Table, column: str) -> Scores:
    """Scores tracks against a column of identities.

    Args:
        result: From `tracking.track`.
        table: The detections that were tracked.
        column: A further column; rows where it is blank are no truth.

    Raises:
        DataError: If there is no such column, or no identity in it.
    """
    names = further_column(table, column)
    cutoff, max_gap = map(known, result.settings.score)
    ids, position, exists = grouping.truth_at(
        table.time, table.xy, names, result.scans.time, max_gap
    )
    if not len(ids):
        raise DataError(f"The column {column!r} is blank; choose one with identities.")
    scored = np.flatnonzero(result.scans.time <= table.time[-1]).tolist()
    frames = [frame(result, ids, position, exists, t) for t in scored]
    return Scores(
        time=result.scans.time[scored],
        gospa=distances(frames, cutoff),
        identity=identity.id_scores(frames, cutoff),
        num_truths=np.array([len(one.true_id) for one in frames], int),
        num_reported=np.array([len(one.label) for one in frames], int),
    )


def frame(
    result: Result, ids: np.ndarray, position: np.ndarray, exists: np.ndarray, scan: int
) -> identity.Frame:
    """Takes what was there and what was reported at one scan.

    Args:
        result: From `tracking.track`.
        ids: n identities.
        position: Theirs, [T, n, 2].
        exists: Whether they are there, [T, n].
        scan: Which scan.
    """
    there, reported = exists[scan], result.estimates.exists[scan]
    mean = result.estimates.mean[scan][reported]
    return identity.Frame(
        true_id=ids[there],
        true_position=position[scan][there],
        label=result.estimates.label[scan][reported],
        position=mean[:, list(result.motion.position_index)],
    )


def summary(scores: Scores, settings: Any) -> dict[str, Any]:
    """Sums scores up in numbers that JSON can hold.

    Args:
        scores: From `score`.
        settings: The `Score` settings they were made with.
    """
    parts = {key: _mean(value) for key, value in scores.gospa._asdict().items()}
    over_time = [round(float(x), 3) for x in scores.gospa.distance]
    return {
        **scores.identity._asdict(),
        "cutoff": settings.cutoff,
        "max_gap": settings.max_gap,
        "gospa": {"mean": parts.pop("distance"), **parts, "order": ORDER},
        "gospa_over_time": {
            "time": [float(t) for t in scores.time],
            "distance": over_time,
        },
        "cardinality_bias": _mean(scores.num_reported - scores.num_truths),
    }


def distances(frames: list[identity.Frame], cutoff: float) -> Gospa:
    """Measures the GOSPA of every frame.

    Args:
        frames: T of them.
        cutoff: m.

    Returns:
        GOSPA and its parts, each [T].
    """
    truth = _pad([one.true_position for one in frames])
    report = _pad([one.position for one in frames])
    many = jax.jit(jax.vmap(gospa, (0, 0, 0, 0, None, None)))
    return jax.tree.map(np.asarray, many(*truth, *report, float(cutoff), ORDER))


def _pad(sets: list[np.ndarray]) -> tuple[jax.Array, jax.Array]:
    """Pads sets [n, 2] to one size: places [T, N, 2], and which are there [T, N]."""
    most = max([1, *map(len, sets)])
    place = np.zeros((len(sets), most, 2))
    there = np.zeros((len(sets), most), bool)
    for t, one in enumerate(sets):
        place[t, : len(one)], there[t, : len(one)] = one, True
    return jnp.asarray(place, float), jnp.asarray(there)


def _mean(values: np.ndarray) -> float | None:
    mean = float(np.mean(values)) if len(values) else math.nan
    return mean if math.isfinite(mean) else None
