"""What the data themselves say about the settings that the user left open.

Detections that are each other's nearest in three scans in a row are taken for one
target. How far the middle one is from the line between the others tells the noise, and
how far they went tells the speed. Both are medians or quantiles, so that some wrong
triples do no harm. With v the speed's standard deviation and t the median interval:

| setting                | guess                                                   |
|------------------------|---------------------------------------------------------|
| noise_std              | from the residuals of the triples                       |
| speed_std              | v, from the 90 % quantile of the triples' speeds        |
| noise_density          | v^2 / (500 t) in the first mode to v^2 / (5 t) the last |
| at rest                | noise_std^2 / (500 t); drift_std is noise_std / (2 t)   |
| lifetime, sojourn      | 10 t, 20 t                                              |
| birth_rate             | 5 % of a median scan's detections, in each interval     |
| max_tracks, max_births | 4 times and once the fullest scan's detections, plus 10 |
| cutoff, max_gap        | 20 noise_std, 5 t                                       |

    >>> import numpy as np
    >>> from jaxtrack.data import scans
    >>> from jaxtrack.recorded import guess
    >>> time = np.arange(9.0)
    >>> table = scans.group_scans(time, np.stack([3 * time, 4 * time], 1))
    >>> print(guess.motion(table))
    Motion(noise_std=0.0, speed=5.0)
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from jaxtrack.data.errors import DataError
from jaxtrack.data.scans import Scans
from jaxtrack.recorded.settings import Mode, Settings

MEDIAN = 1.1774  # of the length of a normal vector in the plane with deviations of 1
QUANTILE = 2.1460  # its 90 % quantile
LEAST_TRIPLES = 5  # fewer tell nothing


class Motion(NamedTuple):
    """What triples tell: the noise of an axis (m), and a high speed (m/s)."""

    noise_std: float
    speed: float


def motion(scans: Scans) -> Motion | None:
    """Measures noise and speed from detections that are nearest to each other.

    Args:
        scans: T scans of positions, with or without ages.

    Returns:
        Them, or None where too few detections follow each other.
    """
    places = [z[v][:, :2] for z, v in zip(*scans.scan[:2], strict=True)]
    ages = [
        z[v][:, 2] if z.shape[1] > 2 else np.zeros(v.sum())
        for z, v in zip(*scans.scan[:2], strict=True)
    ]
    times = [end - age for end, age in zip(scans.time, ages, strict=True)]
    residuals, speeds = [np.zeros(0)], [np.zeros(0)]
    pairs = [_mutual(*pair) for pair in zip(places, places[1:], strict=False)]
    for t in range(len(pairs) - 1):
        before = dict(zip(pairs[t][1].tolist(), pairs[t][0].tolist(), strict=True))
        middle = [i for i in pairs[t + 1][0].tolist() if i in before]
        after = dict(
            zip(pairs[t + 1][0].tolist(), pairs[t + 1][1].tolist(), strict=True)
        )
        first, last = [before[i] for i in middle], [after[i] for i in middle]
        a, b, c = places[t][first], places[t + 1][middle], places[t + 2][last]
        whole = times[t + 2][last] - times[t][first]
        share = (times[t + 1][middle] - times[t][first]) / whole
        off = b - a * (1 - share)[:, None] - c * share[:, None]
        scale = np.sqrt(1 + share**2 + (1 - share) ** 2)
        residuals.append(np.hypot(*off.T) / scale)
        speeds.append(np.hypot(*(c - a).T) / whole)
    residual, speed = np.concatenate(residuals), np.concatenate(speeds)
    if len(residual) < LEAST_TRIPLES:
        return None
    return Motion(float(np.median(residual)) / MEDIAN, float(np.quantile(speed, 0.9)))


def complete(settings: Settings, scans: Scans) -> Settings:
    """Fills in what is open in the settings.

    Args:
        settings: Some of them None.
        scans: The scans that were made with them.

    Returns:
        Settings that the tracker can be made of; only names of columns, the period and
        max_detections may be None.

    Raises:
        DataError: If noise or speed are open, and the data do not tell them.
    """
    targets, sensor = settings.targets, settings.sensor
    interval = float(np.median(scans.scan.interval))
    speed, noise = targets.speed_std, sensor.noise_std
    if speed is None or noise is None:
        seen = motion(scans)
        if seen is None:
            raise DataError(
                "Too few detections follow each other to guess the noise and the speed "
                "from them; set noise_std in [sensor] and speed_std in [targets]."
            )
        # Detections at one place exactly would leave no room for the next one.
        least = 1e-3 * max(seen.speed * interval, 1e-3)
        noise = max(seen.noise_std, least) if noise is None else noise
        speed = max(seen.speed, noise / interval) / QUANTILE if speed is None else speed
    count = scans.scan.valid.sum(1)
    births = 0.05 * max(float(np.median(count)), 1.0) / interval
    tracker, score = settings.tracker, settings.score
    most = int(count.max())
    return settings._replace(
        sensor=sensor._replace(noise_std=noise),
        targets=targets._replace(
            speed_std=speed,
            lifetime=targets.lifetime or 10 * interval,
            birth_rate=births if targets.birth_rate is None else targets.birth_rate,
        ),
        modes=_modes(settings, noise, speed, interval),
        tracker=tracker._replace(
            max_tracks=tracker.max_tracks or 4 * most + 10,
            max_births=tracker.max_births or most + 10,
        ),
        score=score._replace(
            cutoff=score.cutoff or 20 * noise, max_gap=score.max_gap or 5 * interval
        ),
    )


def _mutual(one: np.ndarray, two: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds the pairs of two scans that are each other's nearest."""
    if not len(one) or not len(two):
        return np.zeros(0, int), np.zeros(0, int)
    forth = np.atleast_1d(KDTree(two).query(one)[1])
    back = np.atleast_1d(KDTree(one).query(two)[1])
    kept = np.flatnonzero(back[forth] == np.arange(len(one)))
    return kept, forth[kept]


def _modes(
    settings: Settings, noise: float, speed: float, interval: float
) -> dict[str, Mode]:
    """Fills in the modes; of those that move, each is livelier than the one before."""
    moving = [name for name, mode in settings.modes.items() if not mode.rest]
    densities = speed**2 / (np.geomspace(500, 5, max(len(moving), 1)) * interval)
    made = {}
    for name, mode in settings.modes.items():
        density = mode.noise_density
        if density is None and mode.rest:
            density = noise**2 / (500 * interval)
        elif density is None:
            density = float(densities[moving.index(name)])
        made[name] = mode._replace(
            noise_density=density,
            drift_std=mode.drift_std or noise / (2 * interval),
            sojourn=mode.sojourn or 20 * interval,
        )
    return made
