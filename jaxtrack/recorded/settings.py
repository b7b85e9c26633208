r"""Settings for recorded data, and how they are read from a file in TOML.

A setting that is None is taken from the data, see `jaxtrack.recorded.guess`.

    >>> from jaxtrack.recorded import settings
    >>> made = settings.parse("[scans]\nperiod = 60\n", "radar.toml")
    >>> made.scans.period, made.sensor.noise_std
    (60.0, None)
"""

import math
import os
import pathlib
import tomllib
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from jaxtrack.data.errors import DataError


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


class Capacity(NamedTuple):
    """The settings of `trackers.cbmember`, which see."""

    max_tracks: int | None = None
    max_births: int | None = None
    max_parents: int = 6
    prune_threshold: float = 1e-3
    report_threshold: float = 0.5
    merge_threshold: float = 4.0
    split_threshold: float = 0.8


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
    tracker: Capacity = Capacity()
    score: Score = Score()


class _Bound(NamedTuple):
    """What a number must be, in words and as a test."""

    words: str
    holds: Callable[[float], bool]


_PROB = _Bound("a probability from 0 to 1", lambda x: 0 <= x <= 1)
_BELOW_ONE = _Bound("a probability from 0 up to 1", lambda x: 0 <= x < 1)
_NOT_NEGATIVE = _Bound("a finite number of 0 or more", lambda x: 0 <= x < math.inf)
_POSITIVE = _Bound("a finite number above 0", lambda x: 0 < x < math.inf)
_COUNT = _Bound("1 or more", lambda x: x >= 1)
_BOUNDS = {
    **dict.fromkeys(("birth_rate", "birth_share", "merge_threshold"), _NOT_NEGATIVE),
    **dict.fromkeys(("detect_prob", "birth_prob"), _PROB),
    **dict.fromkeys(
        ("prune_threshold", "report_threshold", "split_threshold"), _BELOW_ONE
    ),
    **dict.fromkeys(("max_tracks", "max_births", "max_parents"), _COUNT),
    "max_detections": _COUNT,
}
_KINDS = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}


def known(value: float | None) -> float:
    """Returns a setting that is needed now.

    Raises:
        ValueError: If it is None, which `guess.complete` mends.
    """
    if value is None:
        raise ValueError("a needed setting is None; fill it in with guess.complete")
    return value


def load(path: str | os.PathLike[str]) -> Settings:
    """Reads settings from a TOML file.

    Raises:
        DataError: If the file cannot be read, or a setting is unknown or wrong.
    """
    try:
        text = pathlib.Path(path).read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise DataError(f"{path} does not exist; check the file's path.") from error
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise DataError(f"{path} cannot be read ({why}); check the path.") from error
    return parse(text, path)


def text(name: str) -> str:
    """Returns a TOML text that ships with the library.

    Args:
        name: `template`, with every setting explained, which changes none; or
            `harbour`, for the file of `data.files.harbour_path`.
    """
    return pathlib.Path(__file__).with_name(f"{name}.toml").read_text("utf-8")


def harbour() -> Settings:
    """Reads the settings for the file of `data.files.harbour_path`."""
    return parse(text("harbour"), "harbour.toml")


def as_dict(settings: Settings) -> dict[str, Any]:
    """Returns settings as nested dictionaries, laid out as in TOML."""
    made = {
        key: one._asdict() for key, one in settings._asdict().items() if key != "modes"
    }
    return {**made, "modes": {key: m._asdict() for key, m in settings.modes.items()}}


def parse(text: str, name: str | os.PathLike[str] = "settings") -> Settings:
    """Reads settings from a TOML text.

    Args:
        text: The text.
        name: What to call it in messages.

    Raises:
        DataError: If it is not TOML, or a setting is unknown or wrong.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        why = str(error).rstrip(".")
        raise DataError(
            f"{name} is not TOML ({why}); numbers go without units, text in quotes."
        ) from error
    _check_known(name, "section", tables, Settings._fields)
    made: dict[str, Any] = {}
    for section, kind in typing.get_type_hints(Settings).items():
        if section not in tables:
            continue
        values = tables[section]
        if not isinstance(values, dict):
            raise DataError(f"{name}: {section} is no section; write [{section}].")
        if section == "modes":
            made[section] = _read_modes(name, values)
        else:
            made[section] = _read(name, section, kind, values)
    return Settings(**made)


def _read_modes(name: str | os.PathLike[str], values: dict[str, Any]) -> Any:
    """Reads the tables [modes.NAME]."""
    loose = [key for key, value in values.items() if not isinstance(value, dict)]
    if loose or not values:
        what = (
            f"[modes] has {loose[0]!r} without a mode" if loose else "[modes] is empty"
        )
        raise DataError(f"{name}: {what}; write a section [modes.NAME] for each mode.")
    modes = {key: _read(name, f"modes.{key}", Mode, one) for key, one in values.items()}
    if not sum(mode.birth_share for mode in modes.values()) > 0:
        raise DataError(f"{name}: no mode has a birth_share above 0; give one to some.")
    return modes


def _read(
    name: str | os.PathLike[str], section: str, kind: Any, values: dict[str, Any]
) -> Any:
    """Reads one section into its tuple, each value checked."""
    _check_known(name, f"setting in [{section}]", values, kind._fields)
    wanted = typing.get_type_hints(kind)
    checked = {}
    for key, value in values.items():
        options = typing.get_args(wanted[key]) or (wanted[key],)
        type_ = options[0]
        if type_ is float and type(value) is int:
            value = float(value)
        bound = _BOUNDS.get(key, _POSITIVE if type_ in (float, int) else None)
        if type(value) is not type_ or bound and not bound.holds(value):
            right = (
                _KINDS[type_] if type(value) is not type_ or not bound else bound.words
            )
            raise DataError(f"{name}: {key} in [{section}] is {value!r}; give {right}.")
        checked[key] = value
    return kind(**checked)


def _check_known(
    name: str | os.PathLike[str],
    what: str,
    values: Mapping[str, Any],
    known: tuple[str, ...],
) -> None:
    """Refuses a key that there is not."""
    for key in values:
        if key not in known:
            choice = ", ".join(known)
            raise DataError(f"{name}: there is no {what} {key!r}; choose of {choice}.")
