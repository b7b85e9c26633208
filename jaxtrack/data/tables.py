"""Tables of tracks, one row for each target that a scan's estimate reports.

Example:
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from typing import NamedTuple
    >>> class Estimate(NamedTuple):
    ...     mean: np.ndarray
    ...     cov: np.ndarray
    ...     label: np.ndarray
    ...     exists: np.ndarray
    ...     existence_prob: np.ndarray
    >>> one = np.ones((1, 1))
    >>> estimates = Estimate(np.ones((1, 1, 4)), 4 * np.eye(4)[None, None],
    ...                      one.astype(int), one > 0, 0.9 * one)
    >>> table = tracks_table([0.0], estimates, (0, 2), (1, 3))
    >>> write_tracks(pathlib.Path(tempfile.mkdtemp()) / "tracks.csv", table)
    >>> print(table.to_string(index=False))
     time  label   x   y  vx  vy  std_x  std_y  existence_prob
      0.0      1 1.0 1.0 1.0 1.0    2.0    2.0             0.9
"""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxtrack.data import geodesy
from jaxtrack.data.cells import write_cells
from jaxtrack.data.errors import import_pandas
from jaxtrack.types import PyTree

DECIMALS = {"lat": 7, "lon": 7, "existence_prob": 4}  # 1e-7 degrees are 1 cm


def tracks_table(
    time: Any,
    estimates: PyTree,
    position_index: Sequence[int],
    velocity_index: Sequence[int],
    origin: geodesy.Origin | None = None,
    start: str | None = None,
) -> Any:
    """Lists the reported targets, scan by scan, in the order of their labels.

    Args:
        time: Seconds, the end of each scan, [T].
        estimates: Estimates of a tracker with a leading T: mean [T, N, D], cov
            [T, N, D, D], label [T, N], exists [T, N], existence_prob [T, N].
        position_index: Which components of the state are positions (P).
        velocity_index: Which are velocities, axis by axis (P).
        origin: (lat, lon) in degrees of the point (0, 0); adds columns lat and lon.
        start: The ISO time of second 0; makes the times ISO text.

    Returns:
        A pandas DataFrame with columns time, label, x, y, vx, vy, std_x, std_y (z too
        with three axes; metres and seconds), existence_prob, and perhaps lat, lon.
    """
    pandas = import_pandas()
    scan, slot, label = reported(estimates)
    mean = np.asarray(estimates.mean, float)[scan, slot]
    cov = np.asarray(estimates.cov, float)[scan, slot]

    seconds = np.asarray(time, float)[scan]
    if start is not None:
        stamps = pandas.Timestamp(start) + pandas.to_timedelta(seconds, unit="s")
        seconds = [stamp.isoformat(timespec="milliseconds") for stamp in stamps]
    axes = "xyz"[: len(position_index)]
    columns: dict[str, Any] = {"time": seconds, "label": label}
    positions = dict(zip(axes, position_index, strict=True))
    speeds = dict(zip(axes, velocity_index, strict=True))
    columns |= {axis: mean[:, i] for axis, i in positions.items()}
    columns |= {f"v{axis}": mean[:, i] for axis, i in speeds.items()}
    # Rounding may leave a variance of -1e-18, whose root would be NaN.
    columns |= {
        f"std_{axis}": np.sqrt(np.maximum(cov[:, i, i], 0.0))
        for axis, i in positions.items()
    }
    columns["existence_prob"] = np.asarray(estimates.existence_prob)[scan, slot]
    if origin is not None:
        lat, lon = geodesy.to_degrees(columns["x"], columns["y"], origin)
        columns |= {"lat": lat, "lon": lon}
    return pandas.DataFrame(columns)


def reported(estimates: PyTree) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds the n reported targets, scan by scan, in the order of their labels.

    Args:
        estimates: Estimates of a tracker with a leading T: label and exists [T, N].

    Returns:
        The scan, the slot and the label of each, all [n].

    Raises:
        ValueError: If there is another axis, as of several recordings.
    """
    exists = np.asarray(estimates.exists)
    if exists.ndim != 2:
        raise ValueError(
            f"estimates.exists has shape {exists.shape}, not [T, N]; give the "
            "estimates of one recording at a time."
        )
    scan, slot = np.nonzero(exists)
    label = np.asarray(estimates.label)[scan, slot]
    order = np.lexsort((label, scan))
    return scan[order], slot[order], label[order]


def write_tracks(path: str | os.PathLike[str], table: Any) -> None:
    """Writes a table of tracks as CSV, rounded to what its numbers can mean.

    Millimetres and milliseconds, 1e-7 degrees, 1e-4 for probabilities.

    Args:
        path: The file; what it held is lost.
        table: A table from `tracks_table`.

    Raises:
        DataError: If the file cannot be written.
    """
    decimals = {name: DECIMALS.get(name, 3) for name in table}
    write_cells(path, table.round(decimals))
