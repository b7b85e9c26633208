"""The CPHD filter as loops: Vo, Vo and Cantoni 2007, Propositions 3 to 6.

Intensities are those of `reference.phd`; beside one goes the list p of probabilities of
0, 1, 2, ... targets. Elementary symmetric functions come from the roots of a
polynomial, by NumPy.
"""

import math

import numpy as np
from reference import phd


def predict_cardinality(p, survive, born):
    """Eq. 13 with <p_S, v> / <1, v> = survive; as many entries as p has."""
    kept = [
        sum(
            math.comb(n, j) * survive**j * (1 - survive) ** (n - j) * p[n]
            for n in range(j, len(p))
        )
        for j in range(len(p))
    ]
    return [
        sum(born[n - j] * kept[j] for j in range(n + 1) if n - j < len(born))
        for n in range(len(p))
    ]


def update(model, clutter, components, p, detections):
    """Returns the missed components, those of each detection, p and log-evidence."""
    table, corrected = phd.look(model, components, detections)
    missed, hits, p, log_evidence = weigh(clutter, table, p, detections)
    return *phd.attach(components, corrected, missed, hits), p, log_evidence


def update_particles(detect, likelihood, clutter, particles, p, detections):
    table = phd.look_particles(detect, likelihood, particles, detections)
    missed, hits, p, log_evidence = weigh(clutter, table, p, detections)
    states = [x for _, x in particles]
    left = list(zip(missed, states, strict=True))
    return left, [list(zip(hit, states, strict=True)) for hit in hits], p, log_evidence


def weigh(clutter, table, p, detections):
    """Eq. 14 to 20: missed weights [i], hit weights [k][i], the new p, evidence."""
    density = [clutter.density(z) for z in detections]
    xi = [
        sum(w * p_D * g[k] / density[k] for w, p_D, g in table)
        for k in range(len(detections))
    ]
    mass = sum(w for w, _, _ in table)
    lost = sum(w * (1 - p_D) for w, p_D, _ in table)

    every = [upsilon(0, n, xi, clutter.rate, mass, lost) for n in range(len(p))]
    total = np.dot(every, p)
    posterior = [y * prior / total for y, prior in zip(every, p, strict=True)]
    apart = [upsilon(1, n, xi, clutter.rate, mass, lost) for n in range(len(p))]
    missed = [np.dot(apart, p) / total * (1 - p_D) * w for w, p_D, _ in table]
    hits = []
    for k in range(len(detections)):
        rest = xi[:k] + xi[k + 1 :]
        without = [upsilon(1, n, rest, clutter.rate, mass, lost) for n in range(len(p))]
        factor = np.dot(without, p) / total / density[k]
        hits.append([factor * p_D * g[k] * w for w, p_D, g in table])
    return missed, hits, posterior, np.log(total) + np.log(density).sum()


def upsilon(u, n, xi, rate, mass, lost):
    """Eq. 18: Upsilon^u of n targets, for |Z| = len(xi) detections."""
    e, total = symmetric(xi), 0.0
    for j in range(min(len(xi), n) + 1):
        if j + u <= n:
            false = len(xi) - j
            clutter = math.factorial(false) * poisson(rate, false)
            left = n - j - u
            ways = math.factorial(n) // math.factorial(left)
            total += clutter * ways * lost**left / mass**n * e[j]
    return total


def symmetric(values):
    """Vieta: the coefficients of a polynomial with these roots, but for their signs."""
    return [(-1) ** j * c for j, c in enumerate(np.atleast_1d(np.poly(values)))]


def poisson(rate, n):
    return np.exp(-rate) * rate**n / math.factorial(n)
