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


def kept_apart(prob, leaf, existence_prob):
    """Probabilities of all sets of leaves whose targets are there."""
    found = {}
    for weight, row in zip(prob, leaf, strict=True):
        known = there(row, existence_prob)
        at = [tree for tree, r in enumerate(known) if r > 0]
        for who in itertools.product((False, True), repeat=len(at)):
            odds = [
                known[tree] if here else 1 - known[tree]
                for tree, here in zip(at, who, strict=True)
            ]
            alive = [(t, row[t]) for t, here in zip(at, who, strict=True) if here]
            key = frozenset(alive)
            found[key] = found.get(key, 0.0) + weight * math.prod(odds)
    return found


def recursion(model, scans):
    """Bayes' recursion over sets of targets, each born at its place or known before.

    A set is told by who is in it and which detections each had, and summed over those
    that are no more. Returns the probability of each, with means, and the log-evidence.

    model: transition, noise, survive, detect, clutter (rate), false_density,
    sensor_var, births and start: lists of (probability, mean, cov) on a line.
    """
    known = [(f"start {k}", *one) for k, one in enumerate(model["start"])]
    sets = {key: (w, s) for key, w, s in _begun(known, {})}
    evidence = 0.0
    for number, places in enumerate(scans):
        sets = _moved(model, sets)
        new = [(f"{number} {k}", *one) for k, one in enumerate(model["births"])]
        sets = _summed(
            (key | more, weight * w, {**state, **s})
            for key, (weight, state) in sets.items()
            for more, w, s in _begun(new, {})
        )
        sets = _summed(
            one
            for key, (weight, state) in sets.items()
            for one in _seen(model, sorted(key), weight, state, list(places))
        )
        total = sum(weight for weight, _ in sets.values())
        evidence += math.log(total)
        sets = {key: (weight / total, state) for key, (weight, state) in sets.items()}
    return sets, evidence


def _begun(places, state):
    """Every way in which some of these are there: key, probability, beliefs."""
    if not places:
        return [(frozenset(), 1.0, dict(state))]
    (name, prob, mean, cov), *rest = places
    found = []
    for key, weight, own in _begun(rest, state):
        found.append((key, weight * (1 - prob), own))
        member = name, ()
        found.append((key | {member}, weight * prob, {**own, member: (mean, cov)}))
    return found


def _moved(model, sets):
    """Who survives moves."""
    F, Q = model["transition"], model["noise"]
    found = []
    for key, (weight, state) in sets.items():
        for size in range(len(key) + 1):
            for alive in itertools.combinations(sorted(key), size):
                w = model["survive"] ** size * (1 - model["survive"]) ** (
                    len(key) - size
                )
                own = {m: (F @ state[m][0], F @ state[m][1] @ F.T + Q) for m in alive}
                found.append((frozenset(alive), weight * w, own))
    return _summed(found)


def _seen(model, members, weight, state, places, taken=()):
    """Every way in which each is missed or has a detection of its own."""
    if not members:
        false = len(places) - len(taken)
        clutter = model["clutter"] * model["false_density"]
        yield frozenset(), weight * math.exp(-model["clutter"]) * clutter**false, {}
        return
    first, *rest = members
    name, past = first
    mean, cov = state[first]
    for k in [None, *range(len(places))]:
        if k is not None and k in taken:
            continue
        if k is None:
            factor, own, more = 1 - model["detect"], (mean, cov), taken
        else:
            spread = cov[0, 0] + model["sensor_var"]
            gap = places[k] - mean[0]
            density = math.exp(-(gap**2) / spread / 2) / math.sqrt(2 * math.pi * spread)
            gain = cov[:, 0] / spread
            own = mean + gain * gap, cov - np.outer(gain, gain) * spread
            factor, more = model["detect"] * density, (*taken, k)
        now = name, (*past, -1 if k is None else k)
        for key, w, states in _seen(model, rest, weight, state, places, more):
            yield key | {now}, w * factor, {**states, now: own}


def _summed(found):
    """Adds up what is about the same set."""
    sets = {}
    for key, weight, state in found:
        before = sets.get(key, (0.0, state))
        sets[key] = before[0] + weight, state
    return sets
