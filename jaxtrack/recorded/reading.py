r"""Settings read from a file in TOML, every value checked.

>>> from jaxtrack.recorded import reading
>>> made = reading.parse("[scans]\nperiod = 60\n", "radar.toml")
>>> made.scans.period, made.sensor.noise_std
(60.0, None)
"""

import math
import os
import pathlib
import tomllib
import typing
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from jaxtrack.data.errors import DataError
from jaxtrack.recorded.settings import ALGORITHMS, Mode, Settings


class _Bound(NamedTuple):
    """What a number must be, in words and as a test."""

    words: str
    holds: Callable[[Any], bool]


_PROB = _Bound("a probability from 0 to 1", lambda x: 0 <= x <= 1)
_BELOW_ONE = _Bound("a probability from 0 up to 1", lambda x: 0 <= x < 1)
_NOT_NEGATIVE = _Bound("a finite number of 0 or more", lambda x: 0 <= x < math.inf)
_POSITIVE = _Bound("a finite number above 0", lambda x: 0 < x < math.inf)
_COUNT = _Bound("1 or more", lambda x: x >= 1)
_WINDOW = _Bound("1 to 32", lambda x: 1 <= x <= 32)
_BOUNDS = {
    **dict.fromkeys(("birth_rate", "birth_share", "merge_threshold"), _NOT_NEGATIVE),
    **dict.fromkeys(
        ("detect_prob", "birth_prob", "confirm_prob", "drop_prob", "start_threshold"),
        _PROB,
    ),
    **dict.fromkeys(
        ("prune_threshold", "report_threshold", "split_threshold", "leaf_threshold"),
        _BELOW_ONE,
    ),
    **dict.fromkeys(
        (
            *("max_tracks", "max_births", "max_parents", "max_detections"),
            "max_hypotheses",
        ),
        _COUNT,
    ),
    "max_leaves": _Bound("2 or more", lambda x: x >= 2),
    **dict.fromkeys(
        ("confirm_hits", "confirm_scans", "drop_misses", "drop_scans"), _WINDOW
    ),
    **dict.fromkeys(("num_scans", "lag"), _Bound("0 or more", lambda x: x >= 0)),
    "gate_prob": _Bound("a probability above 0", lambda x: 0 < x <= 1),
    "name": _Bound(f"one of {', '.join(ALGORITHMS)}", lambda x: x in ALGORITHMS),
}
_KINDS = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}


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
