"""The GM-MM-CBMeMBer filter as loops: Yuan 2013, eq. 30 to 36, and Algorithm 1.

A track is (r, belief, name), with the beliefs of `reference.mixture`; a name is (label,
alias or None, label shown). The denominators
are those of Vo, Vo and Cantoni 2009. Labels, parents and capacities follow the rules
that `jaxtrack.trackers.cbmember` documents.
"""

from typing import NamedTuple

import numpy as np
from reference import mixture


class Settings(NamedTuple):
    max_tracks: int
    max_parents: int
    max_updated: int
    prune_threshold: float
    report_threshold: float


class Scene(NamedTuple):
    """births: list of (r, m, P, mode_prob); clutter: intensity; rate: its integral."""

    births: list
    clutter: float
    rate: float


def step(model, scene, settings, tracks, detections, next_label):
    """Returns the tracks, the next free label, log-evidence and what was dropped."""
    tracks, next_label = predict(model, scene, tracks, next_label)
    legacy, log_evidence = miss(model, tracks)
    updated = []
    for z in detections:
        track, log_density = update(model, scene, settings, tracks, z)
        updated.append(track)
        log_evidence += log_density
    tracks, dropped = keep(settings, legacy, updated)
    tracks, next_label = tell_apart(settings, tracks, next_label)
    return tracks, next_label, log_evidence - scene.rate, dropped


def predict(model, scene, tracks, next_label):
    predicted = []
    for r, belief, name in tracks:
        belief, survived = mixture.predict(model, belief)
        predicted.append((r * survived, belief, name))
    for r, m, P, mode_prob in scene.births:
        name = next_label, None, next_label
        predicted.append((r, mixture.begin(model, m, P, mode_prob), name))
        next_label += 1
    return predicted, next_label


def miss(model, tracks):
    """The legacy tracks of eq. 34, and the log-probability that none was detected."""
    legacy, log_none = [], 0.0
    for r, belief, name in tracks:
        missed, prob = mixture.miss(model, belief)
        detected = 1 - prob
        log_none += np.log(1 - r * detected)
        legacy.append((r * (1 - detected) / (1 - r * detected), missed, name))
    return legacy, log_none


def update(model, scene, settings, tracks, z):
    """The updated track of eq. 34, and the log of the detection's intensity."""
    numerator, denominator, hits = 0.0, scene.clutter, []
    for r, belief, name in tracks:
        detected = 1 - mixture.miss(model, belief)[1]
        corrected, density = mixture.correct(model, belief, z)
        numerator += (1 - r) * r * density / (1 - r * detected) ** 2
        denominator += r * density / (1 - r * detected)
        hits.append((r / (1 - r) * density, corrected, name))
    hits.sort(key=lambda hit: -hit[0])
    parents = hits[: settings.max_parents]
    weights = [w for w, _, _ in parents]
    belief = mixture.collapse(model, weights, [b for _, b, _ in parents])
    share = 1 - sum(weights) / sum(w for w, _, _ in hits)
    belief = belief[0], share + (1 - share) * belief[1]
    return (numerator / denominator, belief, parents[0][2]), np.log(denominator)


def keep(settings, legacy, updated):
    """Caps the updated tracks, then all; returns those kept and what was dropped."""
    limit, by_chance = settings.prune_threshold, lambda track: -track[0]
    legacy = [t for t in legacy if t[0] >= limit]
    updated = sorted((t for t in updated if t[0] >= limit), key=by_chance)
    most = settings.max_updated
    likely = sorted(legacy + updated[:most], key=by_chance)
    kept, gone = likely[: settings.max_tracks], likely[settings.max_tracks :]
    dropped = sum(r for r, _, _ in gone + updated[most:])
    dropped += sum(r * belief[1] for r, belief, _ in kept)
    return kept, dropped


def tell_apart(settings, tracks, next_label):
    """Rivals of an heir to a label are shown under an alias, which they keep."""
    heirs, aliases, named = {}, set(), []
    shows = [r > settings.report_threshold for r, _, _ in tracks]
    for only_unnamed in (True, False):
        for n, (_, _, (label, alias, _)) in enumerate(tracks):
            if shows[n] and (alias is None or not only_unnamed):
                heirs.setdefault(label, n)
    for n, (r, belief, (label, alias, _)) in enumerate(tracks):
        shown = label
        if shows[n] and heirs[label] != n:
            if alias is None or alias in aliases:
                alias, next_label = next_label, next_label + 1
            aliases.add(alias)
            shown = alias
        named.append((r, belief, (label, alias, shown)))
    return named, next_label
