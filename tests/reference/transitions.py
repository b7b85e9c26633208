"""The transition matrix of a chain over few tables, from proposals that were drawn.

Every outcome of a proposal tells its own probability; when enough were drawn to meet
them all, nothing is left to chance.
"""

import dataclasses

import numpy as np


@dataclasses.dataclass
class Outcome:
    table: tuple
    log_forward: float
    log_backward: float
    possible: bool
    count: int


def hypothesis(table):
    """A table as a set of tracks: rows in any order, none of them empty."""
    return tuple(sorted(tuple(row) for row in table.tolist() if max(row) >= 0))


def outcomes(made, kind, at):
    """What one kind of move made of one table, each outcome once."""
    one = [np.asarray(part[kind, at]) for part in made]
    table, changed, log_forward, log_backward, possible, choice = one
    names = np.concatenate(
        [table.reshape(len(table), -1), changed, choice[:, None]], axis=1
    )
    _, first, count = np.unique(names, axis=0, return_index=True, return_counts=True)
    return [
        Outcome(
            hypothesis(table[k]), log_forward[k], log_backward[k], possible[k], number
        )
        for k, number in zip(first, count, strict=True)
    ]


def matrix(tables, outcomes_of, target):
    """Probabilities to go from each table to each by Metropolis and Hastings."""
    index = {hypothesis(table): k for k, table in enumerate(tables)}
    result = np.zeros((len(tables), len(tables)))
    for at, found in enumerate(outcomes_of):
        for outcome in found:
            if not outcome.possible:
                continue
            to = index[outcome.table]
            ratio = target[to] / target[at]
            ratio *= np.exp(outcome.log_backward - outcome.log_forward)
            result[at, to] += np.exp(outcome.log_forward) * min(1.0, ratio)
        result[at, at] += 1 - result[at].sum()
    return result
