"""The interacting multiple model filter of Blom and Bar-Shalom, by the book.

A bank is (mu, m, P): mode probabilities [M] and the moments of each mode. Survival and
detection depend on the mode, as in the jump Markov filters.
"""

import numpy as np
from reference import kalman as book


def mix(bank, p):
    """Returns the mixed bank; p[i, j] is the probability to go from i to j."""
    mu, mean, cov = bank
    num_modes, dim = mean.shape
    c, m0, p0 = np.zeros(num_modes), np.zeros((num_modes, dim)), np.zeros_like(cov)
    for j in range(num_modes):
        for i in range(num_modes):
            c[j] += p[i, j] * mu[i]
        for i in range(num_modes):
            m0[j] += p[i, j] * mu[i] / c[j] * mean[i]
        for i in range(num_modes):
            gap = mean[i] - m0[j]
            p0[j] += p[i, j] * mu[i] / c[j] * (cov[i] + np.outer(gap, gap))
    return c, m0, p0


def predict(model, bank):
    """Returns the bank of those who survived, and the probability to survive."""
    mu, mean, cov = bank
    alive = mu * model.survive
    survived = alive.sum()
    mu, mean, cov = mix((alive / survived, mean, cov), model.p)
    for n in range(len(mu)):
        mean[n], cov[n] = book.predict(mean[n], cov[n], model.F[n], 0, model.Q[n])
    return (mu, mean, cov), survived


def miss(model, bank):
    mu, mean, cov = bank
    missed = mu * (1 - model.detect)
    return (missed / missed.sum(), mean, cov), missed.sum()


def correct(model, bank, z):
    """Returns the bank given a detection, and its density, detection included."""
    mu, mean, cov = (np.array(x) for x in bank)
    for n in range(len(mu)):
        mean[n], cov[n], log_density = book.update(
            mean[n], cov[n], model.H, 0, model.R, z
        )
        mu[n] *= model.detect[n] * np.exp(log_density)
    return (mu / mu.sum(), mean, cov), mu.sum()
