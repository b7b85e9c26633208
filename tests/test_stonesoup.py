"""JPDA and GNN with fixed tracks, step by step, against Stone Soup's."""

import datetime
import functools

import jax
import numpy as np
import pytest

from jaxtrack import engine, models, targets
from jaxtrack.trackers import gnn, jpda, single_scan
from jaxtrack.types import Scan

SCANS, DETECT, GATE, DENSITY, NOISE, STD = 15, 0.85, 0.95, 1e-4, 0.3, 4.0
START = np.array([[0, 6, 0, 5], [0, 6, 60, -4], [90, -7, 20, 2]], float)
COVS = np.stack([np.diag([20.0, 4, 30, 5]) + 0.5 * i for i in range(3)])
EPOCH = datetime.datetime(2020, 1, 1)


@functools.cache
def scans():
    """Three targets that cross, mostly detected, and clutter; irregular intervals."""
    rng = np.random.default_rng(4)
    interval = rng.integers(2, 7, SCANS) / 4  # whole microseconds
    time = interval.cumsum()
    points, valid = np.zeros((SCANS, 7, 2)), np.zeros((SCANS, 7), bool)
    for t in range(SCANS):
        place = START[:, ::2] + time[t] * START[:, 1::2]
        points[t, :3] = place + STD * rng.normal(size=(3, 2))
        points[t, 3:] = place[rng.integers(3, size=4)] + 25 * rng.normal(size=(4, 2))
        valid[t] = rng.random(7) < np.array([DETECT] * 3 + [0.6] * 4)
    return Scan(points, valid, interval)


@functools.cache
def ours(maker):
    """Mean and covariance of the three tracks after every scan."""
    params = single_scan.Params(
        target=targets.single.Params(
            motion=models.motion.ConstantVelocity(np.full(2, NOISE)),
            sensor=models.sensor.Position(np.full(2, STD)),
            survive=models.probability.Constant(np.array(1.0)),
            detect=models.probability.Constant(np.array(DETECT)),
        ),
        birth=None,
        clutter=models.clutter.UniformClutter(
            np.array(DENSITY * 2e3**2), np.full(2, -1e3), np.full(2, 1e3)
        ),
        start=models.birth.MultiBernoulliBirth(
            np.ones(3), START, COVS, np.ones((3, 1))
        ),
    )
    tracker = maker(
        targets.single.single(), max_tracks=3, gate_prob=GATE, gate_in_missed=True
    )
    run = jax.jit(functools.partial(engine.run, tracker))
    found = jax.tree.map(np.array, run(params, scans(), jax.random.key(0)))
    order = np.argsort(found.label, axis=1)
    mean = np.take_along_axis(found.mean, order[..., None], 1)
    return mean, np.take_along_axis(found.cov, order[..., None, None], 1)


def stone_soup(associator_name):
    """The same by Stone Soup's loop over tracks."""
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.dataassociator.probability import JPDA
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
    from stonesoup.types.update import GaussianStateUpdate
    from stonesoup.updater.kalman import KalmanUpdater

    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(NOISE)] * 2)
    sensor = LinearGaussian(4, (0, 2), np.diag([STD**2] * 2))
    updater = KalmanUpdater(sensor)
    hypothesiser = PDAHypothesiser(
        KalmanPredictor(motion), updater, DENSITY, DETECT, GATE
    )
    makers = {"jpda": JPDA, "gnn": GNNWith2DAssignment}
    associator = makers[associator_name](hypothesiser)
    tracks = [
        Track([GaussianState(StateVector(m), CovarianceMatrix(P), timestamp=EPOCH)])
        for m, P in zip(START, COVS, strict=True)
    ]
    now, rows = EPOCH, []
    for points, valid, interval in zip(*scans(), strict=True):
        now = now + datetime.timedelta(seconds=float(interval))
        seen = {
            Detection(StateVector(z), timestamp=now, measurement_model=sensor)
            for z in points[valid]
        }
        answer = associator.associate(set(tracks), seen, now)
        row = []
        for track in tracks:
            choices = answer[track]
            choices = list(choices) if associator_name == "jpda" else [choices]
            means, covs, weights = [], [], []
            for choice in choices:
                after = updater.update(choice) if choice else choice.prediction
                means.append(np.array(after.state_vector, float).ravel())
                covs.append(np.array(after.covar, float))
                weight = float(choice.probability) if len(choices) > 1 else 1.0
                weights.append(weight)
            weights = np.array(weights) / np.sum(weights)
            mean = weights @ means
            gap = np.array(means) - mean
            cov = np.einsum("n,nij->ij", weights, covs)
            cov = cov + np.einsum("n,ni,nj->ij", weights, gap, gap)
            state = GaussianStateUpdate(
                StateVector(mean),
                CovarianceMatrix(cov),
                hypothesis=answer[track],
                timestamp=now,
            )
            track.append(state)
            row.append((mean, cov))
        rows.append(row)
    mean = np.array([[m for m, _ in row] for row in rows])
    return mean, np.array([[P for _, P in row] for row in rows])


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(("name", "maker"), [("jpda", jpda.jpda), ("gnn", gnn.gnn)])
def test_a_whole_run_with_fixed_tracks(name, maker):
    mean, cov = ours(maker)
    their_mean, their_cov = stone_soup(name)
    # Absolute, in metres, where a coordinate happens to be near zero.
    np.testing.assert_allclose(mean, their_mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(cov, their_cov, rtol=1e-9, atol=1e-9)
