"""Gaussian mixtures and the jump Markov mixture filter, by the book.

A component is (w, m, P), a mixture a list of them, in no particular order. The belief
of the filter is (modes, lost): one mixture per mode, whose weights together add to one,
and the share of the weight that its cap threw away. Yuan 2013, eq. 30 to 36; reduction
as Vo and Ma 2006, Table II, with the spread of the means and the total weight kept.
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
    max_components: int
    prune_threshold: float
    merge_threshold: float


def moment_match(components):
    total = sum(w for w, _, _ in components)
    mean = sum(w * m for w, m, _ in components) / total
    cov = sum(w * (P + np.outer(m - mean, m - mean)) for w, m, P in components) / total
    return mean, cov


def weight_of(components):
    return sum(w for w, _, _ in components)


def scale(components, factor):
    return [(w * factor, m, P) for w, m, P in components]


def prune(components, threshold):
    before = weight_of(components)
    kept = [c for c in components if c[0] / before >= threshold]
    return scale(kept, before / weight_of(kept))


def merge(components, threshold):
    rest, merged = list(components), []
    while rest:
        leader = max(rest, key=lambda c: c[0])
        near, far = [], []
        for c in rest:
            gap = c[1] - leader[1]
            close = gap @ np.linalg.inv(c[2]) @ gap <= threshold
            (near if close or c is leader else far).append(c)
        merged.append((weight_of(near), *moment_match(near)))
        rest = far
    return merged


def keep(components, size):
    """Returns the first components with all the weight, and the share that is lost."""
    before, after = weight_of(components), weight_of(components[:size])
    if not before:
        return [], 0.0
    return scale(components[:size], before / after), 1 - after / before


def cap(components, size):
    return keep(sorted(components, key=lambda c: -c[0]), size)


def reduce(components, size, prune_threshold, merge_threshold):
    """Keeps the clusters with the heaviest leaders, in which order they are made."""
    return keep(merge(prune(components, prune_threshold), merge_threshold), size)


def begin(model, m, P, mode_prob):
    return [[(w, m, P)] if w > 0 else [] for w in mode_prob], 0.0


def normalise(modes):
    total = sum(weight_of(mode) for mode in modes)
    return [scale(mode, 1 / total) for mode in modes], total


def reduce_modes(model, modes):
    """Prunes by the share of the whole weight, then merges mode by mode."""
    modes, _ = normalise(modes)
    heavy = [[c for c in mode if c[0] >= model.prune_threshold] for mode in modes]
    heavy, _ = normalise(heavy)
    reduced, lost = [], 0.0
    for mode in heavy:
        kept, share = keep(merge(mode, model.merge_threshold), model.max_components)
        reduced.append(kept)
        lost += weight_of(mode) * share
    return reduced, lost


def predict(model, belief):
    """Eq. 31 and 32: returns the belief and the probability to survive."""
    modes, _ = belief
    num = len(modes)
    alive = [scale(mode, model.survive[n]) for n, mode in enumerate(modes)]
    _, survived = normalise(alive)
    entered = [
        [c for i in range(num) for c in scale(alive[i], model.p[i, j]) if c[0] > 0]
        for j in range(num)
    ]
    reduced, lost = reduce_modes(model, entered)
    moved = [
        [(w, *book.predict(m, P, model.F[n], 0, model.Q[n])) for w, m, P in mode]
        for n, mode in enumerate(reduced)
    ]
    return (moved, lost), survived


def miss(model, belief):
    modes, lost = belief
    missed = [scale(mode, 1 - model.detect[n]) for n, mode in enumerate(modes)]
    missed, prob = normalise(missed)
    return (missed, lost), prob


def correct(model, belief, z):
    """Eq. 34 and 35: returns the belief and the density of z, detection included."""
    modes, lost = belief
    corrected = []
    for n, mode in enumerate(modes):
        corrected.append([])
        for w, m, P in mode:
            m, P, log_density = book.update(m, P, model.H, 0, model.R, z)
            w = w * model.detect[n] * np.exp(log_density)
            corrected[n].append((w, m, P))
    corrected, density = normalise(corrected)
    return (corrected, lost), density


def collapse(model, weights, beliefs):
    total = sum(weights)
    share = [w / total for w in weights]
    pooled = []
    for n in range(len(beliefs[0][0])):
        pooled.append([])
        for s, (modes, _) in zip(share, beliefs, strict=True):
            pooled[n] += scale(modes[n], s)
    reduced, lost = reduce_modes(model, pooled)
    earlier = sum(s * b[1] for s, b in zip(share, beliefs, strict=True))
    return reduced, lost + (1 - lost) * earlier


def moments(belief):
    return moment_match([c for mode in belief[0] for c in mode])


def mode_prob(belief):
    return np.array([weight_of(mode) for mode in belief[0]])
