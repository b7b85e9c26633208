"""The PHD filter as loops: Vo and Ma 2006, Table I, and Pasha et al. 2009.

A component is (w, m, P, mode), an intensity a list of them; the jump Markov filter
moves every component into every mode. A particle is (w, x) and takes the same update.
Nothing is pruned or merged. Births happen after survival; nobody spawns.
"""

from typing import NamedTuple

import numpy as np
from reference import kalman as book


class Model(NamedTuple):
    """F[n], Q[n] move mode n; p[i, j] is the probability to go from i to j."""

    F: list
    Q: list
    H: np.ndarray
    R: np.ndarray
    p: np.ndarray
    survive: np.ndarray
    detect: np.ndarray


class Clutter(NamedTuple):
    """rate: expected number in a scan; density: z -> density of one of them at z."""

    rate: float
    density: object


def single_model(F, Q, H, R, survive, detect):
    return Model([F], [Q], H, R, np.ones((1, 1)), np.array([survive]), [detect])


def predict(model, components, births):
    """Pasha eq. 21 to 28: the survivors in every mode, then the newborn."""
    predicted = []
    for w, m, P, mode in components:
        for after in range(len(model.F)):
            chance = model.survive[mode] * model.p[mode, after]
            moved = book.predict(m, P, model.F[after], 0, model.Q[after])
            predicted.append((w * chance, *moved, after))
    return predicted + list(births)


def update(model, clutter, components, detections):
    """Returns the missed components, those of each detection, and the log-evidence."""
    table, corrected = look(model, components, detections)
    missed, hits, log_evidence = weigh(clutter, table, detections)
    return *attach(components, corrected, missed, hits), log_evidence


def look(model, components, detections):
    """Rows (w, p_D, densities of the detections), and the corrected moments."""
    table, corrected = [], []
    for w, m, P, mode in components:
        row, moments = [], []
        for z in detections:
            mean, cov, log_g = book.update(m, P, model.H, 0, model.R, z)
            row.append(np.exp(log_g))
            moments.append((mean, cov, mode))
        table.append((w, model.detect[mode], row))
        corrected.append(moments)
    return table, corrected


def attach(components, corrected, missed, hits):
    """Puts new weights to the moments: one missed list, one list a detection."""
    left = [(v, *c[1:]) for v, c in zip(missed, components, strict=True)]
    seen = [
        [(v, *moments[k]) for v, moments in zip(hit, corrected, strict=True)]
        for k, hit in enumerate(hits)
    ]
    return left, seen


def weights(missed, hits):
    """The weights alone, as arrays: missed [i] and hit [i, k]."""
    left = np.array([w for w, *_ in missed])
    seen = np.array([[w for w, *_ in hit] for hit in hits])
    return left, seen.reshape(len(hits), len(missed)).T


def update_particles(detect, likelihood, clutter, particles, detections):
    """The same for particles; detect(x) and likelihood(z, x) are functions."""
    table = look_particles(detect, likelihood, particles, detections)
    missed, hits, log_evidence = weigh(clutter, table, detections)
    states = [x for _, x in particles]
    left = list(zip(missed, states, strict=True))
    return left, [list(zip(hit, states, strict=True)) for hit in hits], log_evidence


def look_particles(detect, likelihood, particles, detections):
    return [
        (w, detect(x), [likelihood(z, x) for z in detections]) for w, x in particles
    ]


def weigh(clutter, table, detections):
    """Vo and Ma eq. 20 and 21: missed weights [i], hit weights [k][i].

    The evidence is that of a Poisson number of targets: what is detected, and what is
    clutter, are independent Poisson processes.
    """
    missed = [w * (1 - p_D) for w, p_D, _ in table]
    log_evidence = -clutter.rate - sum(w * p_D for w, p_D, _ in table)
    hits = []
    for k, z in enumerate(detections):
        claims = [w * p_D * g[k] for w, p_D, g in table]
        total = clutter.rate * clutter.density(z) + sum(claims)
        hits.append([claim / total for claim in claims])
        log_evidence += np.log(total)
    return missed, hits, log_evidence
