"""Models: tuples of learnable values whose pure methods give functions and matrices.

Write `models.motion.ConstantVelocity(...)`; exchanging a model never touches a tracker.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import models
    >>> models.motion.ConstantVelocity(noise_density=jnp.ones(2)).dim
    4
"""

from jaxtrack.models import (
    acceleration,
    birth,
    clutter,
    converted,
    motion,
    pairs,
    polar,
    probability,
    rest,
    sensor,
    special,
    switching,
    trig,
    turn,
)

__all__ = [
    "acceleration",
    "birth",
    "clutter",
    "converted",
    "motion",
    "pairs",
    "polar",
    "probability",
    "rest",
    "sensor",
    "special",
    "switching",
    "trig",
    "turn",
]
