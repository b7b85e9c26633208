"""The parts of a study joined into a dataset, and the dataset summed up in a table.

>>> import numpy as np
>>> from jaxtrack.study import parts, sweep, table
>>> plan = sweep.plan("yuan2013-linear", ["gm-cv-cbmember"], runs=2, seed=0)
>>> part = parts.Part({"ospa": np.array([[1.0] * 50, [3.0] * 50])}, 0.5, 0.0, {})
>>> data = table.dataset(plan, [[part]])
>>> dict(data.ospa.sizes)
{'setting': 1, 'tracker': 1, 'run': 2, 'time': 50}
>>> table.mean_and_error(data.ospa[0, 0])
{'mean': 2.0, 'stderr': 1.0}
"""

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxtrack.study import sweep
from jaxtrack.study.parts import Part

if TYPE_CHECKING:
    import xarray

# Name in words, and unit.
MEANING = {
    "ospa": ("OSPA", "m"),
    "ospa_localisation": ("OSPA, localisation part", "m"),
    "ospa_cardinality": ("OSPA, cardinality part", "m"),
    "gospa": ("GOSPA", "m"),
    "gospa_localisation": ("GOSPA^p, localisation part", ""),
    "gospa_missed": ("GOSPA^p, missed part", ""),
    "gospa_false": ("GOSPA^p, false part", ""),
    "num_true": ("true targets", ""),
    "num_reported": ("reported targets", ""),
    "num_expected": ("expected targets", ""),
    "num_std": ("standard deviation of the number of targets", ""),
    "log_evidence": ("log-evidence of a scan", ""),
    "dropped": ("expected targets dropped", ""),
    "seconds": ("run time", "s"),
    "compile_seconds": ("compile time", "s"),
    "time": ("time", "s"),
}


def dataset(plan: sweep.Plan, done: Sequence[Sequence[Part]]) -> "xarray.Dataset":
    """Joins the parts of a study.

    Args:
        plan: What was to be computed.
        done: For each of its jobs, the parts in the order of runs.

    Returns:
        Scores over setting, tracker, run and time; seconds and compile_seconds over
        setting and tracker. Each setting by itself is a coordinate, too. Where settings
        have scans at other times, time is that of all, and a score is NaN where a
        setting has no scan.
    """
    import xarray

    trackers = plan.trackers
    points = [job.point for job in plan.jobs if job.name == trackers[0]]
    times = [np.asarray(job.values[1].truth.time) for job in plan.jobs]
    every = np.unique(np.concatenate(times))

    def table(values: Sequence[Any]) -> np.ndarray:
        jobs = np.array(values)
        jobs = jobs.reshape(len(trackers), len(points), *jobs.shape[1:])
        return jobs.swapaxes(0, 1)

    def joined(name: str) -> np.ndarray:
        some = [np.concatenate([p.scores[name] for p in x])[: plan.runs] for x in done]
        placed = [_placed(x, own, every) for x, own in zip(some, times, strict=True)]
        return table(placed)

    dims = ("setting", "tracker", "run", "time")
    columns = {name: (dims, joined(name)) for name in done[0][0].scores}
    seconds = table([sum(p.seconds for p in x) for x in done])
    compiling = table([sum(p.compile_seconds for p in x) for x in done])
    columns |= {"seconds": (dims[:2], seconds)}
    columns |= {"compile_seconds": (dims[:2], compiling)}
    coords = {
        "setting": [sweep.label(point) for point in points],
        "tracker": trackers,
        "run": np.arange(plan.runs),
        "time": every,
    }
    swept = {name: ("setting", [p[name] for p in points]) for name in points[0]}
    settings = {name: values for name, (_, values) in swept.items()}
    attributes = {**plan.attributes, "settings": json.dumps(settings)}
    result = xarray.Dataset(columns, {**coords, **swept}, attributes)
    for name in set(result.variables) & set(MEANING):
        long_name, units = MEANING[str(name)]
        result[name].attrs |= {"long_name": long_name, "units": units}
    return result


def _placed(score: np.ndarray, own: np.ndarray, every: np.ndarray) -> np.ndarray:
    """Puts scores [R, T] where their times are among all; NaN elsewhere."""
    if len(own) == len(every):
        return score
    wide = np.full((len(score), len(every)), np.nan)
    wide[:, np.searchsorted(every, own)] = score
    return wide


def mean_and_error(score: "xarray.DataArray") -> dict[str, float | None]:
    """Averages over time, then over runs: the mean and its standard error.

    The error is None for a single run, and both are where a score is not finite.
    """
    per_run = score.mean("time", skipna=False)
    runs = per_run.sizes["run"]
    spread = per_run.std("run", ddof=1, skipna=False) if runs > 1 else math.nan
    mean = per_run.mean("run", skipna=False)
    return {"mean": _number(mean), "stderr": _number(spread / math.sqrt(runs))}


def summary(data: "xarray.Dataset") -> dict[str, Any]:
    """Sums a study up: which it is, and a row for each setting and tracker.

    Biases are reported (or expected) minus true number, averaged over runs and time.
    """
    keys = ("scenario", "seed", "version", "precision")
    named = [n for n, x in data.coords.items() if x.dims == ("setting",)]
    swept = [str(name) for name in named if name != "setting"]
    rows = []
    for setting in data["setting"].values:
        for tracker in data["tracker"].values:
            one = data.sel(setting=setting, tracker=tracker)
            one = one.dropna("time", how="all", subset=["num_true"])
            point = {name: float(one[name]) for name in swept}
            rows.append({"tracker": str(tracker), "setting": point, **_scores(one)})
    known = {key: data.attrs[key] for key in keys if key in data.attrs}
    return {**known, "runs": data.sizes["run"], "rows": rows}


def _scores(one: "xarray.Dataset") -> dict[str, Any]:
    seconds = float(one.seconds)
    surplus = one.num_expected - one.num_true
    return {
        "ospa": mean_and_error(one.ospa),
        "gospa": mean_and_error(one.gospa),
        "cardinality_bias": _number((one.num_reported - one.num_true).mean()),
        "expected_cardinality_bias": _number(surplus.mean(skipna=False)),
        "seconds": seconds,
        "compile_seconds": float(one.compile_seconds),
        "runs_per_second": one.sizes["run"] / max(seconds, 1e-9),
        "dropped": _number(one.dropped.mean(skipna=False)),
    }


def _number(value: Any) -> float | None:
    """Returns a number that JSON can hold."""
    return float(value) if math.isfinite(float(value)) else None
