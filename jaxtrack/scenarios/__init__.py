"""Published experiments, one file each: what is compared, and against which numbers.

>>> from jaxtrack import scenarios
>>> print(scenarios.make("yuan2013-linear", clutter_rate=60.0).summary)
four maneuvering targets, position sensor (Yuan 2013, section 6.2)
"""

import inspect
from typing import Any

from jaxtrack.scenarios import (
    crossing_many,
    gomes_crossing,
    manoeuvre_digraph,
    parallel_pair,
    turning_aircraft,
    two_sensors,
    williams_crossing,
    xia2019_coalescing,
    xia2019_spread,
    yuan2013_linear,
    yuan2013_range_bearing,
)
from jaxtrack.scenarios.world import Maker, Scenario

MAKERS: dict[str, Maker] = {
    "crossing-many": crossing_many.make,
    "parallel-pair": parallel_pair.make,
    "gomes-crossing": gomes_crossing.make,
    "manoeuvre-digraph": manoeuvre_digraph.make,
    "turning-aircraft": turning_aircraft.make,
    "two-sensors": two_sensors.make,
    "williams-crossing": williams_crossing.make,
    "xia2019-coalescing": xia2019_coalescing.make,
    "xia2019-spread": xia2019_spread.make,
    "yuan2013-linear": yuan2013_linear.make,
    "yuan2013-range-bearing": yuan2013_range_bearing.make,
}


def make(name: str, **settings: Any) -> Scenario:
    """Makes a scenario by its name.

    Args:
        name: One of `MAKERS`.
        **settings: Keyword arguments of its maker, e.g. clutter_rate=60.0.

    Returns:
        The scenario.

    Raises:
        ValueError: Unknown name or setting.
    """
    if name not in MAKERS:
        raise ValueError(f"no scenario is called {name!r}; there are {_list(MAKERS)}")
    known = inspect.signature(MAKERS[name]).parameters
    for setting in settings:
        if setting not in known:
            raise ValueError(
                f"{name} has no setting {setting!r}; it has {_list(known)}"
            )
    return MAKERS[name](**settings)


def _list(names: Any) -> str:
    return ", ".join(sorted(names))
