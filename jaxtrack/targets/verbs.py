"""Verbs of a target that follow from others.

>>> import jax.numpy as jnp
>>> from jaxtrack.targets import verbs
>>> absorb = verbs.absorb(
...     correct=lambda params, view, detection: (view + detection) / 2,
...     collapse=lambda log_weight, beliefs: jnp.exp(log_weight) @ beliefs)
>>> print(absorb(None, jnp.log(jnp.array([0.5, 0.5])), jnp.array([0.0, 4.0]), 6.0))
4.0
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack.types import Array, PyTree


def absorb(
    correct: Callable[..., PyTree], collapse: Callable[..., PyTree]
) -> Callable[..., PyTree]:
    """Makes the verb `absorb` of a target from its `correct` and `collapse`."""

    def absorb(
        params: Any, log_weight: Array, views: PyTree, detection: Array
    ) -> PyTree:
        corrected = jax.vmap(correct, (None, 0, None))(params, views, detection)
        return collapse(log_weight, corrected)

    return absorb


def blend(
    correct: Callable[..., PyTree], collapse: Callable[..., PyTree]
) -> Callable[..., PyTree]:
    """Makes the verb `blend` of a target from its `correct` and `collapse`."""

    def blend(
        params: Any, view: PyTree, missed: PyTree, log_weight: Array, detections: Array
    ) -> PyTree:
        each = jax.vmap(correct, (None, None, 0))(params, view, detections)
        # The miss comes first: it is what a collapse of nobody gives back.
        every = jax.tree.map(lambda x, y: jnp.concatenate([x[None], y]), missed, each)
        return collapse(jnp.roll(log_weight, 1), every)

    return blend


def unchanged(params: Any, belief: PyTree, existence_prob: Array) -> PyTree:
    """Is the verb `adapt` of a target in which nothing adapts."""
    del params, existence_prob
    return belief


def no_sample(belief: PyTree) -> Array:
    """Is the verb `effective_size` of a target whose belief is no sample."""
    return jnp.zeros((), jax.tree.leaves(belief)[0].dtype)
