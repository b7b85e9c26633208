"""The same work by other libraries, each through its own interface.

Their imports are in the functions, since none is needed to import this module; what is
not installed is left out of the results. FilterPy and Stone Soup work on one run at a
time in Python, so a few runs tell their rate.

    >>> from benchmarks import peers
    >>> peers.installed("numpy")
    True
"""

import datetime
import importlib.util
import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import problems
from benchmarks.problems import Problem
from jaxtrack.types import Array

FEW = 5  # runs


def installed(name: str) -> bool:
    """Returns whether a package can be imported."""
    return importlib.util.find_spec(name) is not None


def dynamax_kalman(
    problem: Problem, outputs: Callable[[Any], Any]
) -> tuple[Callable, tuple]:
    """Returns dynamax's Kalman filter over all runs, and its arguments.

    Args:
        problem: A linear one.
        outputs: (posterior) -> what is wanted of it.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its dependencies deprecate one another
        from dynamax.linear_gaussian_ssm import lgssm_filter
        from dynamax.linear_gaussian_ssm.inference import make_lgssm_params

    def one(mean: Array, cov: Array, models: tuple, detections: Array) -> Any:
        return outputs(lgssm_filter(make_lgssm_params(mean, cov, *models), detections))

    # Its prior is the belief at the first scan.
    first = problems.predict(
        problem.mean, problem.cov, problem.transition, problem.noise
    )
    models = problem.transition, problem.noise, problem.matrix, problem.sensor_noise
    arguments = (*first, models, problem.detections)
    return jax.vmap(one, (0, 0, None, 0)), arguments


def dynamax_turning(problem: Problem, unscented: bool) -> tuple[Callable, tuple]:
    """Returns dynamax's extended or unscented filter over all runs, and its arguments.

    Args:
        problem: `problems.turning`.
        unscented: Which filter.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from dynamax.nonlinear_gaussian_ssm import (
            ParamsNLGSSM,
            UKFHyperParams,
            extended_kalman_filter,
            unscented_kalman_filter,
        )

    ours = UKFHyperParams(alpha=1.0, beta=0, kappa=-2)  # of `linearize.unscented`

    def one(mean: Array, cov: Array, noises: tuple, detections: Array) -> Any:
        params = ParamsNLGSSM(mean, cov, turn, noises[0], look, noises[1])
        if unscented:
            return unscented_kalman_filter(params, detections, ours).marginal_loglik
        return extended_kalman_filter(params, detections).marginal_loglik

    if unscented:
        mean, cov = problems.turn_spread(problem.mean, problem.cov)
    else:
        mean, slopes = problems.turn(problem.mean)
        cov = slopes @ problem.cov @ slopes.swapaxes(1, 2)
    noises = problem.noise, problem.sensor_noise
    arguments = mean, cov + problem.noise, noises, problem.detections
    return jax.vmap(one, (0, 0, None, 0)), arguments


def turn(state: Array) -> Array:
    """Turns a state [5] for one interval, as a user would write it."""
    x, vx, y, vy, rate = state
    rate = jnp.where(jnp.abs(rate) < 1e-4, 1e-4, rate)
    s, c = jnp.sin(rate * problems.INTERVAL), jnp.cos(rate * problems.INTERVAL)
    a, g = s / rate, (1 - c) / rate
    moved = x + a * vx - g * vy, c * vx - s * vy, y + g * vx + a * vy, s * vx + c * vy
    return jnp.stack([*moved, state[4]])


def look(state: Array) -> Array:
    """Returns range and bearing of a state [5], as a user would write it."""
    x, y = state[0], state[2]
    return jnp.stack([jnp.sqrt(x**2 + y**2), jnp.arctan2(y, x)])


def filterpy_kalman(problem: Problem) -> np.ndarray:
    """Runs FilterPy's Kalman filter; returns the log-densities of a few runs."""
    from filterpy.kalman import KalmanFilter

    totals = []
    for mean, cov, detections in few(problem):
        own = KalmanFilter(4, 2)
        own.F, own.Q = problem.transition, problem.noise
        own.H, own.R = problem.matrix, problem.sensor_noise
        own.x, own.P = mean[:, None].copy(), cov.copy()
        total = 0.0
        for z in detections:
            own.predict()
            own.update(z[:, None])
            total += own.log_likelihood
        totals.append(total)
    return np.array(totals)


def filterpy_extended(problem: Problem) -> np.ndarray:
    """Runs FilterPy's extended Kalman filter with Jacobians by hand."""
    from filterpy.kalman import ExtendedKalmanFilter

    totals = []
    for mean, cov, detections in few(problem):
        own = ExtendedKalmanFilter(5, 2)
        own.Q, own.R = problem.noise, problem.sensor_noise
        own.x, own.P = mean.copy(), cov.copy()
        total = 0.0
        for z in detections:
            moved, slopes = problems.turn(own.x[None])
            own.F = slopes[0]
            own.predict()
            own.x = moved[0]
            own.update(
                z,
                lambda x: problems.look(x[None])[1][0],
                lambda x: problems.look(x[None])[0][0],
            )
            total += own.log_likelihood
        totals.append(total)
    return np.array(totals)


def filterpy_imm(problem: Problem) -> np.ndarray:
    """Runs FilterPy's IMM; returns the last means over all modes, [few, 4]."""
    from filterpy.kalman import IMMEstimator, KalmanFilter

    means = []
    for mean, cov, detections in few(problem):
        bank = []
        for transition, noise in zip(problem.transition, problem.noise, strict=True):
            own = KalmanFilter(4, 2)
            own.F, own.Q = transition, noise
            own.H, own.R = problem.matrix, problem.sensor_noise
            own.x, own.P = mean[:, None].copy(), cov.copy()
            bank.append(own)
        prob = np.full(len(bank), 1 / len(bank))
        whole = IMMEstimator(bank, prob, problems.switching())
        for z in detections:
            whole.predict()
            whole.update(z[:, None])
        means.append(whole.x[:, 0])
    return np.array(means)


def stonesoup_kalman(problem: Problem) -> Callable[[], np.ndarray]:
    """Returns Stone Soup's Kalman filter with the log-densities of a few runs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from scipy.stats import multivariate_normal
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.models.transition import linear
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.types.detection import Detection
        from stonesoup.types.hypothesis import SingleHypothesis
        from stonesoup.types.state import GaussianState
        from stonesoup.updater.kalman import KalmanUpdater

    axes = [linear.ConstantVelocity(problems.DENSITY) for _ in range(2)]
    motion = linear.CombinedLinearGaussianTransitionModel(axes)
    sensor = LinearGaussian(4, (0, 2), problem.sensor_noise)
    predictor, updater = KalmanPredictor(motion), KalmanUpdater(sensor)
    start = datetime.datetime(2020, 1, 1)
    step = datetime.timedelta(seconds=problems.INTERVAL)

    def run() -> np.ndarray:
        totals = []
        for mean, cov, detections in few(problem):
            belief, total, time = GaussianState(mean[:, None], cov, start), 0.0, start
            for z in detections:
                time = time + step
                predicted = predictor.predict(belief, timestamp=time)
                seen = Detection(z[:, None], time, measurement_model=sensor)
                pair = SingleHypothesis(predicted, seen)
                belief = updater.update(pair)
                expected: Any = pair.measurement_prediction
                centre = np.ravel(expected.state_vector).astype(float)
                total += multivariate_normal.logpdf(z, centre, expected.covar)
            totals.append(total)
        return np.array(totals)

    return run


def few(problem: Problem) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Returns mean, covariance and detections of the first few runs."""
    parts = problem.mean, problem.cov, problem.detections
    return list(zip(*(x[:FEW] for x in parts), strict=True))
