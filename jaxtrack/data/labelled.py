"""Estimates and scans as labelled arrays of xarray, and back: one run or many.

    dataset = estimates_to_dataset(estimates, scans.time, states_of(motion, 4))
    dataset.to_netcdf("estimates.nc", engine="h5netcdf")
    estimates, time, start = estimates_from_dataset(dataset)

Dimensions are run (if there are many), time, track, state and mode; run, time,
detection and measurement. The time is in seconds, or a clock's (`datetime64`); all runs
share it. The units of a state's components are the coordinate unit.

Example:
    >>> from jaxtrack.types import Scan
    >>> scan = Scan(np.ones((2, 3, 2)), np.array([[1, 0, 0]] * 2) > 0, np.ones(2))
    >>> data = scans_to_dataset(scan, [0.0, 1.0], {"range": "m", "bearing": "rad"})
    >>> float(data.detections.sel(measurement="range").where(data.valid).sum())
    2.0
    >>> again, time, start = scans_from_dataset(data)
    >>> print(again.valid.sum(), time, start)
    2 [0. 1.] None
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxtrack.data import clock
from jaxtrack.data.errors import DataError, import_xarray
from jaxtrack.trackers.bernoulli import Estimate
from jaxtrack.types import PyTree, Scan

if TYPE_CHECKING:
    import xarray

# What each array has beside run and time, and what it means in words.
ESTIMATES: dict[str, tuple[tuple[str, ...], str]] = {
    "mean": (("track", "state"), "estimated state"),
    "cov": (("track", "state", "state_with"), "covariance of the estimated state"),
    "label": (("track",), "label of the track"),
    "exists": (("track",), "the track is reported"),
    "existence_prob": (("track",), "probability that the target exists"),
    "mode_prob": (("track", "mode"), "probability of each motion mode"),
    "effective_size": (("track",), "equally weighted particles it is worth"),
    "num_mean": ((), "expected number of targets"),
    "num_var": ((), "variance of the number of targets"),
    "log_evidence": ((), "log-evidence of the scan"),
    "dropped": ((), "expected targets dropped"),
}
SCANS: dict[str, tuple[tuple[str, ...], str]] = {
    "detections": (("detection", "measurement"), "what the sensor reported"),
    "valid": (("detection",), "the slot holds a detection"),
    "interval": ((), "time since the previous scan"),
}


def states_of(motion: Any, size: int) -> dict[str, str]:
    """Names the components of a state, and their units.

    Args:
        motion: A motion model.
        size: D; components that are neither position nor velocity are called by their
            place, such as state4, and have no unit.
    """
    named = {i: (f"state{i}", "") for i in range(size)}
    axes = "xyz"
    for axis, i in zip(axes, motion.position_index, strict=False):
        named[i] = axis, "m"
    for axis, i in zip(axes, motion.velocity_index, strict=False):
        named[i] = f"v{axis}", "m/s"
    return dict(named.values())


def estimates_to_dataset(
    estimates: PyTree, time: Any, states: Mapping[str, str], start: str | None = None
) -> "xarray.Dataset":
    """Labels the estimates of a run, or of R runs.

    Args:
        estimates: Of any tracker with a leading T, or R, T; of their fields those that
            all trackers share are taken (`ESTIMATES`).
        time: Seconds, the end of each scan, [T].
        states: Unit of each component of the state by its name (D), see `states_of`.
        start: The ISO time of second 0 (UTC); makes the times `datetime64[ns]`.

    Returns:
        The dataset.

    Raises:
        ValueError: If names or times do not fit the estimates.
    """
    fields = {name: getattr(estimates, name, None) for name in ESTIMATES}
    return _dataset(fields, ESTIMATES, time, "state", states, start)


def estimates_from_dataset(
    dataset: "xarray.Dataset",
) -> tuple[Estimate, np.ndarray, str | None]:
    """Undoes `estimates_to_dataset`.

    Returns:
        Estimates as NumPy arrays with a leading T, or R, T, None where the dataset
        lacks a field; seconds [T]; and the ISO time of second 0 (the attribute start,
        or the earliest time) if the dataset has a clock's times, else None.

    Raises:
        DataError: If mean, time or a dimension is missing.
    """
    _check(dataset, ("mean", "time"))
    fields = {name: _array(dataset, name, ESTIMATES) for name in ESTIMATES}
    return Estimate(**fields), *_seconds(dataset)


def scans_to_dataset(
    scans: Scan, time: Any, measurements: Mapping[str, str], start: str | None = None
) -> "xarray.Dataset":
    """Labels the scans of a run, or of R runs.

    Args:
        scans: With a leading T, or R, T.
        time: Seconds, the end of each scan, [T].
        measurements: Unit of each measured value by its name (Z).
        start: The ISO time of second 0 (UTC); makes the times `datetime64[ns]`.

    Returns:
        The dataset.

    Raises:
        ValueError: If names or times do not fit the scans.
    """
    return _dataset(scans._asdict(), SCANS, time, "measurement", measurements, start)


def scans_from_dataset(
    dataset: "xarray.Dataset",
) -> tuple[Scan, np.ndarray, str | None]:
    """Undoes `scans_to_dataset`.

    Returns:
        Scans as NumPy arrays with a leading T, or R, T; seconds [T]; and the ISO time
        of second 0, as from `estimates_from_dataset`.

    Raises:
        DataError: If a variable or a dimension is missing.
    """
    _check(dataset, (*SCANS, "time"))
    fields = {name: _array(dataset, name, SCANS) for name in SCANS}
    return Scan(**fields), *_seconds(dataset)


def _dataset(
    fields: Mapping[str, Any],
    known: Mapping[str, tuple[tuple[str, ...], str]],
    time: Any,
    axis: str,
    units: Mapping[str, str],
    start: str | None,
) -> "xarray.Dataset":
    """Puts arrays under their names; the first of them has all dimensions."""
    xarray = import_xarray()
    arrays = {name: np.asarray(x) for name, x in fields.items() if x is not None}
    first = next(iter(known))
    lead = arrays[first].shape[: arrays[first].ndim - len(known[first][0])]
    seconds = np.asarray(time, float)
    if len(lead) not in (1, 2) or seconds.shape != lead[-1:]:
        raise ValueError(
            f"{first} has shape {arrays[first].shape} and time {seconds.shape}; give "
            "arrays with a leading T, or R, T, and times [T]."
        )
    if len(units) != arrays[first].shape[-1]:
        raise ValueError(
            f"{axis} is named {', '.join(units)}, but there are "
            f"{arrays[first].shape[-1]} components; give a name for each."
        )
    dims = ("run", "time")[-len(lead) :]
    columns = {
        name: ((*dims, *known[name][0]), x, {"long_name": known[name][1]})
        for name, x in arrays.items()
    }
    stamps = seconds if start is None else clock.to_stamps(seconds, start)
    clocked = {"long_name": "time"} | ({"units": "s"} if start is None else {})
    coords = {
        "time": ("time", stamps, clocked),
        axis: list(units),
        "unit": (axis, list(units.values())),
    }
    if len(lead) == 2:
        coords["run"] = np.arange(lead[0])
    attributes = {} if start is None else {"start": start}
    result = xarray.Dataset(columns, coords, attributes)
    if "interval" in result:
        result["interval"].attrs["units"] = "s"
    return result


def _array(
    dataset: "xarray.Dataset",
    name: str,
    known: Mapping[str, tuple[tuple[str, ...], str]],
) -> Any:
    """Takes a variable with its dimensions in our order; None if it is not there."""
    if name not in dataset:
        return None
    lead = ("run", "time") if "run" in dataset.dims else ("time",)
    dims = (*lead, *known[name][0])
    variable = dataset[name]
    if set(variable.dims) != set(dims):
        raise DataError(
            f"The variable {name!r} has the dimensions "
            f"{', '.join(map(str, variable.dims))}; rename them to {', '.join(dims)}."
        )
    return variable.transpose(*dims).to_numpy()


def _seconds(dataset: "xarray.Dataset") -> tuple[np.ndarray, str | None]:
    """Reads the times; those of a clock count from the start that the dataset tells."""
    time = dataset["time"].to_numpy()
    if time.dtype.kind != "M":
        return time, None
    return clock.seconds_after(time, dataset.attrs.get("start"))


def _check(dataset: "xarray.Dataset", names: Sequence[str]) -> None:
    """Refuses a dataset that lacks a variable."""
    missing = [name for name in names if name not in dataset.variables]
    if missing:
        has = ", ".join(map(str, dataset.variables)) or "none"
        raise DataError(
            f"The dataset has no variable {missing[0]!r}; it has {has}: rename one."
        )
