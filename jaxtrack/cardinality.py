"""How many targets there are: distributions of a number, as log-probabilities.

Entry n of a distribution [N] is the log-probability of n targets; -inf is impossible.
Larger numbers than N - 1 are left out, so a distribution may sum to less than one.

    born = poisson(rate, size)                          # or bernoullis(prob, size)
    number, lost = add(thin(number, survive_prob), born)
    log_sums = symmetric(log_value, max_order)          # what detections say of it

Everything is a sum of positive terms in logarithms: nothing cancels, and no range of
the values is too wide, in float32 either.

References: Vo, Vo and Cantoni, "Analytic implementations of the cardinalized
probability hypothesis density filter", IEEE Trans. Signal Processing 55(7), 2007,
equations 13 (prediction) and 16 (elementary symmetric functions). That a symmetric
function is found for all sets that lack one value in the time of one needs its
derivative, by the recursion backwards.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import cardinality
    >>> two = jnp.log(jnp.array([0.0, 0.0, 1.0]))
    >>> print(jnp.exp(cardinality.thin(two, jnp.array(0.5))).round(3))
    [0.25 0.5  0.25]
"""

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln

from jaxtrack import mixture
from jaxtrack.linalg import safe_log
from jaxtrack.types import Array


def bernoullis(prob: Array, size: int) -> Array:
    """Returns how many of B independent events happen.

    Args:
        prob: Their probabilities, [B]; 0 marks an empty slot.
        size: N; larger numbers are left out.

    Returns:
        Log-probabilities of 0 to N - 1, [N].
    """
    return symmetric(safe_log(prob), size - 1, safe_log(1 - prob))


def poisson(rate: Array, size: int) -> Array:
    """Returns the log-probabilities of 0 to `size` - 1 for a Poisson number, [size].

    A rate of 0 means none for sure.
    """
    number = jnp.arange(size, dtype=jnp.result_type(rate, float))
    log_rate = jnp.where(number == 0, 0.0, safe_log(rate))
    return number * log_rate - rate - gammaln(number + 1)


def thin(log_prob: Array, keep_prob: Array) -> Array:
    """Keeps each target with a probability, independently of the others.

    Args:
        log_prob: Of 0 to N - 1 targets, [N].
        keep_prob: The same for each. At 0 and 1 the gradient is finite, but lacks the
            terms that only the other side of it has.

    Returns:
        Log-probabilities of those kept, [N].
    """
    (size,) = log_prob.shape
    before, after = jnp.arange(size)[None], jnp.arange(size)[:, None]
    gone = before - after
    log_keep, log_drop = safe_log(keep_prob), safe_log(1 - keep_prob)
    log_way = after * jnp.where(after == 0, 0.0, log_keep)
    log_way = log_way + jnp.maximum(gone, 0) * jnp.where(gone <= 0, 0.0, log_drop)
    log_way = log_way + jnp.asarray(_log_choose(size), log_prob.dtype)
    return _totals(log_way + log_prob[None])


def add(log_prob: Array, other: Array) -> tuple[Array, Array]:
    """Adds two independent numbers.

    Args:
        log_prob: Of 0 to N - 1, [N].
        other: Of 0 to B - 1, [B].

    Returns:
        The log-probabilities of the sum if it is below N, [N], which sum to one; and
        the probability that it is not, or that it was left out of the two numbers. If
        no sum below N is possible all are -inf.
    """
    summed = convolve(log_prob, other)
    kept = mixture.total(summed)
    scale = jnp.where(kept == -jnp.inf, 0.0, kept)
    return summed - scale, jnp.maximum(-jnp.expm1(kept), 0.0)


def convolve(log_value: Array, other: Array) -> Array:
    """Returns the logs of the first N coefficients of a product of polynomials, [N].

    Args:
        log_value: Of the coefficients of the one, [N].
        other: The same of the other, [B].
    """
    rest = jnp.arange(log_value.size)[:, None] - jnp.arange(other.size)[None]
    first = jnp.where(rest >= 0, log_value[jnp.maximum(rest, 0)], -jnp.inf)
    return _totals(first + other[None])


def symmetric(
    log_value: Array, max_order: int, log_other: Array | None = None
) -> Array:
    """Returns the elementary symmetric functions of some values, as logarithms.

    e_j is the sum over all ways to choose j of the values of their product. It is the
    coefficient of x^j in the product of all (other + value x).

    Args:
        log_value: [K]; -inf marks an empty slot.
        max_order: J; may exceed K, then what is beyond is -inf.
        log_other: What counts for a value that is not chosen, [K]; 0 by default, and
            for an empty slot.

    Returns:
        Logarithms of e_0 to e_J, [J + 1].
    """
    log_other = jnp.zeros_like(log_value) if log_other is None else log_other
    chex.assert_equal_shape([log_value, log_other])

    def grow(log_sums: Array, factor: tuple[Array, Array]) -> tuple[Array, None]:
        return _choose(log_sums, *factor), None

    return jax.lax.scan(grow, _nothing(log_value, max_order), (log_value, log_other))[0]


def leave_one_out(
    log_value: Array, log_coefficient: Array, log_other: Array | None = None
) -> Array:
    """Returns a weighted sum of symmetric functions for all sets that lack one value.

    All at once in O(K J): what comes before a value by the recursion of `symmetric`,
    times what comes after it by the recursion's transpose. `vmap` over coefficients
    only: what comes before is then worked out once.

    Args:
        log_value: [K]; -inf marks an empty slot.
        log_coefficient: Of e_0 to e_J, [J + 1].
        log_other: As in `symmetric`.

    Returns:
        Logarithms of sum_j coefficient_j e_j(all values but value k), [K].
    """
    log_other = jnp.zeros_like(log_value) if log_other is None else log_other
    chex.assert_equal_shape([log_value, log_other])

    def grow(log_sums: Array, factor: tuple[Array, Array]) -> tuple[Array, Array]:
        return _choose(log_sums, *factor), log_sums

    def fold(log_worth: Array, factor: tuple[Array, Array]) -> tuple[Array, Array]:
        value, other = factor
        chosen = jnp.append(log_worth[1:], -jnp.inf)
        return _log_add(other + log_worth, value + chosen), log_worth

    factors, nothing = (
        (log_value, log_other),
        _nothing(log_value, log_coefficient.size - 1),
    )
    before = jax.lax.scan(grow, nothing, factors)[1]
    after = jax.lax.scan(fold, log_coefficient, factors, reverse=True)[1]
    return _totals(before + after)


def mean(log_prob: Array) -> Array:
    """Returns the expected number, for log-probabilities [N] of any scale."""
    return mixture.normalise(log_prob) @ jnp.arange(log_prob.size, dtype=log_prob.dtype)


def variance(log_prob: Array) -> Array:
    """Returns the variance of the number, for log-probabilities [N] of any scale."""
    number = jnp.arange(log_prob.size, dtype=log_prob.dtype)
    return mixture.normalise(log_prob) @ (number - mean(log_prob)) ** 2


def likeliest(log_prob: Array) -> Array:
    """Returns the number of the greatest probability (int), of equals the smallest."""
    return jnp.argmax(log_prob)


def _choose(log_sums: Array, log_value: Array, log_other: Array) -> Array:
    """Multiplies a polynomial (logarithms of its coefficients) by other + value x."""
    lower = jnp.concatenate([jnp.full_like(log_sums[:1], -jnp.inf), log_sums[:-1]])
    return _log_add(log_other + log_sums, log_value + lower)


def _nothing(log_value: Array, max_order: int) -> Array:
    """Returns the symmetric functions of no value: log of one, and -inf's."""
    empty = jnp.full(max_order + 1, -jnp.inf, log_value.dtype)
    return empty.at[0].set(0.0)


def _log_add(left: Array, right: Array) -> Array:
    """Returns log(exp(left) + exp(right)), with finite gradients at -inf."""
    low, high = jnp.minimum(left, right), jnp.maximum(left, right)
    share = jnp.exp(low - jnp.where(low == -jnp.inf, 0.0, high))
    return high + jnp.log(1 + share)  # log1p is no better here and far slower


def _totals(log_values: Array) -> Array:
    """Returns the log of the sum of each row, [L, N] -> [L]."""
    return jax.vmap(mixture.total)(log_values)


def _log_choose(size: int) -> np.ndarray:
    """Returns the log of the ways to keep m of n, [m, n] below `size`, float64."""
    log_factorial = np.cumsum(np.log(np.maximum(np.arange(size), 1.0)))
    after, before = np.ogrid[:size, :size]
    ways = log_factorial[before] - log_factorial[after]
    ways = ways - log_factorial[np.maximum(before - after, 0)]
    return np.where(after <= before, ways, -np.inf)
