"""Tests of `learn.information`: standard errors of a given Hessian."""

import numpy as np

from jaxtrack.learn import information


def test_information_about_nothing_is_told_as_such():
    hessian = np.diag([4.0, 0.0])
    np.testing.assert_array_equal(information.std_of(np.eye(2), hessian), [0.5, np.inf])
    np.testing.assert_array_equal(
        information.cov_of(hessian), [[0.25, 0.0], [0.0, np.inf]]
    )


def test_what_is_not_at_a_maximum_has_no_error():
    hessian = np.array([[4.0, 0.0, 0.0], [0.0, 1.0, 2.0], [0.0, 2.0, 1.0]])
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
    # Along (0, 1, 1) the information is 3, and along (0, 1, -1) it is -1.
    expected = [0.5, np.nan, (2 / 3) ** 0.5]
    np.testing.assert_allclose(information.std_of(rows, hessian), expected, rtol=1e-12)
    cov = information.cov_of(hessian)
    np.testing.assert_array_equal(cov, np.diag([0.25, np.nan, np.nan]))


def test_little_negative_information_bears_as_much_as_little_positive():
    """What it would add to the variance counts, not how much lies along it."""
    axis = np.array([1.0, -0.8, 0.05])
    turn = np.linalg.qr(np.stack([axis, [0.8, 1.0, 0.3], [0.1, 0.2, 1.0]], 1))[0]
    for value in 1e-2, 1e-4, 1e-6:
        hessian = turn @ np.diag([-value, 1.0, 1.0]) @ turn.T
        assert np.isnan(information.std_of(np.eye(3), hessian)).all()


def test_what_lies_nearly_aside_of_a_negative_direction_has_an_error():
    slant = 0.05  # of which the square is below a hundredth
    turn = np.array([[1.0, slant], [-slant, 1.0]]) / np.hypot(1.0, slant)
    hessian = turn @ np.diag([1.0, -1.0]) @ turn.T
    value = hessian[0, 0]  # each number alone is measured in its own units
    std = information.std_of(np.eye(2), hessian)
    np.testing.assert_allclose(std[0], value**-0.5, rtol=0.01)
    assert np.isnan(std[1])


def test_the_covariance_is_the_inverse_whatever_the_units():
    root = np.random.default_rng(0).normal(size=(4, 4)) * [1e3, 1.0, 1.0, 1e-3]
    hessian = root.T @ root
    np.testing.assert_allclose(
        information.cov_of(hessian), np.linalg.inv(hessian), rtol=1e-8
    )
    row = np.array([[1e3, -2.0, 0.5, 1e-3]])
    expected = np.sqrt((row @ np.linalg.inv(hessian) @ row.T)[0])
    np.testing.assert_allclose(information.std_of(row, hessian), expected, rtol=1e-8)
