"""The metrics as their papers define them: all pairings tried, loops and all."""

import itertools
import math


def gap(x, y):
    """Euclidean distance of two points."""
    return math.sqrt(sum((a - b) ** 2 for a, b in zip(x, y, strict=True)))


def ospa(X, Y, c, p):
    """Schuhmacher, Vo and Vo 2008, eq. 3, and the parts of section III-C."""
    if len(X) > len(Y):
        X, Y = Y, X
    m, n = len(X), len(Y)
    if n == 0:
        return 0.0, 0.0, 0.0
    least = math.inf
    for chosen in itertools.permutations(range(n), m):
        total = 0.0
        for i in range(m):
            total += min(gap(X[i], Y[chosen[i]]), c) ** p
        least = min(least, total)
    localisation = (least / n) ** (1 / p)
    cardinality = (c**p * (n - m) / n) ** (1 / p)
    return ((least + c**p * (n - m)) / n) ** (1 / p), localisation, cardinality


def partial_pairings(rows, columns):
    """Yields every set of pairs in which no row and no column is twice."""
    if not rows:
        yield []
        return
    for rest in partial_pairings(rows[1:], columns):
        yield rest
    for j in columns:
        for rest in partial_pairings(rows[1:], [k for k in columns if k != j]):
            yield [(rows[0], j), *rest]


def gospa(X, Y, c, p):
    """Rahmathullah et al. 2017, proposition 1 (alpha = 2).

    Returns distance, localisation, missed, false (to the p-th power), their numbers,
    and the pairs.
    """
    best = None
    for pairs in partial_pairings(list(range(len(X))), list(range(len(Y)))):
        localisation = 0.0
        for i, j in pairs:
            localisation += gap(X[i], Y[j]) ** p
        missed = c**p / 2 * (len(X) - len(pairs))
        false = c**p / 2 * (len(Y) - len(pairs))
        total = localisation + missed + false
        if best is None or total < best[0]:
            best = total, localisation, missed, false, pairs
    total, localisation, missed, false, pairs = best
    num_missed, num_false = len(X) - len(pairs), len(Y) - len(pairs)
    distance = total ** (1 / p)
    return distance, localisation, missed, false, num_missed, num_false, pairs


def idf1(frames, max_distance):
    """Ristani et al. 2016: least false positives plus false negatives, then the ratios.

    `frames` holds pairs of dictionaries from identity to position. Returns IDF1, IDP
    and IDR.
    """
    truths = sorted({name for truth, _ in frames for name in truth})
    tracks = sorted({name for _, track in frames for name in track})
    least = math.inf
    for pairs in partial_pairings(truths, tracks):
        partner = dict(pairs)
        owner = {b: a for a, b in pairs}
        fn = fp = tp = 0
        for truth, track in frames:
            for name, position in truth.items():
                other = partner.get(name)
                hit = other in track and gap(position, track[other]) <= max_distance
                tp, fn = tp + hit, fn + (not hit)
            for name, position in track.items():
                other = owner.get(name)
                hit = other in truth and gap(position, truth[other]) <= max_distance
                fp += not hit
        if fn + fp < least:
            least = fn + fp
            scores = 2 * tp / (2 * tp + fp + fn), tp / (tp + fp), tp / (tp + fn)
    return scores


def switches(frames, max_distance):
    """Bernardin and Stiefelhagen 2008, steps 1 and 2 of section 2.1.3.

    Returns the number of switches and of matches.
    """
    num_switches = num_matches = 0
    mapping, when = {}, {}
    for time, (truth, track) in enumerate(frames):
        kept = {}
        for name in sorted(mapping, key=when.get, reverse=True):
            label = mapping[name]
            if name not in truth or label not in track or label in kept.values():
                continue
            if gap(truth[name], track[label]) <= max_distance:
                kept[name] = label

        best = 0, 0.0, []
        free_truths = [name for name in truth if name not in kept]
        free_tracks = [label for label in track if label not in kept.values()]
        for pairs in partial_pairings(free_truths, free_tracks):
            far = [gap(truth[a], track[b]) for a, b in pairs]
            if all(d <= max_distance for d in far):
                best = min(best, (-len(pairs), sum(far), pairs))
        for name, label in best[2]:
            if name in mapping and mapping[name] != label:
                num_switches += 1
        for name, label in [*kept.items(), *best[2]]:
            mapping[name], when[name] = label, time
            num_matches += 1
    return num_switches, num_matches
