"""One scan of the JPDA and JIPDA filters on a line, by summing over all events."""

import numpy as np
from reference import bruteforce
from reference import kalman as book
from reference.mixture import moment_match


def step(tracks, model, detections, clutter, rate):
    """Predicts and updates tracks that may not exist.

    Args:
        tracks: A list of (existence probability, mean, covariance).
        model: F, Q, H, R, and the probabilities survive and detect.
        detections: [K, Z].
        clutter: Intensity at each detection, [K].
        rate: Expected number of clutter detections.

    Returns:
        The density of the scan, and for each track its existence probability, mean,
        covariance and the probabilities of its being missed or having detection k.
    """
    moved = [
        (r * model.survive, *book.predict(m, P, model.F, 0, model.Q))
        for r, m, P in tracks
    ]
    r = np.array([x[0] for x in moved])
    branches = [
        [book.update(m, P, model.H, 0, model.R, z) for z in detections]
        for _, m, P in moved
    ]
    g = np.array([[np.exp(log_g) for *_, log_g in row] for row in branches])
    g = g.reshape(len(moved), len(detections))
    detect = np.full(len(moved), model.detect)
    density, causes = bruteforce.multi_bernoulli(r, detect, g, clutter, rate)
    result = []
    for (_, m, P), row, cause in zip(moved, branches, causes, strict=True):
        pool = [(cause[0], m, P)]
        pool += [(c, *b[:2]) for c, b in zip(cause[1:], row, strict=True)]
        result.append((cause.sum(), *moment_match(pool), cause))
    return density, result
