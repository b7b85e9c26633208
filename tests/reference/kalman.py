"""The Kalman filter, the RTS smoother and the random coefficient filter, by the book.

Plain NumPy loops with inverses, in the letters of the papers: F, u, Q move; H, d, R
measure.
"""

import numpy as np

from jaxtrack.types import Affine, Gaussian


def random_cov(rng, dim):
    root = rng.normal(size=(dim, dim))
    return root @ root.T + np.eye(dim)


def random_track(seed, num_scans=12, num_axes=2):
    """Constant velocity at irregular times, a changing sensor with an output an axis.

    Positions are in hundreds of metres, so that the 1e-9 that dynamax adds to the
    matrices it solves with is below rounding.

    Returns:
        What `kalman.filter` takes, in NumPy; every third scan has no detection.
    """
    rng = np.random.default_rng(seed)
    dim, density = 2 * num_axes, np.diag([30.0, 60.0][:num_axes])
    interval = rng.uniform(0.5, 9.0, num_scans)
    axis = [np.array([[1, dt], [0, 1]]) for dt in interval]
    noise = [np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) for dt in interval]
    motions = Affine(
        matrix=np.array([np.kron(np.eye(num_axes), block) for block in axis]),
        offset=rng.normal(size=(num_scans, dim)) * 20,
        cov=np.array([np.kron(density, block) for block in noise]),
    )
    sensors = Affine(
        matrix=rng.normal(size=(num_scans, num_axes, dim)),
        offset=rng.normal(size=(num_scans, num_axes)) * 50,
        cov=np.array([random_cov(rng, num_axes) * 400 for _ in range(num_scans)]),
    )
    prior = Gaussian(rng.normal(size=dim) * 500, random_cov(rng, dim) * 1e4)
    detections = rng.normal(size=(num_scans, num_axes)) * 500
    return prior, motions, sensors, detections, np.arange(num_scans) % 3 != 1


def symmetric(belief):
    """A belief or model whose covariance is made symmetric."""
    return belief._replace(cov=(belief.cov + belief.cov.mT) / 2)


def weighted_sum(arrays):
    """Makes a scalar of arrays, in which every entry has a weight of its own."""
    rng = np.random.default_rng(0)
    return sum((rng.normal(size=x.shape) * x).sum() for x in arrays)


def slopes(value_and_grad, vector, step=1e-6):
    """Returns the slope in a random direction by the gradient, and by differences."""
    vector = np.asarray(vector)
    direction = np.random.default_rng(1).normal(size=len(vector)) * (abs(vector) + 0.1)
    ahead = float(value_and_grad(vector + step * direction)[0])
    behind = float(value_and_grad(vector - step * direction)[0])
    by_gradient = np.asarray(value_and_grad(vector)[1]) @ direction
    return by_gradient, (ahead - behind) / (2 * step)


def predict(m, P, F, u, Q):
    return F @ m + u, F @ P @ F.T + Q


def update(m, P, H, d, R, z):
    """The textbook form, P - K S K', and the log-density of z."""
    v = z - H @ m - d
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    exponent = v @ np.linalg.inv(S) @ v
    log_density = -(exponent + np.log(np.linalg.det(2 * np.pi * S))) / 2
    return m + K @ v, P - K @ S @ K.T, log_density


def filter(prior, motions, sensors, detections, detected):
    """Returns predicted and filtered moments and log-densities, each with T first."""
    m, P = prior
    rows = []
    for t in range(len(detections)):
        m, P = predict(m, P, motions[0][t], motions[1][t], motions[2][t])
        predicted, log_density = (m, P), 0.0
        if detected[t]:
            H, d, R = sensors[0][t], sensors[1][t], sensors[2][t]
            m, P, log_density = update(m, P, H, d, R, detections[t])
        rows.append((*predicted, m, P, log_density))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def smooth(filtered_mean, filtered_cov, motions):
    """Rauch-Tung-Striebel; motion t leads from scan t - 1 to scan t."""
    mean, cov = filtered_mean.copy(), filtered_cov.copy()
    for t in reversed(range(len(mean) - 1)):
        F, u, Q = motions[0][t + 1], motions[1][t + 1], motions[2][t + 1]
        m, P = predict(filtered_mean[t], filtered_cov[t], F, u, Q)
        G = filtered_cov[t] @ F.T @ np.linalg.inv(P)
        mean[t] = filtered_mean[t] + G @ (mean[t + 1] - m)
        cov[t] = filtered_cov[t] + G @ (cov[t + 1] - P) @ G.T
    return mean, cov


def random_average(prob, matrices, covs, second):
    """The mean matrix, and eq. 23 (or 24) of Liu 2021."""
    mean_matrix = np.zeros_like(matrices[0])
    for p, matrix in zip(prob, matrices, strict=True):
        mean_matrix += p * matrix
    noise = np.zeros_like(covs[0])
    for p, matrix, cov in zip(prob, matrices, covs, strict=True):
        noise += p * (cov + (matrix - mean_matrix) @ second @ (matrix - mean_matrix).T)
    return mean_matrix, noise


def random_predict(m, P, second, prob, F, Q):
    """Equations 19, 20, 23 and 25 of Liu 2021."""
    F_mean, Q_all = random_average(prob, F, Q, second)
    P = F_mean @ P @ F_mean.T + Q_all
    return F_mean @ m, P, F_mean @ second @ F_mean.T + Q_all


def random_update(m, P, second, prob, H, R, z):
    """Equations 18, 21, 22 and 24 of Liu 2021, with the pseudo-inverse."""
    H_mean, R_all = random_average(prob, H, R, second)
    S = H_mean @ P @ H_mean.T + R_all
    K = P @ H_mean.T @ np.linalg.pinv(S)
    v = z - H_mean @ m
    log_density = -(v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * np.pi * S)[1]) / 2
    return m + K @ v, (np.eye(len(m)) - K @ H_mean) @ P, log_density
