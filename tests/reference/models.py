"""Plain NumPy for the models: matrix exponentials, quadrature, frames and loops.

A linear motion is dx = drift x dt + dw with white noise of the given density [D, D].
"""

import numpy as np
import scipy.linalg


def transition(drift, interval):
    return scipy.linalg.expm(drift * interval)


def noise(drift, density, interval, nodes=40):
    """Integral of exp(A s) density exp(A s)^T over the interval, by Gauss-Legendre."""
    points, weights = np.polynomial.legendre.leggauss(nodes)
    times = interval * (points + 1) / 2
    total = np.zeros_like(drift)
    for moved, weight in zip(
        scipy.linalg.expm(drift * times[:, None, None]), weights, strict=True
    ):
        total += weight * interval / 2 * moved @ density @ moved.T
    return total


def constant_velocity(noise_density):
    drift, density = np.zeros((2, *[2 * len(noise_density)] * 2))
    for axis, value in enumerate(noise_density):
        drift[2 * axis, 2 * axis + 1] = 1
        density[2 * axis + 1, 2 * axis + 1] = value
    return drift, density


def constant_acceleration(noise_density):
    drift, density = np.zeros((2, *[3 * len(noise_density)] * 2))
    for axis, value in enumerate(noise_density):
        drift[3 * axis, 3 * axis + 1] = 1
        drift[3 * axis + 1, 3 * axis + 2] = 1
        density[3 * axis + 2, 3 * axis + 2] = value
    return drift, density


def singer(noise_std, time_constant):
    """Stationary variance s^2 of da = -a / tau dt + dw needs density 2 s^2 / tau."""
    drift, density = constant_acceleration(
        [2 * s**2 / t for s, t in zip(noise_std, time_constant, strict=True)]
    )
    for axis, tau in enumerate(time_constant):
        drift[3 * axis + 2, 3 * axis + 2] = -1 / tau
    return drift, density


def ornstein_uhlenbeck(position_std, time_constant):
    """Double pole at -1 / tau; density from the stationary Lyapunov equation."""
    drift, density = constant_velocity(np.ones(len(position_std)))
    for axis, tau in enumerate(time_constant):
        velocity = 2 * axis + 1
        drift[velocity, velocity - 1] = -1 / tau**2
        drift[velocity, velocity] = -2 / tau
    unit = scipy.linalg.solve_continuous_lyapunov(drift, -density)
    for axis, std in enumerate(position_std):
        density[2 * axis + 1, 2 * axis + 1] = std**2 / unit[2 * axis, 2 * axis]
    return drift, density


def coordinated_turn(turn_rate, noise_density):
    drift, density = constant_velocity([noise_density, noise_density])
    drift[1, 3], drift[3, 1] = -turn_rate, turn_rate
    return drift, density


def polar(place, sensor_place, heading):
    """Range and bearing, by turning the offset into the frame of the sensor."""
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = np.array([[cos, sin], [-sin, cos]]) @ (place - sensor_place)
    return np.hypot(x, y), np.angle(x + 1j * y)


def spherical(place, sensor_place, heading):
    """Azimuth, elevation and range."""
    _, azimuth = polar(place[:2], sensor_place[:2], heading)
    distance = np.linalg.norm(place - sensor_place)
    return azimuth, np.arcsin((place[2] - sensor_place[2]) / distance), distance


def unspherical(detection, sensor_place, heading):
    azimuth, elevation, distance = detection
    ground = distance * np.cos(elevation)
    x, y = ground * np.cos(azimuth + heading), ground * np.sin(azimuth + heading)
    return sensor_place + np.array([x, y, distance * np.sin(elevation)])


def jacobian(function, point, step=1e-6):
    """Central differences, [outputs, inputs]."""
    columns = []
    for i in range(len(point)):
        shift = np.zeros(len(point))
        shift[i] = step
        columns.append((function(point + shift) - function(point - shift)) / 2 / step)
    return np.stack(columns, axis=1)


def detection_birth(birth, places, covs, valid, unexplained, interval, index):
    """One loop over detections; index = (positions, velocities, further)."""
    positions, velocities, further = index
    dim = len(positions) + len(velocities) + len(further)
    total = sum(u for u, v in zip(unexplained, valid, strict=True) if v)
    born = []
    for place, cov, there, u in zip(places, covs, valid, unexplained, strict=True):
        mean, full = np.zeros(dim), np.zeros((dim, dim))
        mean[positions] = place
        full[np.ix_(positions, positions)] = cov
        full[velocities, velocities] = birth.velocity_std**2
        full[further, further] = birth.extra_std**2
        share = birth.rate * interval * u / total if there else 0.0
        born.append((min(birth.max_existence_prob, share), mean, full))
    return born


def switching_rate(mean_sojourn, jump_prob):
    num = len(mean_sojourn)
    rate = np.zeros((num, num))
    for i in range(num):
        for j in range(num):
            if i != j:
                rate[i, j] = jump_prob[i, j] / mean_sojourn[i]
                rate[i, i] -= rate[i, j]
    return rate
