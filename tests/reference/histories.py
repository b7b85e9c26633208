"""What trajectory filters know, by listing all hypotheses and all lives.

Stationary targets on a line, as in `lives`. A hypothesis has one history of each track:
the detections that it had, with a weight for each scan after which it may have ended,
and one for that it never was. Xia et al. 2019: sections III (Poisson births), IV
(multi-Bernoulli births), and appendix C, where every end is a history of its own.
"""

import math
from typing import NamedTuple

import numpy as np
from reference import lives


class History(NamedTuple):
    """One of a track: detections (-1 for none), and weights against their clutter."""

    track: tuple
    never: float
    ends: np.ndarray  # by the scan after which it ended, [S]
    begun: np.ndarray  # by the scan of birth, the first entry being before, [S + 1]
    since: int  # the first scan of its path

    @property
    def weight(self):
        return self.never + self.ends.sum()

    @property
    def alive_prob(self):
        """That it was there, in each scan of the path, [S]."""
        after = np.cumsum(self.ends[::-1])[::-1] / self.weight
        return np.where(np.arange(len(after)) >= self.since, after, 0.0)


def first_of(track):
    return next(k for k, j in enumerate(track) if j >= 0)


def weigh(track, scans, model, births):
    """Weights by the end [S] and by the birth [S + 1] of a target with such a track."""
    density = lives.likelihood(track, scans, model)[0]
    clutter = (model["clutter"] * model["false_density"]) ** sum(k >= 0 for k in track)
    ends, begun = np.zeros(len(scans)), np.zeros(len(scans) + 1)
    for first, last, number in births:
        seen = lives.seen_so(track, first, last, model)
        if last >= 0:
            ends[last] += number * density * seen / clutter
            begun[first + 1] += number * density * seen / clutter
    return ends, begun


def poisson(scans, model):
    """A list of histories for each detection, None where another track has it."""
    births = list(lives.lives(len(scans), model))
    trees = {(t, k): [None] for t, scan in enumerate(scans) for k in range(len(scan))}
    for track in lives.tracks_of(scans):
        t = first_of(track)
        once = sum(k >= 0 for k in track) == 1
        ends, begun = weigh(track, scans, model, births)
        trees[t, track[t]].append(History(track, float(once), ends, begun, t))
    return list(trees.values())


def born(scans, model, certain):
    """A list of histories for each birth."""
    survive, prob, num = model["survive"], model["prob"], len(scans)
    trees = []
    for t in range(num):
        lasts = range(t, num)
        births = [
            (t, e, prob * survive ** (e - t) * (1 - survive if e < num - 1 else 1))
            for e in lasts
        ]
        options = []
        for track in [(-1,) * num, *lives.tracks_of(scans)]:
            if max(track[:t], default=-1) >= 0:
                continue
            never = float(max(track) < 0) * (1 - prob)
            ends, begun = weigh(track, scans, model, births)
            options.append(History(track, never, ends, begun, t))
        trees.append([one for h in options for one in apart(h)] if certain else options)
    return trees


def apart(history):
    """The same, told by when it ended."""
    if history.never:
        yield history._replace(ends=0 * history.ends, begun=0 * history.begun)
    for last in np.flatnonzero(history.ends):
        yield history._replace(
            never=0.0,
            ends=np.where(np.arange(len(history.ends)) == last, history.ends, 0),
        )


def forgotten(options):
    """The same, where those that are no more are told by their detections alone."""
    gone = {}
    for one in options:
        if one.alive_prob[-1] > 0:
            yield one
        else:
            gone.setdefault(one.track, []).append(one)
    for same in gone.values():
        never = sum(one.weight for one in same)
        yield same[0]._replace(never=never, ends=0 * same[0].ends)


def hypotheses(trees, scans, everything):
    """(weight, histories) of all; with `everything` each detection has one track."""
    total = sum(map(len, scans))

    def extend(rest, used):
        if not rest:
            if not everything or len(used) == total:
                yield 1.0, ()
            return
        for one in rest[0]:
            mine = (
                set() if one is None else {p for p in enumerate(one.track) if p[1] >= 0}
            )
            if mine & used:
                continue
            weight = 1.0 if one is None else one.weight
            for other, more in extend(rest[1:], used | mine):
                yield weight * other, (one, *more)

    return list(extend(trees, set()))


class Known(NamedTuple):
    """What is known after the last scan."""

    log_evidence: float
    prob: np.ndarray  # of the hypotheses, best first
    best: tuple  # a history for each track, or None
    existence_prob: np.ndarray  # that each target is there now, [N]
    num_prob: np.ndarray  # of 0, 1, ... targets now


def posterior(scans, model, kind, most, alive_only=False):
    """Lists all hypotheses: "poisson", "multi-Bernoulli" or "certain"."""
    if kind == "poisson":
        trees = poisson(scans, model)
        never = (-1,) * len(scans)
        hidden, alive = lives.weigh(never, scans, model)
        found = sum(n for *_, n in lives.lives(len(scans), model)) - hidden
    else:
        trees, alive, found = born(scans, model, kind == "certain"), 0.0, 0.0
    if kind == "certain" and alive_only:
        trees = [list(forgotten(options)) for options in trees]
    listed = hypotheses(trees, scans, kind == "poisson")
    listed.sort(key=lambda one: -one[0])
    weight = np.array([w for w, _ in listed])
    prob = weight / weight.sum()
    clutter = sum(map(len, scans)) * math.log(model["clutter"] * model["false_density"])
    constant = clutter - model["clutter"] * len(scans) - found
    there = np.array(
        [[0.0 if h is None else h.alive_prob[-1] for h in rest] for _, rest in listed]
    )
    numbers = np.zeros(most)
    rest = [math.exp(-alive) * alive**n / math.factorial(n) for n in range(most)]
    for share, row in zip(prob, there, strict=True):
        number = np.array(rest)
        for r in row:
            number = np.convolve(number, [1 - r, r])[:most]
        numbers += share * number
    return Known(
        math.log(weight.sum()) + constant, prob, listed[0][1], prob @ there, numbers
    )


def smoothed(track, first, last, scans, model):
    """Means and covariances of the states of a life, given its detections."""
    F, P, size = model["transition"], model["stationary"], last - first + 1
    every = np.zeros((2 * size, 2 * size))
    for s in range(size):
        for t in range(s, size):
            cross = np.linalg.matrix_power(F, t - s) @ P
            every[2 * t : 2 * t + 2, 2 * s : 2 * s + 2] = cross
            every[2 * s : 2 * s + 2, 2 * t : 2 * t + 2] = cross.T
    seen = [k for k in range(first, last + 1) if track[k] >= 0]
    at = np.array([2 * (k - first) for k in seen], int)
    places = np.array([scans[k][track[k]] for k in seen])
    inner = every[np.ix_(at, at)] + model["sensor_var"] * np.eye(len(at))
    gain = every[:, at] @ np.linalg.inv(inner)
    mean, cov = gain @ places, every - gain @ every[at]
    blocks = [slice(2 * k, 2 * k + 2) for k in range(size)]
    return np.array([mean[b] for b in blocks]), np.array([cov[b, b] for b in blocks])


def path(history, scans, model):
    """Moments in each scan of the path if it was there then, over all ends."""
    num, since = len(scans), history.since
    means, seconds = np.zeros((num, 2)), np.zeros((num, 2, 2))
    shares = np.zeros(num)
    for last in np.flatnonzero(history.ends):
        mean, cov = smoothed(history.track, since, last, scans, model)
        here, share = slice(since, last + 1), history.ends[last]
        means[here] += share * mean
        seconds[here] += share * (cov + mean[:, :, None] * mean[:, None])
        shares[here] += share
    safe = np.where(shares > 0, shares, 1.0)
    means, seconds = means / safe[:, None], seconds / safe[:, None, None]
    return means, seconds - means[:, :, None] * means[:, None]
