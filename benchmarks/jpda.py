"""How fast is one scan of JPDA: association and update of 10 tracks, 20 detections?

A thousand scenes at once, beside Stone Soup with the EHM2 of pyehm, which is exact as
well, on a few of the same scenes. Half of the detections are the tracks' own, half are
clutter among them; a gate of 0.999 leaves clusters of a few tracks.
"""

import datetime
import functools
from typing import Any

import jax
import numpy as np

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack import models, targets
from jaxtrack.trackers import association, jpda, single_scan
from jaxtrack.trackers.bernoulli import Tracks
from jaxtrack.types import Array, Gaussian, Scan

KIND = "float32"
TOLERANCE = 2e-2  # metres, of means of some hundred metres in float32
SCENES, TRACKS, CLUTTER, PEERS = 1000, 10, 10, 8
WIDTH, STD, DETECT, GATE, NOISE = 300.0, 5.0, 0.9, 0.999, 1.0  # metres
DENSITY = CLUTTER / WIDTH**2
PRIOR = np.diag([50.0, 4.0, 50.0, 4.0])
EPOCH = datetime.datetime(2020, 1, 1)


def scenes(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Draws the tracks' means a second before, and the detections."""
    rng = np.random.default_rng(0)
    mean = np.zeros((number, TRACKS, 4))
    mean[..., ::2] = rng.uniform(0, WIDTH, (number, TRACKS, 2))
    mean[..., 1::2] = rng.normal(size=(number, TRACKS, 2)) * 5
    own = mean[..., ::2] + mean[..., 1::2]
    own = own + rng.normal(size=own.shape) * np.sqrt(50 + 4 + STD**2)
    false = rng.uniform(0, WIDTH, (number, CLUTTER, 2))
    detections = np.concatenate([own, false], axis=1)
    return mean.astype(KIND), detections.astype(KIND)


def params() -> single_scan.Params:
    """Returns constant velocity, positions, and uniform clutter."""
    target = targets.single.Params(
        motion=models.motion.ConstantVelocity(np.full(2, NOISE, KIND)),
        sensor=models.sensor.Position(np.full(2, STD, KIND)),
        survive=models.probability.Constant(np.array(1.0, KIND)),
        detect=models.probability.Constant(np.array(DETECT, KIND)),
    )
    low, high = np.zeros(2, KIND) - 1000, np.full(2, WIDTH, KIND) + 1000
    rate = np.array(DENSITY * (high - low).prod(), KIND)
    falls = models.clutter.UniformClutter(rate, low, high)
    return single_scan.Params(target, None, falls)


def one_scan(method: str, mean: Array, detections: Array) -> Gaussian:
    """Predicts, associates and updates the tracks of a scene."""
    given, target = params(), targets.single.single()
    count = len(detections)
    scan = Scan(detections, np.ones(count, bool), np.array(1.0, KIND))
    cov = jax.numpy.broadcast_to(PRIOR.astype(KIND), (TRACKS, 4, 4))
    predict = jax.vmap(target.predict, (None, 0, None))
    belief, _ = predict(given.target, Gaussian(mean, cov), scan.interval)
    label = np.arange(TRACKS)
    tracks = Tracks(np.ones(TRACKS, KIND), belief, label, label)
    gating = association.Gating(GATE, in_missed=True, counts_clutter=False)
    sighting = association.look(gating, False, target, given, tracks, scan)
    answer = jpda.associate(sighting.log_score, method)
    return association.blend(target, given.target, sighting, answer, scan)


def stone_soup(mean: np.ndarray, detections: np.ndarray) -> list[np.ndarray]:
    """Does the same, scene by scene and track by track; returns the means."""
    from pyehm.plugins.stonesoup import JPDAWithEHM2
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.array import CovarianceMatrix, StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track
    from stonesoup.updater.probability import PDAUpdater

    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(NOISE)] * 2)
    sensor = LinearGaussian(4, (0, 2), np.diag([STD**2] * 2))
    updater = PDAUpdater(sensor)
    hypothesiser = PDAHypothesiser(
        KalmanPredictor(motion), updater, DENSITY, DETECT, GATE
    )
    associator, now = JPDAWithEHM2(hypothesiser), EPOCH + datetime.timedelta(seconds=1)
    found = []
    for one, seen in zip(mean.astype(float), detections.astype(float), strict=True):
        state = functools.partial(GaussianState, timestamp=EPOCH)
        tracks = [Track([state(StateVector(m), CovarianceMatrix(PRIOR))]) for m in one]
        reports = {
            Detection(StateVector(z), timestamp=now, measurement_model=sensor)
            for z in seen
        }
        answer = associator.associate(set(tracks), reports, now)
        after = [updater.update(answer[track]).state_vector for track in tracks]
        found.append(np.array(after, float).reshape(len(one), -1))
    return found


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    quick = size == common.QUICK
    mean, detections = scenes(2 if quick else SCENES)
    few = mean[: 1 if quick else PEERS], detections[: 1 if quick else PEERS]
    theirs = stone_soup(*few)
    peer = Job("Stone Soup, pyehm EHM2", lambda: stone_soup(*few), len(theirs))
    made: list[Row] = []
    with common.precision(KIND):
        for method in ("auto", "belief"):
            call, seconds = common.compiled(
                common.many(functools.partial(one_scan, method), 0), mean, detections
            )
            result: Any = call().mean[: len(theirs)]
            gap = float(np.abs(np.asarray(result) - theirs).max())
            if method == "auto" and gap > TOLERANCE:
                raise ValueError(f"means differ by {gap:.3g} m from the peer's")
            own = Job("jaxtrack", call, len(mean), seconds, gap)
            kind = "exact in clusters" if method == "auto" else "belief propagation"
            work = f"JPDA, 10 tracks, 20 detections, {kind}"
            made += common.compare(
                work, KIND, own, [peer], None, min(size.rounds, 5), "scans/s"
            )
    return made


if __name__ == "__main__":
    common.main(rows)
