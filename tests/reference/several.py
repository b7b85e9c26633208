"""Bayes' rule for targets on a line that two sensors see, by enumeration."""

import itertools

import numpy as np


def independent(r, tables):
    """Configurations of targets that exist with probabilities r: (weight, tables)."""
    for there in itertools.product((False, True), repeat=len(r)):
        weight = np.prod([x if t else 1 - x for x, t in zip(r, there, strict=True)])
        yield weight, [x for x, t in zip(tables, there, strict=True) if t]


def identical(p, share, tables):
    """Configurations of n targets with probability p[n], each of any component."""
    one = sum(w * x for w, x in zip(share, tables, strict=True))
    for n, weight in enumerate(p):
        yield weight, [one] * n


def density(mean, variance, seen):
    """Of the detections (z, noise variance) of one target, all together."""
    z = np.array([z for z, _ in seen])
    cov = np.full((len(seen), len(seen)), variance) + np.diag([v for _, v in seen])
    gap = z - mean
    exponent = -gap @ np.linalg.solve(cov, gap) / 2 if len(seen) else 0.0
    return np.exp(exponent) / np.sqrt(np.linalg.det(2 * np.pi * cov))


def table(mean, variance, sensors):
    """How likely a target causes detection i of one and j of the other; last: none."""
    likely = np.zeros([len(s[4]) + 1 for s in sensors])
    for event in np.ndindex(likely.shape):
        seen, weight = [], 1.0
        for k, (detect, noise, _, _, z) in zip(event, sensors, strict=True):
            weight *= detect if k < len(z) else 1 - detect
            seen += [(z[k], noise)] if k < len(z) else []
        likely[event] = weight * density(mean, variance, seen)
    return likely


def explain(tables, taken, sensors):
    """Sums over what the targets cause; what nobody has caused is clutter."""
    if not tables:
        value = 1.0
        for used, (_, _, clutter, rate, z) in zip(taken, sensors, strict=True):
            value *= np.exp(-rate) * clutter ** (len(z) - len(used))
        return value
    total, first = 0.0, tables[0]
    for event in np.ndindex(first.shape):
        hit = [k < len(s[4]) for k, s in zip(event, sensors, strict=True)]
        if any(h and k in t for h, k, t in zip(hit, event, taken, strict=True)):
            continue
        more = [t | {k} if h else t for h, k, t in zip(hit, event, taken, strict=True)]
        total += first[event] * explain(tables[1:], more, sensors)
    return total


def update(prior, sensors):
    """Sums over all events.

    Args:
        prior: Configurations, (weight, tables of the targets).
        sensors: (probability of detection, noise variance, intensity of clutter, its
            expected number, detections) of each.

    Returns:
        The density of all scans and the probabilities of 0, 1, ... 9 targets.
    """
    number = np.zeros(10)
    for weight, tables in prior:
        number[len(tables)] += weight * explain(tables, [set(), set()], sensors)
    return number.sum(), number / number.sum()
