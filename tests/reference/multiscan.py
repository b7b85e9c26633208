"""All selections of one leaf for each tree, one by one."""

import numpy as np


def selections(log_score, detection):
    """Lists every selection that is possible: its leaves, and its score."""
    num_trees = len(log_score)
    options = [np.flatnonzero(np.isfinite(row)) for row in log_score]

    def grow(tree, leaves, taken, total):
        if tree == num_trees:
            yield tuple(leaves), total
            return
        if not len(options[tree]):
            yield from grow(tree + 1, [*leaves, -1], taken, total)
        for leaf in options[tree]:
            mine = {(s, k) for s, k in enumerate(detection[tree, leaf]) if k >= 0}
            if not mine & taken:
                score = total + log_score[tree, leaf]
                yield from grow(tree + 1, [*leaves, int(leaf)], taken | mine, score)

    yield from grow(0, [], frozenset(), 0.0)


def draw(rng, num_trees, num_leaves, num_scans, num_detections, rounded=False):
    """Draws a problem: crowded, some leaves missing, some trees empty or unsafe."""
    shape = num_trees, num_leaves, num_scans
    detection = rng.integers(0, num_detections, shape)
    detection[rng.random(shape) < 0.3] = -1
    log_score = (detection >= 0).sum(-1) + 2 * rng.normal(size=shape[:2])
    safe = rng.random(num_trees) < 0.8
    detection[safe, 0] = -1
    log_score[safe, 0] = 0
    log_score[rng.random(shape[:2]) < 0.2] = -np.inf
    log_score[rng.random(num_trees) < 0.1] = -np.inf
    if rounded:
        log_score = np.round(log_score / 2)
    return log_score, detection


def feasible(leaf, log_score, detection):
    """Tells whether a selection is possible, and its score."""
    seen, total = set(), 0.0
    for tree, chosen in enumerate(leaf):
        if chosen < 0:
            if np.isfinite(log_score[tree]).any():
                return False, -np.inf
            continue
        mine = {(s, k) for s, k in enumerate(detection[tree, chosen]) if k >= 0}
        if mine & seen or not np.isfinite(log_score[tree, chosen]):
            return False, -np.inf
        seen |= mine
        total += log_score[tree, chosen]
    return True, total
