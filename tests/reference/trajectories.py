"""The trajectory metric as the linear programme of its paper, loops and all."""

import numpy as np
from scipy.optimize import linprog


def base(x, y, c, p):
    """The distance to the p-th power of two sets with one point each at most."""
    if x is None and y is None:
        return 0.0
    if x is None or y is None:
        return c**p / 2
    return min(c, float(np.linalg.norm(x - y))) ** p


def metric(X, Y, c, gamma, p):
    """Garcia-Fernandez et al. 2020, the relaxation with W of one row and column more.

    X and Y are lists of trajectories, each a list of points or None, one a time.
    """
    n, m, times = len(X), len(Y), len(X[0])
    size = (n + 1) * (m + 1)
    number = times * size

    def w(k, i, j):
        return k * size + i * (m + 1) + j

    def h(k, i, j):
        return number + (k * n + i) * m + j

    total = number + (times - 1) * n * m
    cost = np.zeros(total)
    equal, equals, less = [], [], []
    for k in range(times):
        for i in range(n + 1):
            for j in range(m + 1):
                x = X[i][k] if i < n else None
                y = Y[j][k] if j < m else None
                cost[w(k, i, j)] = base(x, y, c, p)
        for i in range(n):
            row = np.zeros(total)
            row[[w(k, i, j) for j in range(m + 1)]] = 1
            equal.append(row)
            equals.append(1.0)
        for j in range(m):
            row = np.zeros(total)
            row[[w(k, i, j) for i in range(n + 1)]] = 1
            equal.append(row)
            equals.append(1.0)
        corner = np.zeros(total)
        corner[w(k, n, m)] = 1
        equal.append(corner)
        equals.append(0.0)
    for k in range(times - 1):
        for i in range(n):
            for j in range(m):
                cost[h(k, i, j)] = gamma**p / 2
                for sign in (1, -1):
                    row = np.zeros(total)
                    row[w(k + 1, i, j)], row[w(k, i, j)] = sign, -sign
                    row[h(k, i, j)] = -1
                    less.append(row)
    found = linprog(
        cost,
        np.array(less) if less else None,
        np.zeros(len(less)) if less else None,
        np.array(equal),
        np.array(equals),
    )
    return found.fun ** (1 / p)
