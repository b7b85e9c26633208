"""Which hypothesis of a mixture of multi-Bernoullis to report, and which tracks of it.

- `heaviest`: the likeliest hypothesis, and its tracks that exist with more than a
  threshold;
- `number`: the likeliest number of tracks that exist, over all hypotheses; then the
  likeliest hypothesis with so many, those of them that are likeliest to exist;
- `certain`: the likeliest hypothesis if each says of every track whether it exists.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import estimators
    >>> prob = jnp.array([0.4, 0.6])
    >>> there = jnp.array([[1.0, 1.0], [0.9, 0.55]])
    >>> for name in estimators.NAMES:
    ...     row, exists = estimators.choose(name, prob, there, threshold=0.6)
    ...     print(name, row, exists)
    heaviest 1 [ True False]
    number 0 [ True  True]
    certain 0 [ True  True]

Reference: Garcia-Fernandez, Williams, Granstrom and Svensson, "Poisson multi-Bernoulli
mixture filter: direct derivation and implementation", IEEE Trans. Aerospace and
Electronic Systems 54(4), 2018, section VI-C (estimators 1, 2 and 3).
"""

import jax
import jax.numpy as jnp

from jaxtrack.linalg import safe_log
from jaxtrack.types import Array

NAMES = "heaviest", "number", "certain"


def check(estimator: str) -> None:
    """Raises a ValueError for an estimator that there is not."""
    if estimator not in NAMES:
        raise ValueError(f"estimator is {estimator!r}; give one of {', '.join(NAMES)}")


def choose(
    estimator: str, prob: Array, there: Array, threshold: float
) -> tuple[Array, Array]:
    """Chooses a hypothesis and its tracks.

    Args:
        estimator: One of `NAMES`.
        prob: Of the hypotheses, [H].
        there: How likely each track is to exist in each, [H, N].
        threshold: Of "heaviest"; the others need none.

    Returns:
        Which hypothesis, and which tracks to report, [N] (bool).
    """
    prob, there = jax.lax.stop_gradient((prob, there))
    if estimator == "heaviest":
        row = jnp.argmax(prob)
        return row, there[row] > threshold
    if estimator == "certain":
        likelier = safe_log(jnp.maximum(there, 1 - there)).sum(1)
        row = jnp.argmax(safe_log(prob) + likelier)
        return row, there[row] > 0.5
    likely, order = jax.lax.top_k(there, there.shape[1])
    number = jnp.argmax((prob[:, None] * numbers(there)).sum(0))
    chosen = (jnp.arange(there.shape[1]) < number)[None]
    with_them = safe_log(jnp.where(chosen, likely, 1 - likely)).sum(1)
    row = jnp.argmax(safe_log(prob) + with_them)
    none = jnp.zeros(there.shape[1], bool)
    return row, none.at[order[row]].set(chosen[0])


def numbers(there: Array) -> Array:
    """Returns the probabilities of 0 to N tracks that exist, [H, N + 1].

    Args:
        there: How likely each track is to exist in each hypothesis, [H, N].
    """
    none = jnp.zeros((there.shape[0], there.shape[1] + 1), there.dtype)

    def add(prob: Array, one: Array) -> tuple[Array, None]:
        more = jnp.pad(prob[:, :-1], ((0, 0), (1, 0)))
        return prob * (1 - one)[:, None] + more * one[:, None], None

    return jax.lax.scan(add, none.at[:, 0].set(1.0), there.T)[0]
