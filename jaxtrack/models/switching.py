"""Markov switching between motion modes.

`log_transition(interval)` is log p [M, M], p[i, j] = P(mode j now | mode i before);
rows sum to one, and what cannot happen is -inf. `adjacent()` says which mode may be
left straight for which, [M, M] (bool), the same way round.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.switching import SojournSwitching
    >>> modes = SojournSwitching(mean_sojourn=jnp.array([10.0, 5.0]),
    ...                          jump_prob=jnp.array([[0.0, 1.0], [1.0, 0.0]]))
    >>> print((1000 * jnp.exp(modes.log_transition(1.0))).round())
    [[914.  86.]
     [173. 827.]]

Reference for continuous time: Jensen, "Markoff chains as an aid in the study of Markoff
processes", Scandinavian Actuarial Journal 1953 (uniformisation).
"""

from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.constraints import Jumps, Positive, Simplex
from jaxtrack.types import Array

TERMS = 16  # of the exponential series, for arguments up to 1
SQUARINGS = 10  # so that intervals up to 1024 shortest sojourns are exact


class MarkovSwitching(NamedTuple):
    """Switches between scans, with the same probabilities whatever the interval.

    Attributes:
        transition: p[i, j] = P(mode j now | mode i before), rows sum to one, [M, M].
    """

    transition: Simplex

    def log_transition(self, interval: Array) -> Array:
        """Returns log p, [M, M]."""
        del interval
        return linalg.safe_log(linalg.floating(self.transition))

    def adjacent(self) -> Array:
        """Returns which mode may follow which in the next scan, [M, M]."""
        return jnp.asarray(self.transition) > 0


class SojournSwitching(NamedTuple):
    """Switches in continuous time, so that two half intervals equal a whole one.

    Attributes:
        mean_sojourn: Mean seconds until a mode is left, [M].
        jump_prob: Where it then goes, rows summing to one off the diagonal, which is
            not looked at, [M, M].
    """

    mean_sojourn: Positive
    jump_prob: Jumps

    def log_transition(self, interval: Array) -> Array:
        """Returns the log of the matrix exponential of rate * interval, [M, M].

        Summed from terms that are not negative, so that even the smallest
        probabilities have all their digits and none is below zero.
        """
        num = len(self.mean_sojourn)
        chex.assert_shape(self.jump_prob, (num, num))
        t = linalg.floating(interval) / 2**SQUARINGS
        eye = jnp.eye(num, dtype=t.dtype)
        leaving = self.jump_prob * (1 - eye) * (t / self.mean_sojourn)[:, None]
        total = leaving.sum(1)
        # A shift of the diagonal only scales the exponential, and rows are scaled to
        # one anyway.
        shift = jax.lax.stop_gradient(total.max())
        step = leaving + eye * (shift - total)[:, None]

        def term(i: Array, partial: Array) -> Array:
            return eye + step @ partial / (TERMS - i)

        def square(_: Array, partial: Array) -> Array:
            partial = partial @ partial
            return partial / partial.sum(1, keepdims=True)

        prob = jax.lax.fori_loop(0, TERMS, term, eye)
        prob = prob / prob.sum(1, keepdims=True)
        return linalg.safe_log(jax.lax.fori_loop(0, SQUARINGS, square, prob))

    def adjacent(self) -> Array:
        """Returns which mode may be left for which by one jump, and itself, [M, M]."""
        jump_prob = jnp.asarray(self.jump_prob)
        return (jump_prob > 0) | jnp.eye(len(jump_prob), dtype=bool)
