"""How fast is one scan of the GM-PHD filter: 30 components and 35 detections?

A thousand scenes at once: predicted, updated and reduced to 30 components again, beside
Stone Soup's `PHDUpdater` and `GaussianMixtureReducer` on a few of the same scenes, with
the same thresholds. Five detections are near components, thirty are clutter. Stone Soup
is timed with a gate of five standard deviations, which saves it nearly all of the
corrections. That both give all components the same weights is checked without it.
"""

import datetime
import functools
from typing import Any

import jax
import numpy as np

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack import models, targets
from jaxtrack.trackers import intensity, phd, reduction
from jaxtrack.types import Array, Gaussian, Scan

KIND = "float32"
TOLERANCE = 1e-9  # of the weights in float64
SCENES, COMPONENTS, NEAR, CLUTTER, PEERS = 1000, 30, 5, 30, 4
WIDTH, STD, NOISE, WEIGHT = 200.0, 1.0, 0.3, 0.5  # metres, expected targets
SURVIVE, DETECT, GATE = 0.99, 0.9, 5.0
PRUNE, MERGE = 1e-5, 4.0
PRIOR = np.diag([2.0, 0.5, 2.0, 0.5])
EPOCH = datetime.datetime(2020, 1, 1)


def scenes(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Draws the components' means a second before, and the detections."""
    rng = np.random.default_rng(0)
    mean = np.zeros((number, COMPONENTS, 4))
    mean[..., ::2] = rng.uniform(0, WIDTH, (number, COMPONENTS, 2))
    mean[..., 1::2] = rng.normal(size=(number, COMPONENTS, 2))
    near = mean[:, :NEAR, ::2] + mean[:, :NEAR, 1::2]
    near = near + rng.normal(size=near.shape) * np.sqrt(2.5 + STD**2)
    false = rng.uniform(0, WIDTH, (number, CLUTTER, 2))
    return mean, np.concatenate([near, false], axis=1)


def params(kind: str) -> intensity.Params:
    """Returns constant velocity, positions, and uniform clutter."""
    target = targets.single.Params(
        motion=models.motion.ConstantVelocity(np.full(2, NOISE, kind)),
        sensor=models.sensor.Position(np.full(2, STD, kind)),
        survive=models.probability.Constant(np.array(SURVIVE, kind)),
        detect=models.probability.Constant(np.array(DETECT, kind)),
    )
    low, high = np.full(2, -1000, kind), np.full(2, WIDTH + 1000, kind)
    rate = np.array(density() * (high - low).prod(), kind)
    return intensity.Params(
        target, None, models.clutter.UniformClutter(rate, low, high)
    )


def density() -> float:
    """Returns the intensity of the clutter, in detections per square metre."""
    return CLUTTER / WIDTH**2


def update(
    kind: str, mean: Array, detections: Array
) -> tuple[intensity.Components, intensity.Update, Scan]:
    """Predicts and updates the intensity of a scene."""
    given, target = params(kind), targets.single.single()
    cov = jax.numpy.broadcast_to(PRIOR.astype(kind), (len(mean), 4, 4))
    log_weight = np.full(len(mean), np.log(WEIGHT), kind)
    before = intensity.Components(
        log_weight, Gaussian(mean, cov), jax.numpy.arange(len(mean))
    )
    valid = np.ones(len(detections), bool)
    scan = Scan(detections, valid, np.array(1.0, kind))
    now, _ = intensity.predict(target, given.target, before, scan.interval)
    return now, phd.update(target, given, now, scan), scan


def one_scan(mean: Array, detections: Array) -> intensity.Components:
    """Does the same and reduces what came of it."""
    now, posterior, scan = update(KIND, mean, detections)
    size = reduction.make(COMPONENTS, prune_threshold=PRUNE, merge_threshold=MERGE)
    target, given = targets.single.single(), params(KIND).target
    return reduction.reduce(size, target, given, now.label, posterior, scan)[0]


def weights(mean: Array, detections: Array) -> Array:
    """Returns the weights of all that an update makes of a scene, the least first."""
    _, posterior, _ = update("float64", mean, detections)
    parts = posterior.log_missed, posterior.log_hit.ravel()
    return jax.numpy.sort(jax.numpy.exp(jax.numpy.concatenate(parts)))


def stone_soup(
    mean: np.ndarray, detections: np.ndarray, gate: float, reduces: bool
) -> list[np.ndarray]:
    """Does the same scene by scene; returns the weights, the least first."""
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.hypothesiser.gaussianmixture import GaussianMixtureHypothesiser
    from stonesoup.measures import Mahalanobis
    from stonesoup.mixturereducer.gaussianmixture import GaussianMixtureReducer
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.array import CovarianceMatrix, StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import TaggedWeightedGaussianState
    from stonesoup.updater.kalman import KalmanUpdater
    from stonesoup.updater.pointprocess import PHDUpdater

    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(NOISE)] * 2)
    sensor = LinearGaussian(4, (0, 2), np.diag([STD**2] * 2))
    kalman, now = KalmanUpdater(sensor), EPOCH + datetime.timedelta(seconds=1)
    pairs = DistanceHypothesiser(
        KalmanPredictor(motion), kalman, Mahalanobis(), missed_distance=gate
    )
    hypothesiser = GaussianMixtureHypothesiser(pairs, order_by_detection=True)
    updater = PHDUpdater(
        kalman,
        clutter_spatial_density=density(),
        prob_detection=DETECT,
        prob_survival=SURVIVE,
    )
    reducer = GaussianMixtureReducer(
        prune_threshold=PRUNE, merge_threshold=MERGE, max_number_components=COMPONENTS
    )
    state = functools.partial(
        TaggedWeightedGaussianState, timestamp=EPOCH, weight=WEIGHT
    )
    found = []
    for one, seen in zip(mean, detections, strict=True):
        before = [
            state(StateVector(m), CovarianceMatrix(PRIOR), tag=str(n))
            for n, m in enumerate(one)
        ]
        reports = {
            Detection(StateVector(z), timestamp=now, measurement_model=sensor)
            for z in seen
        }
        after = updater.update(hypothesiser.hypothesise(before, reports, now))
        kept = reducer.reduce(after) if reduces else after
        found.append(np.sort([float(state.weight) for state in kept]))
    return found


def check(mean: np.ndarray, detections: np.ndarray) -> float:
    """Returns the error of the weights of one scene, all its pairs counted.

    Raises:
        ValueError: It is beyond the tolerance.
    """
    theirs = stone_soup(mean[:1], detections[:1], np.inf, reduces=False)
    # Stone Soup has no weights of zero.
    theirs = np.where(theirs[0] > np.finfo(float).eps, theirs[0], 0.0)
    with common.precision("float64"):
        own = np.asarray(jax.jit(weights)(mean[0], detections[0]))
    return common.check("jaxtrack", own, theirs, TOLERANCE)


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    quick = size == common.QUICK
    mean, detections = scenes(2 if quick else SCENES)
    error = check(mean, detections)
    few = mean[: 1 if quick else PEERS], detections[: 1 if quick else PEERS]
    peer = Job("Stone Soup", lambda: stone_soup(*few, GATE, True), len(few[0]))
    with common.precision(KIND):
        call, seconds = common.compiled(
            common.many(one_scan, 0), mean.astype(KIND), detections.astype(KIND)
        )
        kept: Any = call()
        if not np.isfinite(np.asarray(kept.belief.mean)).all():
            raise ValueError("a mean is not finite")
        own = Job("jaxtrack", call, len(mean), seconds, error)
        work = "GM-PHD, 30 components, 35 detections"
        return common.compare(
            work, KIND, own, [peer], None, min(size.rounds, 5), "scans/s"
        )


if __name__ == "__main__":
    common.main(rows)
