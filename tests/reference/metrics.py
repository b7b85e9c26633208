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

    Returns the number of switches and of matches, and the distances of these.
    """
    num_switches = num_matches = 0
    distances = []
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
            distances.append(gap(truth[name], track[label]))
    return num_switches, num_matches, distances


def track_distance(f, g, c, q, weight):
    """Beard, Vo and Vo 2020: the base distance of two lists of points or None."""
    total = share = 0.0
    for x, y, w in zip(f, g, weight, strict=True):
        if x is None and y is None:
            continue
        share += w
        both = x is not None and y is not None
        total += w * (min(gap(x, y), c) if both else c) ** q
    return (total / share) ** (1 / q) if share else 0.0


def ospa2(F, G, c, p, q, weight):
    """Beard, Vo and Vo 2020: OSPA with the base distance above, all pairings tried."""
    F, G = (
        [
            f
            for f in X
            if any(x is not None for x, w in zip(f, weight, strict=True) if w)
        ]
        for X in (F, G)
    )
    if len(F) > len(G):
        F, G = G, F
    m, n = len(F), len(G)
    if n == 0:
        return 0.0
    least = math.inf
    for chosen in itertools.permutations(range(n), m):
        total = 0.0
        for i in range(m):
            total += track_distance(F[i], G[chosen[i]], c, q, weight) ** p
        least = min(least, total)
    return ((least + c**p * (n - m)) / n) ** (1 / p)


def hota(frames, c):
    """Luiten et al. 2021 for similarities max(0, 1 - d / c), all matchings tried.

    A(c) of a true positive is written out. Returns the means over 19 thresholds of
    HOTA, DetA and AssA.
    """

    def similarity(x, y):
        return max(0.0, 1 - gap(x, y) / c)

    shared, of_truth, of_track = {}, {}, {}
    for truth, track in frames:
        for a in truth:
            of_truth[a] = of_truth.get(a, 0) + 1
        for b in track:
            of_track[b] = of_track.get(b, 0) + 1
        for a in truth:
            for b in track:
                here = similarity(truth[a], track[b])
                around = sum(similarity(truth[k], track[b]) for k in truth)
                around += sum(similarity(truth[a], track[k]) for k in track) - here
                if around > 0:
                    shared[a, b] = shared.get((a, b), 0.0) + here / around

    matched = []
    for truth, track in frames:
        best = -1.0, []
        for pairs in partial_pairings(list(truth), list(track)):
            worth = 0.0
            for a, b in pairs:
                together = shared.get((a, b), 0.0)
                fit = together / (of_truth[a] + of_track[b] - together)
                worth += fit * similarity(truth[a], track[b])
            if worth > best[0]:
                best = worth, pairs
        matched.append([(a, b, similarity(truth[a], track[b])) for a, b in best[1]])

    sums = [0.0, 0.0, 0.0]
    for k in range(1, 20):
        hits = [(a, b) for pairs in matched for a, b, s in pairs if s >= k / 20]
        quality = 0.0
        for a, b in hits:
            tpa = sum(hit == (a, b) for hit in hits)
            quality += tpa / (of_truth[a] + of_track[b] - tpa)
        tp = len(hits)
        everything = sum(of_truth.values()) + sum(of_track.values()) - tp
        scores = math.sqrt(quality / everything), tp / everything, quality / max(tp, 1)
        sums = [x + y / 19 for x, y in zip(sums, scores, strict=True)]
    return sums
