"""Bayes' rule for a set of targets, by enumeration of who caused what.

Before the scan the targets are independent and identically distributed: n of them with
probability p[n], each from component i of a mixture with probability share[i]. Each is
missed, or causes one detection; all other detections are Poisson clutter.
"""

import itertools

import numpy as np


def update(p, share, detect, g, clutter, rate):
    """Sums over all events.

    Args:
        p: Probabilities of 0 to max targets, [max + 1].
        share: Of the components, summing to one, [N].
        detect: Probabilities of detection, [N].
        g: Density of detection k from component i, [N, K].
        clutter: Intensity of clutter at each detection, [K].
        rate: Expected number of clutter detections.

    Returns:
        The density of the scan, the new p, and the posterior intensity as weights:
        missed [N], and hit by detection k [N, K].
    """
    count = len(clutter)
    evidence, number = 0.0, np.zeros(len(p))
    missed, hits = np.zeros(len(share)), np.zeros((len(share), count))
    # A target is of component i, and missed (-1) or the cause of detection k.
    fates = list(itertools.product(range(len(share)), range(-1, count)))
    for n in range(len(p)):
        for event in itertools.product(fates, repeat=n):
            taken = [k for _, k in event if k >= 0]
            if len(set(taken)) < len(taken):
                continue
            weight = p[n] * np.exp(-rate)
            for i, k in event:
                weight *= share[i]
                weight *= detect[i] * g[i, k] if k >= 0 else 1 - detect[i]
            for k in range(count):
                weight *= 1.0 if k in taken else clutter[k]
            evidence += weight
            number[n] += weight
            for i, k in event:
                if k >= 0:
                    hits[i, k] += weight
                else:
                    missed[i] += weight
    return evidence, number / evidence, missed / evidence, hits / evidence
