"""Bayes' rule by enumeration: of mode sequences, and of association events."""

import itertools

import numpy as np
from reference import kalman as book
from reference.mixture import moment_match


def jump_markov(model, m0, P0, first_mode_prob, detections):
    """Runs a Kalman filter along every sequence of modes; None is a missed detection.

    Returns one row per scan: probability to survive it and density of what was seen,
    given the past; mode probabilities, mean and covariance after it.
    """
    num_modes, rows = len(first_mode_prob), []
    branches = {(n,): (w, m0, P0) for n, w in enumerate(first_mode_prob)}
    for z in detections:
        before = sum(w for w, _, _ in branches.values())
        alive = sum(w * model.survive[path[-1]] for path, (w, _, _) in branches.items())
        grown = {}
        for path, (w, m, P) in branches.items():
            for n in range(num_modes):
                weight = w * model.survive[path[-1]] * model.p[path[-1], n]
                mean, cov = book.predict(m, P, model.F[n], 0, model.Q[n])
                if z is None:
                    weight *= 1 - model.detect[n]
                else:
                    mean, cov, log_g = book.update(mean, cov, model.H, 0, model.R, z)
                    weight *= model.detect[n] * np.exp(log_g)
                grown[(*path, n)] = weight, mean, cov
        branches = grown
        total = sum(w for w, _, _ in branches.values())
        modes = np.zeros(num_modes)
        for path, (w, _, _) in branches.items():
            modes[path[-1]] += w / total
        mean, cov = moment_match(list(branches.values()))
        rows.append((alive / before, total / alive, modes, mean, cov))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def multi_bernoulli(r, detect, g, clutter, rate):
    """Updates independent Bernoulli targets by summing over association events.

    Args:
        r: Existence probabilities, [N].
        detect: Probabilities of detection, [N].
        g: Density of detection k if target n caused it, [N, K].
        clutter: Clutter intensity at each detection, [K].
        rate: Expected number of clutter detections.

    Returns:
        The density of the scan, and the probability that target n exists and was
        missed (column 0) or caused detection k (column k + 1), [N, 1 + K].
    """
    num, count = g.shape
    evidence, causes = 0.0, np.zeros((num, count + 1))
    # A target does not exist (-2), was missed (-1) or caused detection k.
    for event in itertools.product(range(-2, count), repeat=num):
        taken = [k for k in event if k >= 0]
        if len(set(taken)) < len(taken):
            continue
        weight = np.exp(-rate)
        for n, k in enumerate(event):
            if k == -2:
                weight *= 1 - r[n]
            elif k == -1:
                weight *= r[n] * (1 - detect[n])
            else:
                weight *= r[n] * detect[n] * g[n, k]
        for k in range(count):
            if k not in taken:
                weight *= clutter[k]
        evidence += weight
        for n, k in enumerate(event):
            if k >= -1:
                causes[n, k + 1] += weight
    return evidence, causes / evidence
