"""From a table of detections and settings to tracks.

Any tracker of `settings.ALGORITHMS` on a bank of modes (`targets.imm`); by default the
cardinality balanced multi-Bernoulli filter. In scans of a fixed length each detection
keeps the time at which it was taken (`models.sensor.Timed`).

    >>> import numpy as np
    >>> from jaxtrack.data import files
    >>> from jaxtrack.recorded import tracking
    >>> time = np.arange(8.0)
    >>> wobble = np.sin(7 * np.stack([time, time + 1], 1))
    >>> table = files.Table(time, 20 * time[:, None] + wobble, {}, None, None)
    >>> result = tracking.track(table)
    >>> int(result.estimates.exists[-1].sum())
    1
"""

import functools
import inspect
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import engine, models
from jaxtrack.data import scans as grouping
from jaxtrack.data.errors import DataError
from jaxtrack.data.files import Table
from jaxtrack.models.rest import Rest
from jaxtrack.recorded import guess
from jaxtrack.recorded.settings import (
    Algorithm,
    Mode,
    Settings,
    check_name,
    known,
)
from jaxtrack.targets import imm
from jaxtrack.trackers import (
    cbmember,
    gnn,
    jpda,
    jpda_star,
    lmb,
    management,
    mht,
    nearest,
    options,
    pda,
    pmbm,
    set_jpda,
    single_scan,
    tpmbm,
    trajectories,
    undetected,
)
from jaxtrack.types import Target, Tracker

CERTAIN: dict[str, Callable[..., Tracker]] = {
    "nearest": nearest.nearest,
    "gnn": gnn.gnn,
    "pda": pda.pda,
    "jpda": jpda.jpda,
    "jpda-star": jpda_star.jpda_star,
    "set-jpda": set_jpda.set_jpda,
}
INTEGRATED: dict[str, Callable[..., Tracker]] = {"ipda": pda.ipda, "jipda": jpda.jipda}
FAMILIES: dict[str, Any] = {
    "cbmember": cbmember,
    "lmb": undetected,
    "mht": undetected,
    "pmbm": undetected,
    "tpmbm": undetected,
}


class Result(NamedTuple):
    """What came out.

    Attributes:
        estimates: The tracker's `Estimate` with a leading T, of NumPy arrays.
        scans: The T scans.
        settings: The settings, none open.
        motion: A motion model, which says where positions and velocities stand.
        seconds: Run time.
        compile_seconds: Compile time.
    """

    estimates: Any
    scans: grouping.Scans
    settings: Settings
    motion: Any
    seconds: float
    compile_seconds: float


def track(table: Table, settings: Settings | None = None, seed: int = 0) -> Result:
    """Tracks the detections of a table.

    Args:
        table: From `data.files.read_detections`; its further columns are not looked at.
        settings: What is open in them is taken from the data; by default everything.
        seed: Of the tracker's key.

    Returns:
        Tracks, and what they were made with.

    Raises:
        DataError: If the detections are too few, or settings do not fit them.
    """
    if len(table.time) < 2:
        raise DataError(
            "There is only one detection; a track needs at least two, at two times."
        )
    scans = group(table, settings or Settings())
    if len(scans.time) < 2:
        raise DataError(
            "All detections are in one scan; a track needs at least two scans, so set "
            "a smaller period in [scans]."
        )
    settings = guess.complete(settings or Settings(), scans)
    tracker, params = make(table, settings)
    # NumPy's float64 becomes jax's float here, whichever that is.
    scan = jax.tree.map(lambda x: jnp.asarray(x, _dtype(x)), scans.scan)
    began = time.perf_counter()
    program = run.lower(tracker, params, scan, jax.random.key(seed)).compile()
    compiled = time.perf_counter()
    estimates = jax.block_until_ready(program(params, scan, jax.random.key(seed)))
    seconds = time.perf_counter() - compiled
    return Result(
        estimates=jax.tree.map(np.asarray, estimates),
        scans=scans,
        settings=settings,
        motion=params.target.layout,
        seconds=seconds,
        compile_seconds=compiled - began,
    )


def smoothed(result: Result) -> Result | None:
    """Returns what is known afterwards, or None where a tracker does not tell.

    Args:
        result: From `track`.

    Returns:
        The same with `trajectories.Latest` for estimates: the whole trajectories, of
        which the last scans are as uncertain as they were.
    """
    paths = getattr(result.estimates, "paths", None)
    if paths is None:
        return None
    latest = jax.jit(trajectories.latest)(paths)
    return result._replace(estimates=jax.tree.map(np.asarray, latest))


def group(table: Table, settings: Settings) -> grouping.Scans:
    """Groups a table into scans; those of a fixed length keep the detections' ages."""
    period, size = settings.scans
    timed = period is not None
    return grouping.group_scans(table.time, table.xy, period, size, ages=timed)


def make(table: Table, settings: Settings) -> tuple[Tracker, Any]:
    """Makes the tracker and its parameters.

    Args:
        table: The detections, whose bounding box is where clutter may be.
        settings: None open, see `guess.complete`.
    """
    modes = list(settings.modes.values())
    two = jnp.ones(2)
    noise = known(settings.sensor.noise_std)
    sensor: Any = models.sensor.Position(noise * two)
    if settings.scans.period is not None:
        sensor = models.sensor.Timed(sensor)
    targets = settings.targets
    share = jnp.array([mode.birth_share for mode in modes], float)
    family = FAMILIES.get(settings.tracker.name, single_scan)
    params = family.Params(
        target=imm.Params(
            motions=tuple(_motion(mode) for mode in modes),
            switching=_switching(modes),
            sensor=sensor,
            survive=models.probability.Lifetime(jnp.array(targets.lifetime, float)),
            detect=models.probability.PerMode(
                jnp.array([mode.detect_prob for mode in modes], float)
            ),
        ),
        birth=models.birth.DetectionBirth(
            rate=jnp.array(targets.birth_rate, float),
            max_existence_prob=jnp.array(targets.birth_prob, float),
            velocity_std=known(targets.speed_std) * two,
            extra_std=jnp.zeros(0),
            mode_prob=share / share.sum(),
        ),
        clutter=models.clutter.UniformClutter(
            rate=jnp.array(settings.sensor.clutter_rate, float),
            low=jnp.asarray(table.xy.min(0) - 10 * noise, float),
            high=jnp.asarray(table.xy.max(0) + 10 * noise, float),
        ),
    )
    return algorithm(settings.tracker, imm.imm()), params


def algorithm(chosen: Algorithm, target: Target) -> Tracker:
    """Makes the tracker that the settings name."""
    check_name(chosen.name)
    if chosen.name == "cbmember":
        given = chosen._asdict()
        own = inspect.signature(cbmember.cbmember).parameters
        return cbmember.cbmember(
            target, **{name: given[name] for name in own if name in given}
        )
    if FAMILIES.get(chosen.name) is undetected:
        return _follower(chosen, target)
    choices = options.Options(
        max_tracks=known(chosen.max_tracks),
        max_births=known(chosen.max_births),
        gate_prob=chosen.gate_prob,
        start_threshold=chosen.start_threshold,
    )
    if chosen.name in INTEGRATED:
        choices["rule"] = management.Existence(chosen.confirm_prob, chosen.drop_prob)
        return INTEGRATED[chosen.name](target, **choices)
    choices["rule"] = management.MofN(
        chosen.confirm_hits,
        chosen.confirm_scans,
        chosen.drop_misses,
        chosen.drop_scans,
    )
    return CERTAIN[chosen.name](target, **choices)


def _follower(chosen: Algorithm, target: Target) -> Tracker:
    """Makes one of those that follow hypotheses, or the labels of targets alone."""
    if chosen.name == "lmb":
        return lmb.lmb(
            target,
            max_tracks=known(chosen.max_tracks),
            max_births=known(chosen.max_births),
            gate_prob=chosen.gate_prob,
            exist_threshold=chosen.prune_threshold,
            estimator="heaviest",
            report_threshold=chosen.report_threshold,
        )
    if chosen.name in ("mht", "tpmbm"):
        multiscan: dict[str, Any] = {
            "num_scans": chosen.num_scans,
            "max_hypotheses": 8,
            "max_tracks": known(chosen.max_tracks),
            "max_leaves": chosen.max_leaves,
            "gate_prob": chosen.gate_prob,
            "prune_threshold": chosen.leaf_threshold,
            "report_threshold": chosen.report_threshold,
        }
        if chosen.name == "mht":
            return mht.mht(target, **multiscan)
        return tpmbm.tpmbm(target, lag=chosen.lag, **multiscan)
    return pmbm.pmbm(
        target,
        max_hypotheses=chosen.max_hypotheses,
        max_tracks=known(chosen.max_tracks),
        max_leaves=chosen.max_leaves,
        gate_prob=chosen.gate_prob,
        prune_threshold=chosen.leaf_threshold,
        exist_threshold=chosen.prune_threshold,
        report_threshold=chosen.report_threshold,
    )


run = functools.partial(jax.jit, static_argnums=0)(engine.run)


def _motion(mode: Mode) -> Any:
    """Makes a mode's motion model."""
    two = jnp.ones(2)
    if mode.rest:
        return Rest(known(mode.noise_density) * two, known(mode.drift_std) * two)
    return models.motion.ConstantVelocity(known(mode.noise_density) * two)


def _switching(modes: list[Mode]) -> models.switching.SojournSwitching:
    """Lets each mode be left for any other with equal odds."""
    num = len(modes)
    odds = (np.ones((num, num)) - np.eye(num)) / max(num - 1, 1)
    sojourn = jnp.array([mode.sojourn for mode in modes], float)
    return models.switching.SojournSwitching(sojourn, jnp.asarray(odds, float))


def _dtype(array: np.ndarray) -> Any:
    return float if np.issubdtype(array.dtype, np.floating) else array.dtype
