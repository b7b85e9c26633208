"""Linear estimation with random matrices, and models and detections, by enumeration."""

import itertools

import numpy as np


def lmmse(mean, cov, choices, detections):
    """Best linear estimate of a state from detections, each a random function of it.

    Args:
        mean: [D].
        cov: [D, D].
        choices: Of each detection (prob, matrix [Z, D], offset [Z], cov [Z, Z]).
        detections: As many, [Z].
    """
    dim, size = len(mean), len(detections[0])
    total = size * len(detections)
    second_state = cov + np.outer(mean, mean)
    first, cross = np.zeros(total), np.zeros((dim, total))
    second = np.zeros((total, total))
    for picked in itertools.product(*choices):
        prob = np.prod([p for p, *_ in picked])
        matrix = np.concatenate([h for _, h, _, _ in picked])
        offset = np.concatenate([b for _, _, b, _ in picked])
        expected = matrix @ mean + offset
        first += prob * expected
        cross += prob * (second_state @ matrix.T + np.outer(mean, offset))
        both = matrix @ second_state @ matrix.T + np.outer(offset, offset)
        both += np.outer(matrix @ mean, offset) + np.outer(offset, matrix @ mean)
        for k, (_, _, _, noise) in enumerate(picked):
            here = slice(k * size, (k + 1) * size)
            both[here, here] += noise
        second += prob * both
    inverse = np.linalg.inv(second - np.outer(first, first))
    gain = (cross - np.outer(mean, first)) @ inverse
    surprise = np.concatenate(detections) - first
    after = cov - gain @ (cross - np.outer(mean, first)).T
    return mean + gain @ surprise, after


def moved(mean, cov, maps):
    """Moments of targets after random affine motions, each drawn by itself.

    Args:
        mean: [N, D].
        cov: [N D, N D].
        maps: Of each target a list of (prob, matrix, offset, cov).
    """
    num, dim = mean.shape
    flat = mean.reshape(-1)
    first, second = np.zeros(num * dim), np.zeros((num * dim, num * dim))
    for picked in itertools.product(*maps):
        prob = np.prod([p for p, *_ in picked])
        matrix, noise = np.zeros_like(second), np.zeros_like(second)
        for n, (_, f, _, q) in enumerate(picked):
            here = slice(n * dim, (n + 1) * dim)
            matrix[here, here], noise[here, here] = f, q
        offset = np.concatenate([b for _, _, b, _ in picked])
        here = matrix @ flat + offset
        first += prob * here
        second += prob * (matrix @ cov @ matrix.T + noise + np.outer(here, here))
    return first.reshape(num, dim), second - np.outer(first, first)


def leaves(mean, cov, motions, sensor, ratios, scans):
    """Scores of all detection sequences, each with the best sequence of models.

    Args:
        mean: [D].
        cov: [D, D].
        motions: Of each scan, a list of (matrix, noise).
        sensor: (matrix, noise).
        ratios: (log P_S, log(1 - P_D), log P_D - log clutter density) of each model.
        scans: Of each the detections, [K, Z].

    Returns:
        {sequence of detections, -1 for none: (score, models, score of the first scan)}
    """
    H, R = sensor
    found = {}
    for past in itertools.product(*[range(-1, len(scan)) for scan in scans]):
        for models in itertools.product(range(len(motions[0])), repeat=len(scans)):
            m, P, score, first = mean, cov, 0.0, None
            for n, (k, s) in enumerate(zip(past, models, strict=True)):
                F, Q = motions[n][s]
                m, P = F @ m, F @ P @ F.T + Q
                survive, missed, detected = ratios[s]
                score += survive
                if k < 0:
                    score += missed
                else:
                    S = H @ P @ H.T + R
                    e = scans[n][k] - H @ m
                    log_det = np.linalg.slogdet(2 * np.pi * S)[1]
                    score += detected - (e @ np.linalg.solve(S, e) + log_det) / 2
                    K = P @ H.T @ np.linalg.inv(S)
                    m, P = m + K @ e, P - K @ H @ P
                first = score if first is None else first
            if past not in found or score > found[past][0] + 1e-9:
                found[past] = (score, models, first)
    return found
