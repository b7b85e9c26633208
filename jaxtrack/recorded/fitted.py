"""Settings as numbers that can be learned, and back.

    numbers = fitted.numbers(settings)
    tracker = fitted.tracker(table, settings)       # its Params are such numbers
    result = learn.fit(tracker, numbers, scans)
    better = fitted.settings(settings, result.params)
    pathlib.Path("better.toml").write_text(fitted.toml(better))

Both axes share a number here, as they do in the settings, so that what is found is good
for `jaxtrack track --config better.toml`.

    >>> from jaxtrack.recorded import fitted, reading
    >>> harbour = reading.harbour()
    >>> found = fitted.numbers(harbour)._replace(noise_std=2.5)
    >>> fitted.settings(harbour, found).sensor.noise_std
    2.5
    >>> "noise_std = 2.5" in fitted.toml(fitted.settings(harbour, found))
    True
"""

import json
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxtrack.constraints import Positive, Probability, Simplex
from jaxtrack.data.files import Table
from jaxtrack.recorded import tracking
from jaxtrack.recorded.settings import Mode, Settings, as_dict, known
from jaxtrack.types import Array, PyTree, Scan, Tracker


class Numbers(NamedTuple):
    """What the evidence may know of settings with M modes, of which L are at rest.

    Attributes:
        noise_std: Of the sensor, m, a scalar.
        clutter_rate: Of the sensor, a scalar.
        lifetime: Of targets, s, a scalar.
        birth_rate: Of targets, per second, a scalar.
        noise_density: Of the modes, [M].
        drift_std: Of the modes at rest, m/s, [L].
        detect_prob: Of the modes, [M].
        sojourn: Of the modes, s, [M].
        birth_share: Of the modes, which sum to one, [M].
    """

    noise_std: Positive
    clutter_rate: Positive
    lifetime: Positive
    birth_rate: Positive
    noise_density: Positive
    drift_std: Positive
    detect_prob: Probability
    sojourn: Positive
    birth_share: Simplex


def numbers(settings: Settings) -> Numbers:
    """Takes the numbers out of settings.

    Args:
        settings: None of the numbers open, see `guess.complete`.

    Raises:
        ValueError: One is open.
    """
    modes = list(settings.modes.values())
    share = jnp.array([mode.birth_share for mode in modes], float)

    def each(name: str) -> Array:
        return jnp.array([known(getattr(mode, name)) for mode in modes], float)

    return Numbers(
        noise_std=jnp.array(known(settings.sensor.noise_std), float),
        clutter_rate=jnp.array(settings.sensor.clutter_rate, float),
        lifetime=jnp.array(known(settings.targets.lifetime), float),
        birth_rate=jnp.array(known(settings.targets.birth_rate), float),
        noise_density=each("noise_density"),
        drift_std=jnp.array([known(m.drift_std) for m in modes if m.rest], float),
        detect_prob=each("detect_prob"),
        sojourn=each("sojourn"),
        birth_share=share / share.sum(),
    )


def settings(chosen: Settings, found: Numbers) -> Settings:
    """Puts numbers, as they are found, into settings of the same modes."""
    return _filled(chosen, Numbers(*(np.asarray(x, float).tolist() for x in found)))


def tracker(table: Table, chosen: Settings) -> Tracker:
    """Makes the tracker of `tracking.make`, with `Numbers` for its `Params`.

    Args:
        table: The detections, whose bounding box is where clutter may be.
        chosen: None open, see `guess.complete`.
    """
    inner = tracking.make(table, chosen)[0]

    def params(found: Numbers) -> PyTree:
        return tracking.make(table, _filled(chosen, found))[1]

    def init(found: Numbers, key: Array) -> PyTree:
        return inner.init(params(found), key)

    def step(found: Numbers, state: PyTree, scan: Scan) -> tuple[PyTree, Any]:
        return inner.step(params(found), state, scan)

    return Tracker(init, step)


def toml(chosen: Settings) -> str:
    """Returns settings as text that `reading.parse` reads; what is open is left out."""
    lines = []
    for section, values in as_dict(chosen).items():
        tables = {section: values}
        if section == "modes":
            tables = {f"modes.{_text(key)}": one for key, one in values.items()}
        for name, table in tables.items():
            given = {key: x for key, x in table.items() if x is not None}
            lines += [f"[{name}]", *(f"{key} = {_text(x)}" for key, x in given.items())]
            lines.append("")
    return "\n".join(lines)


def _text(value: Any) -> str:
    """Writes a text, a number or a truth value, which are JSON's in TOML."""
    return json.dumps(value, ensure_ascii=False)


def _filled(chosen: Settings, found: Any) -> Settings:
    """Puts numbers into settings; jax may be tracing them."""
    drift = iter(found.drift_std)

    def filled(place: int, mode: Mode) -> Mode:
        return mode._replace(
            noise_density=found.noise_density[place],
            drift_std=next(drift) if mode.rest else mode.drift_std,
            detect_prob=found.detect_prob[place],
            sojourn=found.sojourn[place],
            birth_share=found.birth_share[place],
        )

    return chosen._replace(
        sensor=chosen.sensor._replace(
            noise_std=found.noise_std, clutter_rate=found.clutter_rate
        ),
        targets=chosen.targets._replace(
            lifetime=found.lifetime, birth_rate=found.birth_rate
        ),
        modes={
            key: filled(place, mode)
            for place, (key, mode) in enumerate(chosen.modes.items())
        },
    )
