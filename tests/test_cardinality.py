"""Distributions of a number against enumeration, SciPy, and exact fractions."""

import fractions
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats

from jaxtrack import cardinality


def by_enumeration(value, other):
    """Sums of products over all choices, by the number chosen."""
    sums = np.zeros(value.size + 1)
    for choice in itertools.product([False, True], repeat=value.size):
        sums[sum(choice)] += np.prod(np.where(choice, value, other))
    return sums


SCALE = 200  # of a value as an integer: 2**200 makes any above 1e-44 exact


def exact_symmetric(values, max_order):
    """e_j 2**(SCALE j) for j from 0 to J, as integers: no rounding at all."""
    sums = [1] + [0] * max_order
    for value in values:
        for j in range(max_order, 0, -1):
            sums[j] += value * sums[j - 1]
    return sums


def integer(log_value):
    """exp of a log, as the float that it is, times 2**SCALE."""
    return int(fractions.Fraction(math.exp(float(log_value))) * 2**SCALE)


def log_of(number, order):
    """Undoes the scale; math.log takes integers of any size."""
    return math.log(number) - order * SCALE * math.log(2)


def wide(kind, count=300):
    """Logs of values from 1e-30 to 1e30 in random order, and the values themselves."""
    rng = np.random.default_rng(5)
    log_value = np.log(10) * rng.permutation(np.linspace(-30, 30, count))
    log_value = log_value.astype(kind)
    return log_value, [integer(x) for x in log_value]


def test_symmetric_is_the_sum_over_all_choices():
    rng = np.random.default_rng(0)
    value, other = rng.uniform(0.1, 3, (2, 20, 5))
    value[0, 1], value[1], other[2, 3] = 0, 0, 0

    def both(log_value, log_other):
        plain = cardinality.symmetric(log_value, 7)
        return plain, cardinality.symmetric(log_value, 3, log_other)

    with np.errstate(divide="ignore"):
        plain, mixed = jax.jit(jax.vmap(both))(np.log(value), np.log(other))
    for k in range(20):
        expected = by_enumeration(value[k], np.ones(5))
        np.testing.assert_allclose(np.exp(plain[k, :6]), expected, rtol=1e-13)
        assert np.isneginf(plain[k, 6:]).all()
        expected = by_enumeration(value[k], other[k])[:4]
        np.testing.assert_allclose(np.exp(mixed[k]), expected, rtol=1e-13)


@pytest.mark.parametrize("size", [0, 1, 2, 8])
def test_leave_one_out_is_the_weighted_sum_without_it(size):
    rng = np.random.default_rng(1)
    value, other = rng.uniform(0.1, 3, (2, 10, 5))
    weight = rng.uniform(0, 2, (10, size + 1))
    value[0, 1], value[1], other[2, 3], weight[:3, 0] = 0, 0, 0, 0
    with np.errstate(divide="ignore"):
        log = np.log(value), np.log(weight), np.log(other)
    without = jax.jit(jax.vmap(cardinality.leave_one_out))(*log)
    for i in range(10):
        for k in range(5):
            sums = np.zeros(size + 5)
            sums[:5] = by_enumeration(np.delete(value[i], k), np.delete(other[i], k))
            with np.errstate(divide="ignore"):
                expected = np.log(weight[i] @ sums[: size + 1])
            # Absolute, too: the log of a sum near one is near zero, and a rounding of
            # the sum is then one of any relative size.
            np.testing.assert_allclose(without[i, k], expected, rtol=1e-12, atol=1e-13)


# Relative, and absolute where a log is near zero after others of thousands.
TOLERANCE = {"float64": (1e-13, 1e-10), "float32": (3e-6, 1e-4)}


@pytest.mark.parametrize("kind", TOLERANCE)
def test_three_hundred_values_over_sixty_decades_are_right(kind):
    rtol, atol = TOLERANCE[kind]
    log_value, exact = wide(kind)
    expected = [log_of(x, j) for j, x in enumerate(exact_symmetric(exact, 300))]
    found = jax.jit(cardinality.symmetric, static_argnums=1)(log_value, 300)
    assert found.dtype == kind
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=atol)


@pytest.mark.parametrize("kind", TOLERANCE)
def test_leaving_one_of_three_hundred_out_is_right(kind):
    """The higher the order, the less it counts: many orders matter. One is missing."""
    rtol, atol = TOLERANCE[kind]
    log_value, exact = wide(kind)
    order = np.arange(33)
    log_weight = (-68.0 * order + 0.03 * order**2).astype(kind)
    log_weight[3] = -np.inf
    without = jax.jit(cardinality.leave_one_out)(log_value, log_weight)
    assert np.isfinite(without).all()
    for k in (0, 7, int(log_value.argmax()), int(log_value.argmin())):
        rest = [x for i, x in enumerate(exact) if i != k]
        sums = [log_of(x, j) for j, x in enumerate(exact_symmetric(rest, 32))]
        expected = special.logsumexp(log_weight.astype(float) + sums)
        np.testing.assert_allclose(without[k], expected, rtol=rtol, atol=atol)


def test_all_alike_and_huge_are_binomial():
    found = cardinality.symmetric(np.full(300, 600.0), 300)
    order = np.arange(301)
    expected = [math.log(math.comb(300, j)) for j in order] + 600.0 * order
    np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_bernoullis_are_the_sum_of_events():
    prob = np.array([0.3, 1.0, 0.0, 0.9, 0.01])
    found = jax.jit(cardinality.bernoullis, static_argnums=1)(prob, 8)
    expected = by_enumeration(prob, 1 - prob)
    # Absolute: what is impossible comes out as exactly zero.
    np.testing.assert_allclose(np.exp(found[:6]), expected, rtol=1e-13, atol=0)
    assert np.isneginf(found[6:]).all()
    np.testing.assert_allclose(cardinality.bernoullis(prob, 3), found[:3], rtol=1e-13)


@pytest.mark.parametrize("rate", [0.0, 1e-9, 0.3, 40.0])
def test_poisson_is_scipys(rate):
    found = cardinality.poisson(jnp.array(rate), 60)
    expected = stats.poisson.logpmf(np.arange(60), rate)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("keep_prob", [0.0, 1e-9, 0.3, 0.98, 1.0])
def test_thinning_is_binomial(keep_prob):
    rng = np.random.default_rng(2)
    before = rng.dirichlet(np.ones(40))
    before[7] = 0
    with np.errstate(divide="ignore"):
        found = jax.jit(cardinality.thin)(np.log(before), keep_prob)
    number = np.arange(40)
    way = stats.binom.pmf(number[:, None], number[None], keep_prob)
    np.testing.assert_allclose(np.exp(found), way @ before, rtol=1e-11, atol=0)


@pytest.mark.parametrize(("size", "births"), [(12, 5), (5, 12), (40, 40)])
def test_numbers_add_as_numpy_convolves(size, births):
    rng = np.random.default_rng(3)
    left, right = rng.dirichlet(np.ones(size)), rng.dirichlet(np.ones(births))
    left[2] = right[0] = 0
    with np.errstate(divide="ignore"):
        found, lost = jax.jit(cardinality.add)(np.log(left), np.log(right))
    summed = np.convolve(left, right)[:size]
    np.testing.assert_allclose(lost, 1 - summed.sum(), rtol=1e-12)
    # Absolute: sums that are impossible come out as exactly zero.
    np.testing.assert_allclose(np.exp(found), summed / summed.sum(), rtol=1e-12, atol=0)


def test_impossible_sums_stay_finite_in_gradient():
    nobody, many = np.array([0.0, -np.inf]), np.full(2, -np.inf)

    def lost(log_prob):
        found, lost = cardinality.add(log_prob, many)
        return lost, found

    (share, found), slope = jax.jit(jax.value_and_grad(lost, has_aux=True))(nobody)
    assert np.isneginf(found).all()
    assert share == 1
    assert np.isfinite(slope).all()


def test_moments_and_the_likeliest():
    log_prob = np.array([-np.inf, -1.0, 0.5, 0.5, -3.0])
    prob = np.exp(log_prob) / np.exp(log_prob).sum()
    number = np.arange(5)
    mean = prob @ number
    np.testing.assert_allclose(cardinality.mean(log_prob), mean, rtol=1e-14)
    np.testing.assert_allclose(
        cardinality.variance(log_prob), prob @ (number - mean) ** 2, rtol=1e-13
    )
    assert cardinality.likeliest(log_prob) == 2


def everything(log_value, survive, rate, log_prob):
    """A number that all functions share in."""
    number = cardinality.thin(log_prob, survive)
    number, lost = cardinality.add(number, cardinality.poisson(rate, 6))
    events = jnp.stack([survive / 2, rate, survive * rate])
    number, _ = cardinality.add(number, cardinality.bernoullis(events, 6))
    without = cardinality.leave_one_out(log_value, number)
    sums = cardinality.symmetric(log_value, 3)
    return without.sum() + lost + sums[2] + cardinality.variance(number)


def test_gradients_are_the_finite_differences():
    rng = np.random.default_rng(4)
    log_value, log_prob = rng.normal(size=5) * 3, np.log(rng.dirichlet(np.ones(6)))
    log_value[2] = log_prob[3] = -np.inf

    def flat(given):
        return everything(given[:5], given[5], given[6], given[7:])

    given = np.concatenate([log_value, [0.9, 0.2], log_prob])
    slope = jax.jit(jax.grad(flat))(given)
    steps = 1e-6 * np.eye(given.size)
    ends = jax.jit(jax.vmap(flat))(np.concatenate([given - steps, given + steps]))
    known = np.isfinite(given)
    assert (slope[~known] == 0).all()
    expected = (ends[given.size :] - ends[: given.size]) / 2e-6
    # Absolute, for slopes near zero: the rounding of numbers near ten is 1e-15, which a
    # step of 1e-6 makes 1e-9 a term.
    np.testing.assert_allclose(slope[known], expected[known], rtol=1e-6, atol=1e-8)


def test_gradients_are_finite_at_the_edges():
    log_prob = np.array([-np.inf, 0.0, -np.inf, -np.inf])
    log_value = np.array([-np.inf, 3.0, -200.0])

    def evidence(keep_prob, rate, log_value, log_prob):
        number = cardinality.thin(log_prob, keep_prob)
        number, _ = cardinality.add(number, cardinality.poisson(rate, 4))
        events = cardinality.bernoullis(jnp.stack([keep_prob, rate]), 3)
        number, _ = cardinality.add(number, events)
        return cardinality.leave_one_out(log_value, number)[1]

    slope = jax.vmap(jax.grad(evidence, argnums=(0, 1, 2, 3)), (0, 0, None, None))
    keep_prob, rate = np.array([0, 0, 1, 1.0]), np.array([0, 0.5, 0, 0.5])
    slopes = jax.jit(slope)(keep_prob, rate, log_value, log_prob)
    assert all(np.isfinite(slope).all() for slope in slopes)
