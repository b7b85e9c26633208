"""Free numbers for what has only some values, against the formulas in plain NumPy."""

import functools
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from cases import slopes

from jaxtrack.learn import supports

COV = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 0.0]])
MATRIX = np.array([[0.7, 0.1, 0.2], [0.0, 0.4, 0.6], [1.0, 0.0, 0.0]])


def softmax(x):
    return np.exp(x) / np.exp(x).sum()


def covariance(x):
    """Of the two components of COV that move."""
    std = np.diag(np.exp([x[0], x[2]]))
    lower = std @ np.array([[1.0, 0.0], [x[1], 1.0]])
    return np.pad(lower @ lower.T, ((0, 1), (0, 1)))


def rows(x):
    """Of MATRIX, whose largest entries have the free number 0."""
    first = softmax(np.array([0.0, x[0], x[1]]))
    second = softmax(np.array([x[2], 0.0]))
    return np.stack([first, [0.0, *second], [1.0, 0.0, 0.0]])


def jumps(x):
    return np.array(
        [[0.3, *softmax(np.array([0.0, x[0]]))], [1.0, 0.0, 0.0], [0.0, 1.0, 0.9]]
    )


class Row(NamedTuple):
    """A value of some kind, other free numbers, and what those stand for.

    In the numbers the largest entry of a simplex, or of real numbers, is the one that
    is largest in the value: they are told by it.
    """

    kind: Any
    base: Any
    free: Any
    expected: Any
    bounds: Any = supports.Bounds()


TABLE = {
    "real": Row(
        "real",
        np.array([-4.0, 0.0, 2.0]),
        np.array([0.5, -1.0, 0.25]),
        lambda x: 4 * x,
    ),
    "a mean beside its covariance": Row(
        "real",
        np.array([7.0, 0.0, 1.0]),
        np.array([0.5, -1.0, 3.0]),
        lambda x: x * [2.0, 3.0, 1.0],
        supports.Bounds(cov=COV),
    ),
    "positive": Row(
        "positive",
        np.array([0.3, 0.0, 5.0]),
        np.array([0.5, -1.0]),
        lambda x: np.array([np.exp(x[0]), 0.0, np.exp(x[1])]),
    ),
    "probability": Row(
        "probability",
        np.array([0.3, 0.0, 1.0, 0.9]),
        np.array([0.5, -1.0]),
        lambda x: np.array([1 / (1 + np.exp(-x[0])), 0, 1, 1 / (1 + np.exp(-x[1]))]),
    ),
    "probability above another": Row(
        "probability",
        np.array(0.3),
        np.array([0.5]),
        lambda x: 0.2 + 0.8 / (1 + np.exp(-x[0])),
        supports.Bounds(low=0.2),
    ),
    "probability below another": Row(
        "below",
        np.array(0.3),
        np.array([0.5]),
        lambda x: 0.4 / (1 + np.exp(-x[0])),
        supports.Bounds(high=0.4),
    ),
    "simplex": Row("simplex", MATRIX, np.array([-0.5, -1.0, -0.3]), rows),
    "simplex of rounded numbers": Row(
        "simplex",
        np.array([0.333333, 0.333333, 0.333333]),
        np.array([-0.5, -1.0]),
        lambda x: 0.999999 * softmax(np.array([0.0, *x])),
    ),
    "jumps": Row(
        "jumps",
        np.array([[0.3, 0.6, 0.4], [1.0, 0.0, 0.0], [0.0, 1.0, 0.9]]),
        np.array([-0.7]),
        jumps,
    ),
    "covariance": Row("covariance", COV, np.array([0.5, -1.0, 0.3]), covariance),
}


@functools.cache
def found():
    """For each kind: of the base's own numbers, of others, and the slopes of those."""

    def of(name, x):
        kind, base, _, _, bounds = TABLE[name]
        return supports.constrain(kind, base, x, supports.places(kind, base), bounds)

    def every(numbers):
        return {name: of(name, x) for name, x in numbers.items()}

    own = {
        name: supports.unconstrain(
            row.kind, row.base, supports.places(row.kind, row.base), row.bounds
        )
        for name, row in TABLE.items()
    }
    others = {name: row.free for name, row in TABLE.items()}

    def all_of(own, others):
        jacobian = {
            name: jax.jacrev(functools.partial(of, name))(x)
            for name, x in others.items()
        }
        return every(own), every(others), jacobian

    return jax.tree.map(np.array, jax.jit(all_of)(own, others))


every_kind = pytest.mark.parametrize("name", TABLE)


@every_kind
def test_a_value_comes_back_from_its_own_numbers(name):
    np.testing.assert_allclose(found()[0][name], TABLE[name].base, rtol=1e-14)


@every_kind
def test_other_numbers_stand_for_what_the_formula_says(name):
    expected = TABLE[name].expected(TABLE[name].free)
    np.testing.assert_allclose(found()[1][name], expected, rtol=1e-14)


@every_kind
def test_numbers_come_back_from_their_value(name):
    kind, base, free, expected, bounds = TABLE[name]
    place = supports.places(kind, base)
    back = supports.unconstrain(kind, expected(free), place, bounds)
    np.testing.assert_allclose(back, free, rtol=1e-13)


@every_kind
def test_slopes_are_right(name):
    free, expected = TABLE[name].free, TABLE[name].expected
    moved = free + np.concatenate([np.eye(free.size), -np.eye(free.size)]) * 1e-6
    difference = slopes.differences([expected(x) for x in moved], 1e-6)
    slope = np.moveaxis(found()[2][name], -1, 0)
    # Values of some 10 have 1e-15 by rounding, differences divide it by the step.
    np.testing.assert_allclose(slope, difference, rtol=1e-8, atol=1e-8)
