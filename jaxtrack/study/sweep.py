"""What a study is to compute: which scenario, at which settings, in which chunks.

A point of a sweep is one combination of settings, keyword arguments of the scenario's
maker by name.

    >>> from jaxtrack.study import sweep
    >>> sweep.points({"clutter_rate": [20, 60], "detect_prob": [0.9]})[1]
    {'clutter_rate': 60.0, 'detect_prob': 0.9}
    >>> sweep.published("yuan2013-linear", {"clutter_rate": 60.0}, "gm-mm-cbmember")
    34.1
"""

import importlib
import inspect
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax

from jaxtrack import scenarios
from jaxtrack.scenarios.world import Maker, Scenario
from jaxtrack.types import PyTree, Tracker

# A compiled call works on so many runs, if the user does not say. There are few sizes,
# so that studies of any length find their programs in the compilation cache.
CHUNKS = (50, 25, 10)
MAX_DETECTIONS = 100_000  # a typing error would eat all memory

# The end or the beginning of a setting's name tells what its value may be.
BOUNDS: tuple[tuple[str, str, Callable[[float], bool]], ...] = (
    ("_prob", "a probability from 0 to 1", lambda x: 0 <= x <= 1),
    ("clutter_rate", "0 or more", lambda x: x >= 0),
    ("max_", "at least 1", lambda x: x >= 1),
    ("interval", "more than 0", lambda x: x > 0),
    ("_threshold", "0 or more", lambda x: x >= 0),
)


class Job(NamedTuple):
    """One tracker at one point of a sweep.

    Attributes:
        point: Settings by name.
        name: Of the tracker.
        tracker: The tracker itself.
        values: Its params, the world, and cutoff and order of the metrics.
    """

    point: dict[str, float]
    name: str
    tracker: Tracker
    values: tuple[PyTree, ...]


class Plan(NamedTuple):
    """All that is to be computed.

    Attributes:
        jobs: All points for the first tracker, then for the next.
        trackers: Their names.
        runs: R.
        chunks: Ranges of runs, see `chunks`.
        max_detections: Slots of a scan that serve every point.
        attributes: What tells this study from others.
    """

    jobs: list[Job]
    trackers: list[str]
    runs: int
    chunks: list[range]
    max_detections: int
    attributes: dict[str, Any]


def plan(
    scenario: str | Maker,
    trackers: Sequence[str],
    runs: int,
    seed: int,
    settings: Mapping[str, Sequence[float]] | None = None,
    chunk: int | None = None,
) -> Plan:
    """Checks what a study is to compute, and lays it out; see `engine.monte_carlo`.

    Raises:
        ValueError: A name or a value that makes no sense.
    """
    if not 0 <= seed < 2**32:
        raise ValueError(f"seed is {seed}; give a whole number from 0 up to 2^32")
    ranges, grid = chunks(runs, chunk), points(settings)
    made = [make(scenario, point) for point in grid]
    check_trackers(made[0], trackers)
    jobs = [
        Job(point, name, tracker, (params, one.world, one.cutoff, one.order))
        for name in trackers
        for point, one in zip(grid, made, strict=True)
        for tracker, params in [one.trackers[name]]
    ]
    max_detections = max(one.max_detections for one in made)
    if max_detections > MAX_DETECTIONS:
        raise ValueError(
            f"a scan would hold {max_detections} detections, more than "
            f"{MAX_DETECTIONS}; lower the clutter"
        )
    attributes = {
        "scenario": made[0].name,
        "seed": seed,
        "version": importlib.import_module("jaxtrack").__version__,
        "precision": 64 if jax.config.read("jax_enable_x64") else 32,
        "chunk": len(ranges[0]),
        "max_detections": max_detections,
    }
    return Plan(jobs, list(trackers), runs, ranges, max_detections, attributes)


def points(settings: Mapping[str, Sequence[float]] | None) -> list[dict[str, float]]:
    """Lists every combination of the values of the settings, the last one fastest.

    Without settings there is one point, which sets nothing.

    Raises:
        ValueError: A setting has no values, or one twice.
    """
    swept = (settings or {}).items()
    values = {name: [float(x) for x in several] for name, several in swept}
    for name, several in values.items():
        if not several:
            raise ValueError(f"{name} has no values; give at least one")
        _check_distinct(name, several)
    grid = itertools.product(*values.values())
    return [dict(zip(values, point, strict=True)) for point in grid]


def label(point: Mapping[str, float]) -> str:
    """Returns a point as text, 'default' where nothing is set."""
    return (
        ", ".join(f"{name}={value:.12g}" for name, value in point.items()) or "default"
    )


def chunks(runs: int, size: int | None = None) -> list[range]:
    """Splits runs into ranges of one length, the last of which may go beyond them.

    Args:
        runs: How many runs.
        size: Length of a range; without it, that of `CHUNKS` which wastes least.

    Example:
        >>> chunks(runs=18)
        [range(0, 10), range(10, 20)]
        >>> chunks(runs=5, size=3)
        [range(0, 3), range(3, 6)]
    """
    for name, value in {"runs": runs, "chunk": size}.items():
        if value is not None and value < 1:
            raise ValueError(f"{name} is {value}; give at least 1")
    size = size or min(CHUNKS, key=lambda each: -runs % each)
    return [range(first, first + size) for first in range(0, runs, size)]


def make(scenario: str | Maker, point: Mapping[str, float]) -> Scenario:
    """Makes a scenario at one point of a sweep.

    Args:
        scenario: Its name, or a function that makes it.
        point: Settings by name; a value that the maker wants whole is made so.

    Raises:
        ValueError: An unknown name, or a value that makes no sense.
    """
    known = parameters(scenario)
    values = {
        name: _checked(name, value, known[name]) if name in known else value
        for name, value in point.items()
    }
    if isinstance(scenario, str):
        return scenarios.make(scenario, **values)
    for name in values:
        if name not in known:
            raise ValueError(f"no setting is called {name!r}; there are {_list(known)}")
    return scenario(**values)


def parameters(scenario: str | Maker) -> Mapping[str, inspect.Parameter]:
    """Returns what may be set in a scenario; nothing for an unknown name."""
    if isinstance(scenario, str):
        if scenario not in scenarios.MAKERS:
            return {}
        scenario = scenarios.MAKERS[scenario]
    return inspect.signature(scenario).parameters


def check_trackers(scenario: Scenario, names: Sequence[str]) -> None:
    """Raises a ValueError unless there are names, each a tracker of the scenario."""
    there = _list(scenario.trackers)
    if not names:
        raise ValueError(f"no tracker is named; {scenario.name} has {there}")
    for name in names:
        if name not in scenario.trackers:
            raise ValueError(f"{scenario.name} has no tracker {name!r}; it has {there}")
    _check_distinct("the list of trackers", names)


def published(
    scenario: str | Maker, point: Mapping[str, float], tracker: str
) -> float | None:
    """Returns the OSPA that the paper prints for a tracker at a point, metres.

    Papers sweep the clutter rate. If anything else is not as the maker has it, or the
    paper does not say, the answer is None.
    """
    defaults = {name: x.default for name, x in parameters(scenario).items()}
    wanted = {**defaults, **point}
    rate = wanted.pop("clutter_rate", None)
    if rate is None or any(defaults[name] != value for name, value in wanted.items()):
        return None
    return make(scenario, point).published.get(tracker, {}).get(rate)


def _checked(name: str, value: float, parameter: inspect.Parameter) -> float:
    """Returns the value, whole if the maker wants it so."""
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}; give a finite number")
    for part, bounds, holds in BOUNDS:
        if part in name and not holds(value):
            raise ValueError(f"{name} is {value:.12g}; give {bounds}")
    if parameter.annotation is not int:
        return value
    if value != int(value):
        raise ValueError(f"{name} is {value:.12g}; give a whole number")
    return int(value)


def _check_distinct(what: str, items: Sequence[Any]) -> None:
    for item in items:
        if items.count(item) > 1:
            raise ValueError(f"{what} has {item} twice; give it once")


def _list(names: Iterable[str]) -> str:
    return ", ".join(sorted(names))
