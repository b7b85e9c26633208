"""The likely model set algorithm with given association, by the book of Gomes 2011.

Tables 2, 3 and 5 in their letters, with sets of mode numbers and dictionaries over
them. After a scan a filter knows `known`: {i: (mu, x, P)} over the union set M_k, and
the set for the next scan.
"""

from typing import NamedTuple

import numpy as np


class Model(NamedTuple):
    """F[i], Q[i] move mode i; p[i, j] is the probability to go from i to j."""

    F: list
    Q: list
    H: np.ndarray
    R: np.ndarray
    p: np.ndarray
    detect: float
    t1: float
    t2: float
    K: int


def normal(residual, S):
    size = np.sqrt(np.linalg.det(2 * np.pi * S))
    return np.exp(-residual @ np.linalg.inv(S) @ residual / 2) / size


def mix(model, new, known):
    """Table 5, step 1: {i: (predicted probability, x, P)} for the modes of `new`."""
    mixed = {}
    for i in new:
        c = sum(model.p[j, i] * mu for j, (mu, _, _) in known.items())
        if c == 0:  # nothing can enter: it has no moments
            mixed[i] = (0.0, None, None)
            continue
        share = {j: model.p[j, i] * mu / c for j, (mu, _, _) in known.items()}
        x = sum(share[j] * known[j][1] for j in known)
        gap = {j: known[j][1] - x for j in known}
        P = sum(share[j] * (known[j][2] + np.outer(gap[j], gap[j])) for j in known)
        mixed[i] = (c, x, P)
    return mixed


def see(model, i, x, P, detections):
    """The first half of step 2: what is predicted, with residuals and densities."""
    x, P = model.F[i] @ x, model.F[i] @ P @ model.F[i].T + model.Q[i]
    S = model.H @ P @ model.H.T + model.R
    residuals = [z - model.H @ x for z in detections]
    return x, P, S, residuals, [normal(r, S) for r in residuals]


def update(model, x, P, S, residuals, beta):
    """The second half of step 2, with the probabilities beta of the detections."""
    gain = P @ model.H.T @ np.linalg.inv(S)
    average = sum(b * r for b, r in zip(beta, residuals, strict=True))
    spread = sum(b * np.outer(r, r) for b, r in zip(beta, residuals, strict=True))
    spread = spread - np.outer(average, average)
    updated = P - sum(beta) * gain @ S @ gain.T + gain @ spread @ gain.T
    return x + gain @ average, updated, average


def explained(model, new, known, detections):
    """How well the modes that the association went by explain each, and none."""
    total = np.zeros(len(detections) + 1)
    for i, (mu, x, P) in mix(model, new, known).items():
        if mu > 0:
            *_, densities = see(model, i, x, P, detections)
            chances = [model.detect * d for d in densities] + [1 - model.detect]
            total += mu * np.array(chances)
    return total


def vsimm(model, new, known, detections, beta, by_residual, explained):
    """VSIMM-JPDAF*[new, known]: {i: (mu predicted times likelihood, x, P)}.

    By the residual, a mode's likelihood is the density of the average residual, as
    printed. Else it is the sum of how well it explains each detection, and none,
    against what the association made of them, and each mode has betas of its own.
    """
    found = {}
    for i, (mu, x, P) in mix(model, new, known).items():
        if mu == 0:
            found[i] = (0.0, None, None)
            continue
        x, P, S, residuals, densities = see(model, i, x, P, detections)
        if by_residual:
            x, P, average = update(model, x, P, S, residuals, beta[:-1])
            found[i] = (mu * normal(average, S), x, P)
            continue
        chances = [model.detect * d for d in densities] + [1 - model.detect]
        parts = np.array(beta) * np.array(chances) / explained
        own = parts / parts.sum()
        x, P, _ = update(model, x, P, S, residuals, own[:-1])
        found[i] = (mu * parts.sum(), x, P)
    return found


def fuse(found):
    """Equation 25: probabilities over a set of modes."""
    total = sum(weight for weight, _, _ in found.values())
    return {i: (weight / total, x, P) for i, (weight, x, P) in found.items()}


def adapt(p, mu, t1, t2, K):
    """Table 3, steps 2 to 7, for probabilities {i: mu} of the set M_k.

    Returns:
        The modes to be activated now, and a function of the probabilities over the
        union that gives the set for the next scan.
    """
    principal = {i for i in mu if mu[i] > t2}
    unlikely = {i for i in mu if mu[i] < t1}
    adjacent = {i for i in range(len(p)) if any(p[j, i] > 0 for j in principal)}
    new = adjacent - set(mu)

    def following(union_mu):
        likely = set(union_mu)
        for i in sorted(unlikely - adjacent, key=lambda i: (union_mu[i], i)):
            if len(likely) > K:
                likely.remove(i)
        return likely

    return new, following


def cycle(model, active, known, detections, beta, by_residual):
    """Table 3 with the cycles of Table 5: returns `known` and the next set."""
    against = explained(model, active, known, detections)
    rest = known, detections, beta, by_residual, against
    found = vsimm(model, active, *rest)
    mu = {i: weight for i, (weight, _, _) in fuse(found).items()}
    new, following = adapt(model.p, mu, model.t1, model.t2, model.K)
    found.update(vsimm(model, new, *rest))
    known = fuse(found)
    return known, following({i: mu for i, (mu, _, _) in known.items()})


def moments(known):
    """Table 3, step 4: the overall estimate."""
    real = [k for k in known.values() if k[0] > 0]
    x = sum(mu * x for mu, x, _ in real)
    return x, sum(mu * (P + np.outer(y - x, y - x)) for mu, y, P in real)
