"""Settings for recorded data.

A setting that is None is taken from the data, see `jaxtrack.recorded.guess`.

    >>> from jaxtrack.recorded import settings
    >>> settings.with_algorithm(settings.Settings(), "jipda").tracker.name
    'jipda'
"""

import types
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

from jaxtrack.data.errors import DataError

ALGORITHMS = (
    *("cbmember", "nearest", "gnn", "pda", "ipda", "jpda", "jipda"),
    *("lmb", "mht", "pmbm", "tpmbm"),
    *("jpda-star", "set-jpda"),  # only for a few targets
)

Number = TypeVar("Number", int, float)


class File(NamedTuple):
    """How the file is read: names of its columns where they are not the usual ones.

    Attributes:
        time, x, y, lat, lon: Names of columns.
        sort: Whether to sort by time; otherwise times that go backwards are an error.
    """

    time: str | None = None
    x: str | None = None
    y: str | None = None
    lat: str | None = None
    lon: str | None = None
    sort: bool = False


class Scans(NamedTuple):
    """How detections become scans.

    Attributes:
        period: Seconds; without it, detections with the same time are a scan.
        max_detections: Slots of a scan; by default the fullest scan's.
    """

    period: float | None = None
    max_detections: int | None = None


class Sensor(NamedTuple):
    """What a detection tells.

    Attributes:
        noise_std: Of a position, on each axis, m.
        clutter_rate: Expected false detections in a scan, over the region seen.
    """

    noise_std: float | None = None
    clutter_rate: float = 1.0


class Targets(NamedTuple):
    """How targets come and go.

    Attributes:
        lifetime: Mean, s.
        birth_rate: Expected new targets in a second.
        birth_prob: No detection is believed more than this to be a new target.
        speed_std: Standard deviation of a new target's velocity on each axis, m/s.
    """

    lifetime: float | None = None
    birth_rate: float | None = None
    birth_prob: float = 0.5
    speed_std: float | None = None


class Mode(NamedTuple):
    """One way of moving, over the state [x, vx, y, vy].

    Attributes:
        rest: Whether the target stands still; if not, its velocity is nearly constant.
        noise_density: Of the acceleration, m^2/s^3; at rest of the walk, m^2/s.
        drift_std: At rest: of the velocity that a target has nevertheless, m/s.
        detect_prob: Probability that a scan detects a target in this mode.
        sojourn: Mean seconds until the mode is left, for any other with equal odds.
        birth_share: Share of the new targets that begin in this mode.
    """

    rest: bool = False
    noise_density: float | None = None
    drift_std: float | None = None
    detect_prob: float = 0.98
    sojourn: float | None = None
    birth_share: float = 1.0


class Algorithm(NamedTuple):
    """Which tracker, and its settings.

    Attributes:
        name: One of `ALGORITHMS`.
        max_tracks, max_births: Capacities of any.
        max_parents, prune_threshold, report_threshold, merge_threshold,
            split_threshold: Of `trackers.cbmember`, which see; prune_threshold and
            report_threshold of `trackers.lmb`, too.
        gate_prob, start_threshold: Of all others, see `trackers.options`.
        confirm_hits, confirm_scans, drop_misses, drop_scans: Of those that count
            detections, see `trackers.management.MofN`.
        confirm_prob, drop_prob: Of those that weigh existence, see
            `trackers.management.Existence`.
        num_scans, max_leaves, leaf_threshold: Of `trackers.mht` and `trackers.tpmbm`,
            which see; the last is their `prune_threshold`.
        max_hypotheses: Of `trackers.pmbm`, which has `max_leaves`, too; there
            `leaf_threshold` is for hypotheses and `prune_threshold` for tracks.
        lag: Of `trackers.tpmbm`.
    """

    name: str = "cbmember"
    max_tracks: int | None = None
    max_births: int | None = None
    max_parents: int = 6
    prune_threshold: float = 1e-3
    report_threshold: float = 0.5
    merge_threshold: float = 4.0
    split_threshold: float = 0.8
    gate_prob: float = 0.999
    start_threshold: float = 0.5
    confirm_hits: int = 3
    confirm_scans: int = 5
    drop_misses: int = 5
    drop_scans: int = 5
    confirm_prob: float = 0.9
    drop_prob: float = 1e-3
    num_scans: int = 2
    max_leaves: int = 6
    leaf_threshold: float = 1e-5
    max_hypotheses: int = 50
    lag: int = 3


class Score(NamedTuple):
    """How tracks are scored against identities in the file.

    Attributes:
        cutoff: Of GOSPA and of what counts as the same place for IDF1, m.
        max_gap: A target is there between two reports unless they are farther apart, s.
    """

    cutoff: float | None = None
    max_gap: float | None = None


class Settings(NamedTuple):
    """All settings; the modes by name, in the order of the tracker's mode axis."""

    file: File = File()
    scans: Scans = Scans()
    sensor: Sensor = Sensor()
    targets: Targets = Targets()
    modes: Mapping[str, Mode] = types.MappingProxyType(
        {"steady": Mode(), "turning": Mode()}
    )
    tracker: Algorithm = Algorithm()
    score: Score = Score()


def known(value: Number | None) -> Number:
    """Returns a setting that is needed now.

    Raises:
        ValueError: If it is None, which `guess.complete` mends.
    """
    if value is None:
        raise ValueError("a needed setting is None; fill it in with guess.complete")
    return value


def check_name(name: str) -> None:
    """Raises a DataError for a tracker that there is not."""
    if name not in ALGORITHMS:
        raise DataError(f"tracker is {name!r}; give one of {', '.join(ALGORITHMS)}.")


def with_algorithm(settings: Settings, name: str) -> Settings:
    """Returns settings with another tracker.

    Raises:
        DataError: If there is no such tracker.
    """
    check_name(name)
    return settings._replace(tracker=settings.tracker._replace(name=name))


def as_dict(settings: Settings) -> dict[str, Any]:
    """Returns settings as nested dictionaries, laid out as in TOML."""
    made = {
        key: one._asdict() for key, one in settings._asdict().items() if key != "modes"
    }
    return {**made, "modes": {key: m._asdict() for key, m in settings.modes.items()}}
