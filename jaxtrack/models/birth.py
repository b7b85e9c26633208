"""Births: where new targets appear, known beforehand or told by the last scan.

`MultiBernoulliBirth` is at most one target from each of B places, `PoissonBirth` any
number; `DetectionBirth` proposes places from the detections that no target explained.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.birth import DetectionBirth
    >>> from jaxtrack.models.motion import ConstantVelocity
    >>> from jaxtrack.models.sensor import Position
    >>> birth = DetectionBirth(rate=0.2, max_existence_prob=0.1,
    ...     velocity_std=jnp.ones(1), extra_std=jnp.zeros(0), mode_prob=jnp.ones(1))
    >>> places = birth.propose(Position(jnp.ones(1)), ConstantVelocity(jnp.ones(1)),
    ...     detections=jnp.array([[4.0], [9.0], [0.0]]),
    ...     valid=jnp.array([True, True, False]),
    ...     unexplained_prob=jnp.array([0.3, 0.9, 1.0]), interval=0.5)
    >>> print(places.existence_prob, places.mean[1])
    [0.025 0.075 0.   ] [9. 0.]

Reference: Reuter, Vo, Vo and Dietmayer, "The labeled multi-Bernoulli filter", IEEE
Trans. Signal Processing 62(12), 2014 (the adaptive birth distribution).
"""

from typing import Annotated, Any, NamedTuple

import chex
import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.constraints import Covariance, Positive, Probability, Simplex, spread_by
from jaxtrack.models.sensor import Timed
from jaxtrack.types import Array, Gaussian, PyTree


class MultiBernoulliBirth(NamedTuple):
    """At most one new target per scan at each of B places.

    Attributes:
        existence_prob: Probability that one is born there in a scan, [B].
        mean: Its expected state, [B, D].
        cov: Its covariance, [B, D, D].
        mode_prob: Its mode, [B, M].
    """

    existence_prob: Probability
    mean: Annotated[Array, spread_by("cov")]
    cov: Covariance
    mode_prob: Simplex


class PoissonBirth(NamedTuple):
    """A Poisson number of new targets per scan around each of B places.

    Attributes:
        rate: Expected number born there in a scan, [B].
        mean: Their expected state, [B, D].
        cov: Their covariance, [B, D, D].
        mode_prob: Their mode, [B, M].
    """

    rate: Positive
    mean: Annotated[Array, spread_by("cov")]
    cov: Covariance
    mode_prob: Simplex

    def at_most_one(self) -> MultiBernoulliBirth:
        """Returns births of at most one target a place, as likely as any here.

        The number born at a place is then too small by rate + exp(-rate) - 1.
        """
        prob = -jnp.expm1(-self.rate)
        return MultiBernoulliBirth(prob, self.mean, self.cov, self.mode_prob)


class DetectionBirth(NamedTuple):
    """Expects new targets where the last scan's unexplained detections were.

    Attributes:
        rate: Expected number of new targets per second, a scalar.
        max_existence_prob: No single place is believed in more than this, a scalar.
        velocity_std: Velocities are N(0, velocity_std^2), m/s, [P].
        extra_std: The same for all further state components, in their order, [E]
            (one turn rate, or P accelerations; empty if there are none).
        mode_prob: Mode of a new target, [M].
    """

    rate: Positive
    max_existence_prob: Probability
    velocity_std: Positive
    extra_std: Positive
    mode_prob: Simplex

    def propose(
        self,
        sensor: PyTree,
        motion: PyTree,
        detections: Array,
        valid: Array,
        unexplained_prob: Array,
        interval: Array,
    ) -> MultiBernoulliBirth:
        """Places one possible target at each detection of a scan.

        The expected number of births, rate * interval, is shared among the detections
        in proportion to how likely each is to stem from no known target.

        Args:
            sensor: A sensor that can locate.
            motion: The motion model whose state is wanted, of D components.
            detections: [K, Z].
            valid: Which of them are there, [K].
            unexplained_prob: Probability that no known target caused it, [K].
            interval: Seconds in which the targets may be born.

        Returns:
            K places; that of an invalid detection has existence 0 and finite moments.
        """
        num = len(detections)
        chex.assert_shape([valid, unexplained_prob], (num,))
        unexplained = jnp.where(valid, unexplained_prob, 0.0)
        total = unexplained.sum()
        share = unexplained / jnp.where(total > 0, total, 1.0)
        existence_prob = jnp.minimum(
            self.max_existence_prob, self.rate * interval * share
        )
        detections = jnp.where(valid[:, None], detections, 0.0)
        located = jax.vmap(sensor.locate)(detections)
        timed = isinstance(sensor, Timed)
        age = detections[:, -1] if timed else jnp.zeros(num, detections.dtype)
        prior = jax.vmap(self._prior, (None, 0, 0))(motion, located, age)
        mode_prob = jnp.tile(self.mode_prob, (num, 1))
        return MultiBernoulliBirth(existence_prob, *prior, mode_prob)

    def _prior(self, motion: PyTree, place: Gaussian, age: Array) -> Gaussian:
        """Returns the state [D] of a new target, given the belief about its place."""
        dim, where, further = motion.dim, motion.position_index, further_index(motion)
        chex.assert_shape(self.velocity_std, (len(motion.velocity_index),))
        chex.assert_shape(self.extra_std, (len(further),))
        mean: list[Any] = [0.0] * dim
        cov: list[list[Any]] = [[0.0] * dim for _ in range(dim)]
        for a, i in enumerate(where):
            mean[i] = place.mean[a]
            for b, j in enumerate(where):
                cov[i][j] = place.cov[a, b]
        for a, (p, v) in enumerate(zip(where, motion.velocity_index, strict=True)):
            # It has gone on for `age` seconds since it was seen, nobody knows where to.
            speed_var = self.velocity_std[a] ** 2
            cov[v][v] = speed_var
            cov[p][v] = cov[v][p] = age * speed_var
            cov[p][p] = cov[p][p] + age**2 * speed_var
        for a, i in enumerate(further):
            cov[i][i] = self.extra_std[a] ** 2
        return Gaussian(linalg.rows([mean])[0], linalg.rows(cov))


def further_index(motion: PyTree) -> list[int]:
    """Returns where the components stand that are no position and no velocity."""
    known = {*motion.position_index, *motion.velocity_index}
    return [i for i in range(motion.dim) if i not in known]


def likeliest(
    births: MultiBernoulliBirth, max_births: int
) -> tuple[MultiBernoulliBirth, Array]:
    """Keeps the likeliest places.

    Args:
        births: Any number of places, at least one.
        max_births: Places kept; where there are fewer, some stay empty.

    Returns:
        `max_births` places, and the expected number of births that found no room.
    """
    prob = births.existence_prob
    if (short := max_births - prob.size) > 0:
        prob = jnp.concatenate([prob, jnp.zeros(short, prob.dtype)])
    likely, kept = jax.lax.top_k(prob, max_births)
    places = jax.tree.map(
        lambda x: x[jnp.minimum(kept, births.existence_prob.size - 1)], births
    )
    return places._replace(existence_prob=likely), prob.sum() - likely.sum()
