"""Mixtures of multi-Bernoullis in plain NumPy: numbers, places, and who is there."""

import itertools
import math

import numpy as np


def there(leaf, existence_prob):
    """How likely each track of a hypothesis is to exist: leaf [N], prob [N, L]."""
    return [
        existence_prob[tree, own] if own >= 0 else 0.0 for tree, own in enumerate(leaf)
    ]


def numbers(prob, leaf, existence_prob, hidden, most):
    """Probabilities of 0 to `most` targets, `hidden` of them expected and Poisson."""
    poisson = np.array(
        [math.exp(-hidden) * hidden**n / math.factorial(n) for n in range(most + 1)]
    )
    total = np.zeros(most + 1)
    for weight, row in zip(prob, leaf, strict=True):
        number = poisson.copy()
        for r in there(row, existence_prob):
            number = np.convolve(number, [1 - r, r])[: most + 1]
        total += weight * number
    return total


def intensity(state):
    """Expected number of targets of each tree, and their mean: [R, N], [R, N, D]."""
    weight = np.exp(state.hypotheses.log_weight)
    trees = state.trees
    runs, num, size = trees.existence_prob.shape
    share = np.zeros((runs, num, size))
    for r, n, leaf in itertools.product(range(runs), range(num), range(size)):
        has = state.hypotheses.leaf[r, :, n] == leaf
        share[r, n, leaf] = weight[r, has].sum() * trees.existence_prob[r, n, leaf]
    total = share.sum(2)
    mean = (share[..., None] * trees.belief.mean).sum(2)
    return total, mean / np.where(total > 0, total, 1.0)[..., None]


def expanded(prob, leaf, existence_prob):
    """Probabilities of all hypotheses that say of each track whether it exists."""
    found = []
    for weight, row in zip(prob, leaf, strict=True):
        known = [r for r in there(row, existence_prob) if r > 0]
        for who in itertools.product((0, 1), repeat=len(known)):
            odds = [r if here else 1 - r for r, here in zip(known, who, strict=True)]
            found.append(weight * math.prod(odds))
    return found
