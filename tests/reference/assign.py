"""All joint events of tracks and detections, one by one."""

import itertools

import numpy as np


def events(log_score):
    """Lists every joint event that is possible: its columns, and its log-weight."""
    num_tracks, miss = len(log_score), log_score.shape[1] - 1
    options = [np.flatnonzero(row > -np.inf) for row in log_score]
    for columns in itertools.product(*options):
        taken = [k for k in columns if k < miss]
        if len(set(taken)) == len(taken):
            total = sum(log_score[n, columns[n]] for n in range(num_tracks))
            yield columns, total


def marginals(log_score):
    """Sums over all joint events.

    Returns the probability of each column for each track, and the log of the sum of
    all weights.
    """
    listed = list(events(log_score))
    if not listed:
        return np.zeros(log_score.shape), -np.inf
    top = max(total for _, total in listed)
    prob = np.zeros(log_score.shape)
    for columns, total in listed:
        for n, k in enumerate(columns):
            prob[n, k] += np.exp(total - top)
    norm = sum(np.exp(total - top) for _, total in listed)
    return prob / norm, top + np.log(norm)


def best(log_score):
    """Returns the largest log-weight of a joint event, -inf if there is none."""
    return max((total for _, total in events(log_score)), default=-np.inf)


def scores(rng, num_tracks, num_detections, gate):
    """Draws log-scores, each detection within a track's gate with a probability."""
    log_score = 3 * rng.normal(size=(num_tracks, num_detections + 1))
    outside = rng.random((num_tracks, num_detections)) > gate
    log_score[:, :-1][outside] = -np.inf
    return log_score
