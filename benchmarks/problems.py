"""The data that the benchmarks share, and slow plain answers in NumPy.

Every run has a prior covariance of its own, so that nobody can share the recursion of
the covariance among runs.

    >>> from benchmarks import problems
    >>> problem = problems.linear(runs=4, scans=3)
    >>> problem.detections.shape, problems.kalman(problem).log_density.shape
    ((4, 3, 2), (4,))
"""

from typing import Any, NamedTuple

import numpy as np

Values = Any  # an array of NumPy or of jax
INTERVAL = 1.0  # seconds
DENSITY = 0.1  # of the acceleration, m^2/s^3
SENSOR_STD = 0.7  # metres
DENSITIES = (0.01, 0.1, 1.0, 5.0, 20.0)  # of the five modes
STAY_PROB = 0.92
TURN_DENSITY = 1e-5  # rad^2/s^3
RADAR_STD = (2.0, 0.01)  # metres, radians


class Problem(NamedTuple):
    """Models, and R runs of T scans.

    Attributes:
        transition: [D, D], with modes [M, D, D], zeros for a nonlinear motion.
        noise: [D, D], with modes [M, D, D].
        matrix: Of the sensor, [2, D], zeros for a nonlinear one.
        sensor_noise: [2, 2].
        mean: One motion before the first scan, [R, D].
        cov: The same, [R, D, D].
        detections: [R, T, 2].
    """

    transition: Values
    noise: Values
    matrix: Values
    sensor_noise: Values
    mean: Values
    cov: Values
    detections: Values

    def to(self, precision: str) -> "Problem":
        """Returns the same numbers in another precision."""
        return Problem(*(np.ascontiguousarray(x, precision) for x in self))


def first(problem: Problem, runs: int) -> Problem:
    """Returns the first runs of a problem."""
    own = problem.mean, problem.cov, problem.detections
    return Problem(*problem[:4], *(x[:runs] for x in own))


class Answer(NamedTuple):
    """Log-density of the data [R]; filtered means [R, T, D], covariances [R, T, D, D].

    Attributes:
        log_density: Of all detections of a run.
        mean: Filtered.
        cov: Filtered.
    """

    log_density: np.ndarray
    mean: np.ndarray
    cov: np.ndarray


def velocity_noise(density: float, t: float = INTERVAL) -> np.ndarray:
    """Returns the covariance of constant velocity in the plane, [4, 4]."""
    return np.kron(np.eye(2), density * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]]))


def linear(runs: int, scans: int, modes: bool = False, seed: int = 0) -> Problem:
    """Draws targets of constant velocity, whose position is seen.

    Args:
        runs: R.
        scans: T.
        modes: Whether the filter has five modes, which differ in their noise.
        seed: Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    transition = np.kron(np.eye(2), [[1, INTERVAL], [0, 1]])
    noise, matrix = velocity_noise(DENSITY), np.eye(4)[[0, 2]]
    root, state, seen = np.linalg.cholesky(noise), rng.normal(size=(runs, 4)), []
    for _ in range(scans):
        state = state @ transition.T + rng.normal(size=(runs, 4)) @ root.T
        seen.append(state[:, [0, 2]] + SENSOR_STD * rng.normal(size=(runs, 2)))
    if modes:
        noise = np.stack([velocity_noise(density) for density in DENSITIES])
        transition = np.stack([transition] * len(DENSITIES))
    return Problem(
        transition,
        noise,
        matrix,
        SENSOR_STD**2 * np.eye(2),
        np.zeros((runs, 4)),
        own_covariances(rng, np.ones(4), runs),
        np.stack(seen, 1),
    )


def turning(runs: int, scans: int, seed: int = 0) -> Problem:
    """Draws targets that turn at a wandering rate, seen by a radar at the origin.

    They stay far from the bearing where angles wrap, since some peers do not.
    """
    rng = np.random.default_rng(seed)
    noise = np.zeros((5, 5))
    noise[:4, :4], noise[4, 4] = velocity_noise(DENSITY), TURN_DENSITY * INTERVAL
    mean = np.tile([500.0, 3.0, 500.0, 2.0, 0.03], (runs, 1))
    state, root, seen = mean, np.linalg.cholesky(noise), []
    for _ in range(scans):
        state = turn(state)[0] + 0.1 * rng.normal(size=(runs, 5)) @ root.T
        seen.append(look(state)[0] + np.array(RADAR_STD) * rng.normal(size=(runs, 2)))
    return Problem(
        np.zeros((5, 5)),
        noise,
        np.zeros((2, 5)),
        np.diag(RADAR_STD) ** 2,
        mean,
        own_covariances(rng, np.array([10.0, 3.0, 10.0, 3.0, 0.02]), runs),
        np.stack(seen, 1),
    )


def own_covariances(rng: np.random.Generator, std: np.ndarray, runs: int) -> np.ndarray:
    """Returns a covariance for each run, [R, D, D], near the square of std [D]."""
    root = np.eye(std.size) + 0.2 * rng.normal(size=(runs, std.size, std.size))
    root = std[:, None] * root
    return root @ root.transpose(0, 2, 1)


def turn(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turns states [R, 5] for one interval; returns them and the Jacobians."""
    t, (x, vx, y, vy, rate) = INTERVAL, state.T
    s, c = np.sin(rate * t), np.cos(rate * t)
    a, g = s / rate, (1 - c) / rate
    da, dg = (c * t - a) / rate, (s * t - g) / rate
    moved = [x + a * vx - g * vy, c * vx - s * vy, y + g * vx + a * vy, s * vx + c * vy]
    slopes = np.tile(np.eye(5), (len(state), 1, 1))
    slopes[:, 0, [1, 3]], slopes[:, 1, [1, 3]] = (
        np.stack([a, -g], 1),
        np.stack([c, -s], 1),
    )
    slopes[:, 2, [1, 3]], slopes[:, 3, [1, 3]] = (
        np.stack([g, a], 1),
        np.stack([s, c], 1),
    )
    slopes[:, 0, 4], slopes[:, 1, 4] = da * vx - dg * vy, -t * moved[3]
    slopes[:, 2, 4], slopes[:, 3, 4] = dg * vx + da * vy, t * moved[1]
    return np.stack([*moved, rate], 1), slopes


def turn_spread(mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turns beliefs [R] by the unscented transform, without noise."""
    dim, spread = 5, 3.0
    steps = np.sqrt(spread) * np.linalg.cholesky(cov).transpose(2, 0, 1)
    points = np.stack([turn(x)[0] for x in [mean, *(mean + steps), *(mean - steps)]])
    weight = np.array([1 - dim / spread, *[1 / (2 * spread)] * (2 * dim)])
    moved = np.einsum("n,nri->ri", weight, points)
    gap = points - moved
    return moved, np.einsum("n,nri,nrj->rij", weight, gap, gap)


def look(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns range and bearing of states [R, 5], and the Jacobians."""
    x, y = state[:, 0], state[:, 2]
    away = np.hypot(x, y)
    slopes = np.zeros((len(state), 2, 5))
    slopes[:, 0, 0], slopes[:, 0, 2] = x / away, y / away
    slopes[:, 1, 0], slopes[:, 1, 2] = -y / away**2, x / away**2
    return np.stack([away, np.arctan2(y, x)], 1), slopes


def predict(
    mean: np.ndarray, cov: np.ndarray, transition: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Moves beliefs [R] by one motion [D, D] or one each [R, D, D]."""
    moved = (transition @ mean[..., None])[..., 0]
    return moved, transition @ cov @ transition.swapaxes(-1, -2) + noise


def update(
    mean: np.ndarray,
    cov: np.ndarray,
    matrix: np.ndarray,
    noise: np.ndarray,
    surprise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Conditions beliefs [R] on residuals [R, 2]; returns the log-densities too."""
    cross = matrix @ cov
    spread = cross @ np.swapaxes(matrix, -1, -2) + noise
    inverse = np.linalg.inv(spread)
    gain = np.swapaxes(cross, 1, 2) @ inverse
    far = np.einsum("ri,rij,rj->r", surprise, inverse, surprise)
    log_density = -(far + np.linalg.slogdet(spread)[1]) / 2 - np.log(2 * np.pi)
    mean = mean + np.einsum("rij,rj->ri", gain, surprise)
    cov = cov - gain @ cross
    # Rounding leaves an antisymmetric part, which would grow from scan to scan.
    return mean, (cov + np.swapaxes(cov, 1, 2)) / 2, log_density


def kalman(problem: Problem) -> Answer:
    """Runs the Kalman filter on all runs at once."""
    mean, cov, total, kept = problem.mean, problem.cov, 0.0, []
    for z in problem.detections.swapaxes(0, 1):
        mean, cov = predict(mean, cov, problem.transition, problem.noise)
        surprise = z - mean @ problem.matrix.T
        sensor = problem.matrix, problem.sensor_noise
        mean, cov, log_density = update(mean, cov, *sensor, surprise)
        total = total + log_density
        kept.append((mean, cov))
    means, covs = zip(*kept, strict=True)
    return Answer(np.asarray(total), np.stack(means, 1), np.stack(covs, 1))


def extended(problem: Problem) -> Answer:
    """Runs the extended Kalman filter on the problem `turning`."""
    mean, cov, total, kept = problem.mean, problem.cov, 0.0, []
    for z in problem.detections.swapaxes(0, 1):
        moved, slopes = turn(mean)
        mean, cov = moved, predict(mean, cov, slopes, problem.noise)[1]
        expected, matrix = look(mean)
        sensor = matrix, problem.sensor_noise
        mean, cov, log_density = update(mean, cov, *sensor, z - expected)
        total = total + log_density
        kept.append((mean, cov))
    means, covs = zip(*kept, strict=True)
    return Answer(np.asarray(total), np.stack(means, 1), np.stack(covs, 1))


def switching() -> np.ndarray:
    """Returns the transition probabilities of the five modes, [M, M]."""
    size = len(DENSITIES)
    leave = (1 - STAY_PROB) / (size - 1)
    return np.full((size, size), leave) + (STAY_PROB - leave) * np.eye(size)


def imm(problem: Problem) -> Answer:
    """Runs interacting multiple models; returns the beliefs over all modes."""
    size, change = len(problem.noise), switching()
    prob = np.full((len(problem.mean), size), 1 / size)
    mean, cov = (np.stack([x] * size, 1) for x in (problem.mean, problem.cov))
    total, kept = 0.0, []
    for z in problem.detections.swapaxes(0, 1):
        entered = prob @ change
        came_from = prob[:, :, None] * change / entered[:, None]
        mixed = [_collapse(came_from[:, :, j], mean, cov) for j in range(size)]
        motions = zip(problem.transition, problem.noise, strict=True)
        done = []
        for belief, motion in zip(mixed, motions, strict=True):
            moved = predict(*belief, *motion)
            surprise = z - moved[0] @ problem.matrix.T
            sensor = problem.matrix, problem.sensor_noise
            done.append(update(*moved, *sensor, surprise))
        mean, cov, log_density = (np.stack(x, 1) for x in zip(*done, strict=True))
        joint = entered * np.exp(log_density)
        prob, total = joint / joint.sum(1)[:, None], total + np.log(joint.sum(1))
        kept.append(_collapse(prob, mean, cov))
    means, covs = zip(*kept, strict=True)
    return Answer(np.asarray(total), np.stack(means, 1), np.stack(covs, 1))


def _collapse(
    weight: np.ndarray, mean: np.ndarray, cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    centre = np.einsum("rm,rmi->ri", weight, mean)
    gap = mean - centre[:, None]
    within = np.einsum("rm,rmij->rij", weight, cov)
    return centre, within + np.einsum("rm,rmi,rmj->rij", weight, gap, gap)
