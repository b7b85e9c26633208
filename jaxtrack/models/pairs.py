"""Births from two points: detections of two scans that one target may have caused.

    >>> import jax.numpy as jnp
    >>> from jaxtrack.models.motion import ConstantVelocity
    >>> from jaxtrack.models.pairs import PairBirth
    >>> from jaxtrack.models.sensor import Position
    >>> birth = PairBirth(rate=0.2, max_existence_prob=0.1, max_speed=5.0,
    ...     extra_std=jnp.zeros(0), mode_prob=jnp.ones(1))
    >>> places = birth.propose(Position(jnp.ones(1)), ConstantVelocity(jnp.ones(1)),
    ...     jnp.array([[2.0], [90.0]]), jnp.ones(2),
    ...     earlier=jnp.array([[0.0], [50.0]]), earlier_prob=jnp.ones(2), interval=0.5)
    >>> print(places.existence_prob, places.mean[0])
    [0.1 0. ] [2. 4.]

Reference: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation", 2001, section 5.5.3 (two-point differencing).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.constraints import Fixed, Positive, Probability, Simplex
from jaxtrack.models.birth import MultiBernoulliBirth, further_index
from jaxtrack.models.sensor import Timed
from jaxtrack.types import Array, Gaussian, PyTree


class PairBirth(NamedTuple):
    """Expects new targets where two scans' unexplained detections give a fair speed.

    Attributes:
        rate: Expected number of new targets per second, a scalar.
        max_existence_prob: No single place is believed in more than this, a scalar.
        max_speed: Of a new target, m/s, a scalar.
        extra_std: State components beyond positions and velocities are
            N(0, extra_std^2), [E].
        mode_prob: Mode of a new target, [M].
    """

    rate: Positive
    max_existence_prob: Probability
    max_speed: Fixed
    extra_std: Positive
    mode_prob: Simplex

    def propose(
        self,
        sensor: PyTree,
        motion: PyTree,
        detections: Array,
        unexplained_prob: Array,
        earlier: Array,
        earlier_prob: Array,
        interval: Array,
    ) -> MultiBernoulliBirth:
        """Places one possible target at each detection that has a partner in time.

        The partner is the nearest. The motion between the two is taken as straight, its
        noise as none: choose `extra_std` and the motion's own noise accordingly.

        Args:
            sensor: A sensor that can locate.
            motion: The motion model whose state is wanted, of D components.
            detections: Of this scan, [K, Z].
            unexplained_prob: Probability that no known target caused it; 0 for one that
                is not there, [K].
            earlier: Detections of the scan before, [L, Z].
            earlier_prob: The same of them, [L].
            interval: Seconds between the two scans.

        Returns:
            K places; one without a partner has existence 0 and finite moments.
        """
        before, after = (jax.vmap(sensor.locate)(x) for x in (earlier, detections))
        ages = [_age(sensor, x) for x in (earlier, detections)]
        time = interval + ages[0][None] - ages[1][:, None]  # [K, L]
        gap = after.mean[:, None] - before.mean[None]
        reach = jnp.maximum(time, 0.0) * self.max_speed
        square = (gap * gap).sum(-1)
        fair = (square <= reach**2) & (time > 0) & (earlier_prob > 0)[None]
        partner = jnp.argmin(jnp.where(fair, square, jnp.inf), axis=1)
        paired = fair.any(1)

        weight = unexplained_prob * earlier_prob[partner]
        weight = jnp.where(paired, weight, 0.0)
        total = weight.sum()
        share = weight / jnp.where(total > 0, total, 1.0)
        prob = jnp.minimum(self.max_existence_prob, self.rate * interval * share)
        seconds = jnp.take_along_axis(time, partner[:, None], axis=1)[:, 0]
        seconds = jnp.where(paired, seconds, 1.0)
        first = jax.tree.map(lambda x: x[partner], before)
        prior = jax.vmap(self._prior, (None, 0, 0, 0, 0))(
            motion, first, after, seconds, ages[1]
        )
        mode_prob = jnp.tile(self.mode_prob, (len(prob), 1))
        return MultiBernoulliBirth(prob, *prior, mode_prob)

    def _prior(
        self, motion: PyTree, first: Gaussian, last: Gaussian, time: Array, age: Array
    ) -> Gaussian:
        """Returns the state [D] of a target seen at two places, `age` seconds later."""
        dim, where, speed = motion.dim, motion.position_index, motion.velocity_index
        place, rate = jnp.array(where), jnp.array(speed)
        ahead = age / time
        dtype = jnp.result_type(first.cov, last.cov, time, age, self.extra_std)
        axes, zero = (
            jnp.eye(len(where), dtype=dtype),
            jnp.zeros((dim, len(where)), dtype),
        )
        from_first = zero.at[place].set(-ahead * axes).at[rate].set(-axes / time)
        from_last = zero.at[place].set((1 + ahead) * axes).at[rate].set(axes / time)
        further = jnp.zeros(dim, dtype)
        if index := further_index(motion):
            further = further.at[jnp.array(index)].set(self.extra_std**2)
        cov = linalg.congruence(from_first, first.cov)
        cov = cov + linalg.congruence(from_last, last.cov) + jnp.diag(further)
        return Gaussian(from_first @ first.mean + from_last @ last.mean, cov)


def _age(sensor: PyTree, detections: Array) -> Array:
    if isinstance(sensor, Timed):
        return detections[:, -1]
    return jnp.zeros(len(detections), detections.dtype)
