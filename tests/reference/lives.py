"""All lives that targets may have had, one by one: the multi-target posterior.

Stationary targets on a line: a newborn is distributed as any target is at any time, so
that nothing is approximated. Births and deaths are spelled out, scan by scan.
"""

import itertools
import math

import numpy as np


def gauss(z, mean, var):
    return math.exp(-0.5 * (z - mean) ** 2 / var) / math.sqrt(2 * math.pi * var)


def likelihood(track, scans, model):
    """Density of a track's detections, its first state being stationary; and means."""
    transition, stationary = model["transition"], model["stationary"]
    noise = stationary - transition @ stationary @ transition.T
    mean, cov, total, begun = np.zeros(2), stationary.copy(), 1.0, False
    for found, scan in zip(track, scans, strict=True):
        if begun:
            mean, cov = transition @ mean, transition @ cov @ transition.T + noise
        if found >= 0:
            begun = True
            var = cov[0, 0] + model["sensor_var"]
            total *= gauss(scan[found], mean[0], var)
            gain = cov[:, 0] / var
            mean = mean + gain * (scan[found] - mean[0])
            cov = cov - np.outer(gain, cov[0])
    return total, mean


def lives(num_scans, model):
    """(first scan, last scan, expected number); scan -1 is before the first scan."""
    survive = model["survive"]
    for first in range(-1, num_scans):
        number = model["undetected"] if first < 0 else model["births"]
        for last in range(first, num_scans):
            ends = 1.0 if last == num_scans - 1 else 1 - survive
            yield first, last, number * survive ** (last - first) * ends


def seen_so(track, first, last, model):
    """Probability to be detected just when the track says, for such a life."""
    prob = 1.0
    for k, found in enumerate(track):
        there = first <= k <= last
        if found >= 0:
            prob *= model["detect"] if there else 0.0
        elif there:
            prob *= 1 - model["detect"]
    return prob


def weigh(track, scans, model):
    """Expected number of targets with such a track, and of those that still live."""
    density = likelihood(track, scans, model)[0]
    total = alive = 0.0
    for first, last, number in lives(len(scans), model):
        part = number * density * seen_so(track, first, last, model)
        total += part
        alive += part if last == len(scans) - 1 else 0.0
    return total, alive


def tracks_of(scans):
    every = itertools.product(*(range(-1, len(scan)) for scan in scans))
    return [track for track in every if max(track) >= 0]


def hypotheses_of(tracks):
    """All sets of tracks without a common detection, as sorted tuples of tracks."""
    found = [()]
    for track in tracks:
        used = {(k, j) for k, j in enumerate(track) if j >= 0}
        more = []
        for others in found:
            taken = {(k, j) for one in others for k, j in enumerate(one) if j >= 0}
            if not taken & used:
                more.append((*others, track))
        found += more
    return found


def weigh_false(hypothesis, scans, model):
    total = 1.0
    for k, scan in enumerate(scans):
        num = len(scan) - sum(track[k] >= 0 for track in hypothesis)
        if model.get("false_prob") is None:
            total *= math.exp(-model["clutter"]) * model["clutter"] ** num
        else:
            total *= math.factorial(num) * model["false_prob"][num]
        total *= model["false_density"] ** num
    return total


def posterior(scans, model, size):
    """Weights of all hypotheses {tracks: weight}, and of numbers of live targets."""
    tracks = tracks_of(scans)
    weights = {track: weigh(track, scans, model) for track in tracks}
    never = (-1,) * len(scans)
    hidden, hidden_alive = weigh(never, scans, model)
    everyone = sum(number for *_, number in lives(len(scans), model))
    result, numbers = {}, np.zeros(size)
    for hypothesis in hypotheses_of(tracks):
        product = math.prod(weights[track][0] for track in hypothesis)
        alive = [weights[track][1] / weights[track][0] for track in hypothesis]
        false = weigh_false(hypothesis, scans, model)
        count = len(hypothesis)
        if model.get("number_prob") is None:
            factor = math.exp(-(everyone - hidden))
            rest = {
                n: hidden_alive**n * math.exp(-hidden_alive) / math.factorial(n)
                for n in range(size)
            }
        else:
            factor, rest = 0.0, dict.fromkeys(range(size), 0.0)
            for n, prob in enumerate(model["number_prob"]):
                if n < count:
                    continue
                ways = math.perm(n, count) * (hidden / everyone) ** (n - count)
                part = prob * ways / everyone**count
                factor += part
                keep = hidden_alive / hidden
                for kept in range(n - count + 1):
                    chance = math.comb(n - count, kept) * keep**kept
                    rest[kept] += part * chance * (1 - keep) ** (n - count - kept)
            rest = {n: value / factor if factor else 0.0 for n, value in rest.items()}
        weight = product * false * factor
        result[hypothesis] = weight
        known = np.ones(1)
        for prob in alive:
            known = np.convolve(known, [1 - prob, prob])
        later = np.array([rest[n] for n in range(size)])
        numbers += weight * np.convolve(known, later)[:size]
    return result, numbers / sum(result.values())
