"""Small trackers in which, all together, every model of the library has its place.

Three scans of up to three detections, of two targets that are born near two places.
"""

import functools
import importlib
import inspect
import pkgutil
import typing
from typing import Any, NamedTuple

import numpy as np
from cases.trackers import array, value
from reference import models as plain

from jaxtrack import models
from jaxtrack.models import (
    acceleration,
    birth,
    clutter,
    converted,
    motion,
    pairs,
    probability,
    rest,
    sensor,
    switching,
    turn,
)
from jaxtrack.targets import imm, single
from jaxtrack.trackers import cbmember, jpda, single_scan
from jaxtrack.types import Array, Scan

SIZES = {"max_tracks": 3, "max_births": 2, "max_parents": 2, "prune_threshold": 1e-4}
STATION, HEADING = array(5.0, -4.0), value(0.3)


class Case(NamedTuple):
    """A target and what its tracker is given."""

    target: Any
    params: Any
    scans: Scan
    maker: Any = functools.partial(cbmember.cbmember, **SIZES)


def scans_of(rows):
    """Three scans of two detections and a third; the first lacks the second."""
    return Scan(
        detections=np.array(rows),
        valid=np.array([[True, False, False], [True, True, True], [True, True, False]]),
        interval=array(1.0, 0.8, 1.3),
    )


def born(state, spread, modes):
    """Two places of birth, at a state and near it."""
    mean = np.stack([state, np.array(state) + 0.7 * np.sqrt(spread)])
    cov = np.diag(spread) + 0.1 * np.sqrt(np.outer(spread, spread))
    modes = np.array([modes, modes[::-1]])
    return mean, np.stack([cov, 1.3 * cov]), modes


def straight_case():
    """Linear motions on a line, seen a while before the end of each scan."""
    target = imm.Params(
        motions=(
            motion.ConstantVelocity(array(0.5)),
            motion.OrnsteinUhlenbeck(array(20.0), array(6.0)),
            rest.Rest(array(0.3), array(0.4)),
            motion.PiecewiseAcceleration(
                motion.ConstantVelocity(array(0.2)), array(0.5)
            ),
        ),
        switching=switching.MarkovSwitching(0.6 * np.eye(4) + np.tile([0.1], (4, 4))),
        sensor=sensor.Timed(sensor.Position(array(1.2))),
        survive=probability.Lifetime(value(40.0)),
        detect=probability.PerMode(array(0.9, 0.8, 0.7, 0.6)),
    )
    births = birth.PoissonBirth(
        array(0.2, 0.1), *born([-20.0, 2.0], [9.0, 4.0], [0.4, 0.3, 0.2, 0.1])
    )
    falls = clutter.UniformClutter(value(1.5), array(-50.0), array(50.0))
    rows = [
        [[-18.0, 0.3], [0.0, 0.0], [0.0, 0.0]],
        [[-16.5, 0.1], [-20.3, 0.6], [9.0, 0.2]],
        [[-14.0, 0.0], [-19.8, 0.5], [0.0, 0.0]],
    ]
    return Case(imm.imm(), cbmember.Params(target, births, falls), scans_of(rows))


def accelerating_case():
    """Accelerations on a line, born where detections were unexplained."""
    target = imm.Params(
        motions=(
            acceleration.KnownAcceleration(
                motion.ConstantAcceleration(array(0.5)), array(0.7)
            ),
            motion.Singer(array(2.0), array(5.0)),
        ),
        switching=switching.SojournSwitching(
            array(9.0, 6.0), np.array([[0.0, 1.0], [1.0, 0.0]])
        ),
        sensor=sensor.Position(array(1.2)),
        survive=probability.Constant(value(0.97)),
        detect=probability.PerMode(array(0.9, 0.75)),
    )
    # With one detection the limit binds, with three the rate does.
    births = birth.DetectionBirth(
        rate=value(0.4),
        max_existence_prob=value(0.25),
        velocity_std=array(3.0),
        extra_std=array(1.0),
        mode_prob=array(0.6, 0.4),
    )
    falls = clutter.UniformClutter(value(1.5), array(-50.0), array(50.0))
    rows = [[[-18.0], [0.0], [0.0]], [[-16.5], [3.0], [9.0]], [[-13.0], [4.0], [0.0]]]
    return Case(imm.imm(), cbmember.Params(target, births, falls), scans_of(rows))


def places(num_axes):
    """Two targets for three scans, [3, 3, P]; and clutter."""
    start = np.array([[100.0, 80.0, 40.0], [103.0, 84.0, 43.0], [60.0, 120.0, 30.0]])
    speed = np.array([[3.0, -2.0, 1.0], [-2.0, 4.0, 0.5], [0.0, 0.0, 0.0]])
    times = np.array([1.0, 1.8, 3.1])[:, None, None]
    return (start + times * speed)[..., :num_axes], speed[:, :num_axes]


def polar_rows(noise):
    """Ranges and bearings of `places`, each off by a share of its noise."""
    rng = np.random.default_rng(0)
    rows = [[plain.polar(p, STATION, HEADING) for p in row] for row in places(2)[0]]
    return np.array(rows) + 0.5 * noise * rng.normal(size=(3, 3, 2))


def turning_case():
    """Turns in the plane within a field of view, seen in range and bearing."""
    noise = array(2.0, 0.01)
    target = imm.Params(
        motions=(
            turn.ForgottenTurn(
                turn.CoordinatedTurn(value(0.05), value(0.4)), value(0.15)
            ),
            turn.TurnRate(value(0.6), value(1e-2)),
        ),
        switching=switching.MarkovSwitching(np.array([[0.85, 0.15], [0.3, 0.7]])),
        sensor=sensor.RangeBearing(noise, STATION, HEADING),
        survive=probability.PerMode(array(0.98, 0.9)),
        detect=probability.InsideDisc(
            value(0.95), array(3.0, -2.0), value(150.0), value(30.0)
        ),
    )
    births = birth.MultiBernoulliBirth(
        array(0.2, 0.1),
        *born([100.0, 3.0, 80.0, -2.0, 0.1], [25.0, 4.0, 36.0, 9.0, 0.02], [0.7, 0.3]),
    )
    box = array(-200.0, -200.0), array(200.0, 200.0)
    falls = clutter.PolarClutter(value(1.5), *box, STATION, HEADING)
    return Case(
        imm.imm(), cbmember.Params(target, births, falls), scans_of(polar_rows(noise))
    )


def sensor_case(seen, rows, low, high, num_axes=2):
    """A target of constant velocity before any sensor."""
    target = single.Params(
        motion=motion.ConstantVelocity(array(0.5, 0.8, 0.6)[:num_axes]),
        sensor=seen,
        survive=probability.Constant(value(0.97)),
        detect=probability.Constant(value(0.9)),
    )
    state = [100.0, 3.0, 80.0, -2.0, 40.0, 1.0][: 2 * num_axes]
    spread = [25.0, 4.0, 36.0, 9.0, 16.0, 5.0][: 2 * num_axes]
    births = birth.MultiBernoulliBirth(array(0.2, 0.1), *born(state, spread, [1.0]))
    falls = clutter.UniformClutter(value(1.5), array(*low), array(*high))
    return Case(single.single(), cbmember.Params(target, births, falls), scans_of(rows))


def range_rate_case():
    noise = array(2.0, 0.01, 0.5)
    where, speed = places(2)
    away = where - STATION
    rate = (away * speed).sum(-1) / np.linalg.norm(away, axis=-1)
    rows = np.concatenate([polar_rows(noise[:2]), rate[..., None] + 0.2], -1)
    seen = sensor.RangeBearingRate(noise, STATION, HEADING)
    return sensor_case(seen, rows, (10.0, -3.1, -20.0), (300.0, 3.1, 20.0))


def bearing_case():
    noise = array(0.02)
    rows = polar_rows(array(1.0, 0.02))[..., 1:]
    bearings = sensor.BearingOnly(noise, STATION, HEADING)
    return sensor_case(sensor.Delayed(bearings, value(0.4)), rows, (-3.1,), (3.1,))


def converted_case():
    """A radar's detections in the plane."""
    noise = array(2.0, 0.02)
    rows = places(2)[0] + 0.5 * noise[0] * np.random.default_rng(0).normal(
        size=(3, 3, 2)
    )
    seen = converted.ConvertedRangeBearing(noise, STATION)
    return sensor_case(seen, rows, (-200.0, -200.0), (300.0, 300.0))


def correlated_case():
    noise = np.array([[4.0, 1.0], [1.0, 3.0]])
    rows = places(2)[0] + 0.5 * np.random.default_rng(0).normal(size=(3, 3, 2))
    seen = converted.CorrelatedPosition(noise)
    return sensor_case(seen, rows, (-200.0, -200.0), (300.0, 300.0))


def spatial_case():
    noise, station = array(0.02, 0.01, 2.0), array(5.0, -4.0, 2.0)
    rows = [[plain.spherical(p, station, HEADING) for p in row] for row in places(3)[0]]
    rows = np.array(rows) + 0.5 * noise
    seen = sensor.AzimuthElevationRange(noise, station, HEADING)
    return sensor_case(seen, rows, (-3.1, -1.5, 10.0), (3.1, 1.5, 300.0), num_axes=3)


def paired_case():
    """Tracks born of two points, one of them near a target that explains it in part."""
    kind = motion.ConstantAcceleration
    target = imm.Params(
        motions=(kind(array(0.5)), kind(array(2.0))),
        switching=switching.MarkovSwitching(np.array([[0.85, 0.15], [0.3, 0.7]])),
        sensor=sensor.Position(array(1.2)),
        survive=probability.Constant(value(0.97)),
        detect=probability.Constant(value(0.8)),
    )
    # Of the likelier birth the limit binds, of the other the rate does.
    births = pairs.PairBirth(
        rate=value(0.6),
        max_existence_prob=value(0.25),
        max_speed=value(9.0),
        extra_std=array(1.0),
        mode_prob=array(0.6, 0.4),
    )
    falls = clutter.UniformClutter(value(1.5), array(-50.0), array(50.0))
    start = birth.MultiBernoulliBirth(
        array(0.5),
        *(x[:1] for x in born([-19.0, 2.0, 0.1], [9.0, 4.0, 1.0], [0.7, 0.3])),
    )
    rows = [[[-18.0], [6.0], [0.0]], [[-16.5], [3.0], [40.0]], [[-13.0], [1.0], [0.0]]]
    scans = scans_of(rows)._replace(
        valid=np.array([[True, True, False], [True, True, True], [True, True, False]])
    )
    params = single_scan.Params(target, births, falls, start)
    maker = functools.partial(
        jpda.jipda, max_tracks=3, max_births=3, gate_prob=1.0, start_threshold=0.0
    )
    return Case(imm.imm(), params, scans, maker)


CASES = {
    "paired": paired_case,
    "straight": straight_case,
    "accelerating": accelerating_case,
    "turning": turning_case,
    "range rate": range_rate_case,
    "bearing": bearing_case,
    "converted": converted_case,
    "correlated": correlated_case,
    "spatial": spatial_case,
}


@functools.cache
def case_of(name):
    return CASES[name]()


def fields(tree, name=""):
    """Yields (class and field, array) for each array of a tuple of models, in order."""
    if hasattr(tree, "_fields"):
        for field, part in zip(tree._fields, tree, strict=True):
            yield from fields(part, f"{type(tree).__name__}.{field}")
    elif isinstance(tree, tuple):
        for part in tree:
            yield from fields(part, name)
    else:
        yield name, tree


def every_field():
    """All fields that hold numbers, of all the models of the library."""
    found = set()
    for info in pkgutil.iter_modules(models.__path__, f"{models.__name__}."):
        module = importlib.import_module(info.name)
        for name, model in inspect.getmembers(module, inspect.isclass):
            if model.__module__ == info.name and hasattr(model, "_fields"):
                found |= {
                    f"{name}.{field}"
                    for field, kind in typing.get_type_hints(model).items()
                    if kind is Array
                }
    return found
