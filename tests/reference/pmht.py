"""Probabilistic MHT by loops, and its objective by all assignments one by one.

Targets that move on a line at constant velocity, seen in position; the letters are
those of Streit and Luginbuhl 1995.
"""

import itertools
import math

import numpy as np
from reference import kalman


def moves(model, intervals):
    F = np.array([[[1, dt], [0, 1]] for dt in intervals])
    Q = np.array([[[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]] for dt in intervals])
    return F, np.zeros((len(F), 2)), model["noise_density"] * Q


def gauss(z, mean, var):
    return math.exp(-0.5 * (z - mean) ** 2 / var) / math.sqrt(2 * math.pi * var)


def weights(z, means, variances, model):
    """Of each target and copy of the noise, and of clutter; they sum to one."""
    rows = []
    for n, (mean, var) in enumerate(zip(means, variances, strict=True)):
        copies = zip(model["scale"], model["share"], strict=True)
        rate = model["rate"][n]
        r = model["sensor_var"]
        rows.append([rate * s * gauss(z, mean, var + c * r) for c, s in copies])
    false = model["clutter"] * model["false_density"]
    total = false + np.sum(rows)
    return np.array(rows) / total, false / total, total


def synthetic(scan, means, variances, model, n):
    """The mean detection of target n and its variance, or None without any weight."""
    weight = mean = 0.0
    for z in scan:
        w = weights(z, means, variances, model)[0][n] / model["scale"]
        weight += w.sum()
        mean += w.sum() * z
    return mean / weight, model["sensor_var"] / weight


def guess(scans, model, motions):
    """A pass forward, weighed by the innovation covariance, and one back."""
    H, num = np.array([[1.0, 0.0]]), len(model["rate"])
    now = [(model["mean"][n], model["cov"][n]) for n in range(num)]
    filtered, log_density = [], []
    for t, scan in enumerate(scans):
        now = [kalman.predict(*x, *(part[t] for part in motions)) for x in now]
        means, variances = [m[0] for m, _ in now], [P[0, 0] for _, P in now]
        total = -sum(model["rate"]) - model["clutter"]
        log_density.append(
            total + sum(math.log(weights(z, means, variances, model)[2]) for z in scan)
        )
        if len(scan):
            seen = [synthetic(scan, means, variances, model, n) for n in range(num)]
            now = [
                kalman.update(*x, H, np.zeros(1), np.array([[r]]), np.array([z]))[:2]
                for x, (z, r) in zip(now, seen, strict=True)
            ]
        filtered.append(now)
    paths = [back([scan[n] for scan in filtered], motions) for n in range(num)]
    return paths, log_density


def back(filtered, motions):
    mean, cov = (np.array(x) for x in zip(*filtered, strict=True))
    return kalman.smooth(mean, cov, motions)


def improve(paths, scans, model, motions):
    """One iteration."""
    H, after = np.array([[1.0, 0.0]]), []
    for n in range(len(paths)):
        now, filtered = (model["mean"][n], model["cov"][n]), []
        for t, scan in enumerate(scans):
            now = kalman.predict(*now, *(part[t] for part in motions))
            if len(scan):
                means = [path[0][t][0] for path in paths]
                z, r = synthetic(scan, means, [0.0] * len(paths), model, n)
                z, r = np.array([z]), np.array([[r]])
                now = kalman.update(*now, H, np.zeros(1), r, z)[:2]
            filtered.append(now)
        after.append(back(filtered, motions))
    return after


def shares(paths, scans, model):
    """Probability of each cause of each detection, clutter last."""
    result = []
    for t, scan in enumerate(scans):
        means = [path[0][t][0] for path in paths]
        rows = [weights(z, means, [0.0] * len(paths), model) for z in scan]
        result.append([[*known.sum(1), false] for known, false, _ in rows])
    return result


def log_objective(paths, scans, model, intervals):
    """Over all ways to explain each scan, and the joint prior of each path."""
    total = 0.0
    for t, scan in enumerate(scans):
        means = [path[0][t][0] for path in paths]
        likelihood = 0.0
        for causes in itertools.product(range(len(paths) + 1), repeat=len(scan)):
            term = math.exp(-sum(model["rate"]) - model["clutter"])
            for z, n in zip(scan, causes, strict=True):
                if n == len(paths):
                    term *= model["clutter"] * model["false_density"]
                    continue
                copies = zip(model["scale"], model["share"], strict=True)
                r = model["sensor_var"]
                term *= model["rate"][n] * sum(
                    s * gauss(z, means[n], c * r) for c, s in copies
                )
            likelihood += term
        total += math.log(likelihood)
    F, _, Q = moves(model, intervals)
    for n, path in enumerate(paths):
        mean, cov = joint(model["mean"][n], model["cov"][n], F, Q)
        gap = path[0].ravel() - mean
        square = gap @ np.linalg.solve(cov, gap)
        total -= (square + np.linalg.slogdet(2 * np.pi * cov)[1]) / 2
    return total


def joint(mean, cov, F, Q):
    """Mean and covariance of all states of a path in a row."""
    size = len(F) * 2
    means, whole = np.zeros(size), np.zeros((size, size))
    for t in range(len(F)):
        here = slice(2 * t, 2 * t + 2)
        mean, cov = F[t] @ mean, F[t] @ cov @ F[t].T + Q[t]
        means[here], whole[here, here] = mean, cov
        for s in range(t):
            earlier = slice(2 * s, 2 * s + 2)
            before = slice(2 * t - 2, 2 * t)
            whole[here, earlier] = F[t] @ whole[before, earlier]
            whole[earlier, here] = whole[here, earlier].T
    return means, whole
