"""A target of many modes, of which only a likely set is active: the LMS algorithm.

Of M modes some are active: they make up what is told to a tracker, and the association
goes by them alone. After each scan `adapt` changes the set (Gomes, Table 3):

1. An active mode is principal if its probability is above t2, unlikely if below t1.
2. Modes adjacent from a principal one are activated at once, as if they had been there
   from the start of the scan, with the same association (VSIMM-JPDAF*, Table 5).
3. The belief and its modes are reported over this union.
4. From the next scan on, unlikely modes that are not adjacent from a principal one are
   left out, the least likely first, as long as `min_modes` remain.

A mode is adjacent from another if the mode switching can go there in one step
(`switching.adjacent()`). What was active feeds the next mixing also where it is left
out from then on: the VSIMM cycle of Table 2, from the union M_{k-1} to the new set M_k.

Shapes are fixed, so all modes are moved and corrected, active or not, and the weight of
each is known on one scale; activation is exact and costs nothing. With all modes active
(t1 = 0, or `min_modes` = M) this is `targets.imm`.

A `temperature` above 0 makes the choices soft, with activities between 0 and 1 that
weigh the modes, so that t1 and t2 can be learned by gradient (see `likely_set`).

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import models
    >>> from jaxtrack.targets import likely_modes
    >>> from jaxtrack.types import Gaussian
    >>> params = likely_modes.Params(
    ...     motions=tuple(
    ...         models.motion.ConstantVelocity(q * jnp.ones(1)) for q in (0.1, 1, 9)),
    ...     switching=models.switching.MarkovSwitching(jnp.array(
    ...         [[0.9, 0.1, 0.0], [0.1, 0.8, 0.1], [0.0, 0.1, 0.9]])),
    ...     sensor=models.sensor.Position(noise_std=jnp.ones(1)),
    ...     survive=models.probability.Constant(jnp.array(0.99)),
    ...     detect=models.probability.Constant(jnp.array(0.9)),
    ...     unlikely_prob=jnp.array(0.05),
    ...     principal_prob=jnp.array(0.6),
    ... )
    >>> target = likely_modes.likely_modes(min_modes=2)
    >>> prior = Gaussian(jnp.zeros(2), jnp.eye(2))
    >>> bank = target.begin(params, prior, jnp.array([0.0, 1.0, 0.0]), None)
    >>> likely_modes.num_active(target.modes(bank)).item()
    1
    >>> likely_modes.num_active(target.modes(target.adapt(params, bank, 1.0))).item()
    1
    >>> bank, _ = target.predict(params, bank, jnp.array(1.0))
    >>> print(target.modes(target.adapt(params, bank, 1.0)).round(1))
    [0.1 0.8 0.1]

References: Gomes, "An overview on target tracking using multiple models methods", 2011,
equations 18 to 25, Tables 2, 3 and 5; Li and Zhang, "Multiple-model estimation with
variable structure, part V: likely-model set algorithm", IEEE Trans. Aerospace and
Electronic Systems 36(2), 2000.
"""

import functools
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linearize, mixture
from jaxtrack.constraints import Probability, below
from jaxtrack.targets import banks, blending, gauge, likely_set, verbs
from jaxtrack.types import Array, Gaussian, Mixture, Target


class Params(NamedTuple):
    """Everything that may be learned: those of `targets.imm`, and two thresholds.

    Attributes:
        motions: One motion model per mode, a tuple of M; all over the same state.
        switching: Markov switching between modes, of `models.switching`.
        sensor: A model of `models.sensor`.
        survive: Probability to survive one interval, of `models.probability`.
        detect: Probability of detection, of `models.probability`.
        unlikely_prob: t1; a mode below it may be left out. A scalar.
        principal_prob: t2; a mode above it activates those adjacent. A scalar.
    """

    motions: tuple[Any, ...]
    switching: Any
    sensor: Any
    survive: Any
    detect: Any
    unlikely_prob: Annotated[Array, below("principal_prob")]
    principal_prob: Probability

    @property
    def layout(self) -> Any:
        """Returns a motion model that says where positions and velocities stand."""
        return self.motions[0]


class Belief(NamedTuple):
    """Every mode, and which of them count.

    Attributes:
        log_weight: Scaled so that the active modes' weights sum to one, [M].
        mean: [M, D].
        cov: [M, D, D].
        log_active: 0 for a mode that is active and -inf for one that is not, or the
            log of an activity in between, [M].
        log_next: The same for the next scan, [M].
    """

    log_weight: Array
    mean: Array
    cov: Array
    log_active: Array
    log_next: Array

    @property
    def bank(self) -> Mixture:
        """Returns the modes, active or not."""
        return Mixture(self.log_weight, self.mean, self.cov)

    @property
    def counted(self) -> Mixture:
        """Returns the modes with no weight for those that are not active."""
        return self.bank._replace(log_weight=self.log_weight + self.log_active)


class View(NamedTuple):
    """A belief as the sensor sees it, and the activity that it goes on with."""

    seen: blending.View
    log_next: Array


@functools.cache
def likely_modes(
    min_modes: int = 1,
    method: linearize.Method = linearize.taylor,
    blend: blending.Blend = blending.by_mixture,
    yardstick: gauge.Yardstick = "mixture",
    temperature: float = 0.0,
) -> Target:
    """Makes a target whose belief is a bank of modes of which a likely set is active.

    A newborn's active modes are those of positive probability. Beliefs that are
    collapsed to one have all modes active that any of them has. Where no active mode
    can be entered, all modes become active.

    Args:
        min_modes: So many modes stay active at least, however unlikely.
        method: `linearize.taylor`, `unscented` or `cubature`; idle where the models
            are linear.
        blend: `blending.by_mixture` or, as Gomes prints it, `blending.by_residual`.
        yardstick: Whose innovation covariance a gate goes by: the whole "mixture"'s, or
            that of the mode where it is "largest"; of active modes only.
        temperature: Width of the soft choices in log-probability; 0 makes them hard.

    Raises:
        ValueError: A setting that makes no sense.
    """
    gauge.check(yardstick)
    if min_modes < 1:
        raise ValueError(f"min_modes is {min_modes}; give at least 1")
    if not 0 <= temperature < float("inf"):
        raise ValueError(f"temperature is {temperature}; give 0 or a positive number")

    def correct(params: Params, view: View, detection: Array) -> Belief:
        return _belief(banks.correct(method, params, view.seen, detection), view)

    def look(params: Params, belief: Belief) -> View:
        seen = banks.look(method, params, belief.bank, belief.log_active)
        return View(seen, belief.log_next)

    def blended(
        params: Params, view: View, missed: Belief, log_weight: Array, detections: Array
    ) -> Belief:
        bank = blend(method, params, view.seen, missed.bank, log_weight, detections)
        return _belief(bank, view)

    return Target(
        begin=_begin,
        predict=functools.partial(_predict, method),
        miss=_miss,
        look=look,
        score=lambda params, view, z: banks.score(method, params, view.seen, z),
        distance=lambda params, view, z: banks.distance(
            yardstick, method, params, view.seen, z
        ),
        correct=correct,
        collapse=_collapse,
        absorb=verbs.absorb(correct, _collapse),
        blend=blended,
        adapt=functools.partial(_adapt, min_modes, temperature),
        moments=lambda belief: mixture.collapse(belief.counted),
        parts=lambda belief: belief.counted,
        modes=lambda belief: mixture.normalise(belief.counted.log_weight),
        lost=lambda belief: jnp.zeros((), belief.mean.dtype),
        effective_size=verbs.no_sample,
    )


def num_active(mode_prob: Array) -> Array:
    """Counts the modes in play, given the probabilities [M] that `modes` tells.

    A mode that is not active has probability 0 to the last bit. So has one that was
    activated although nothing could have entered it yet, which is not counted.
    """
    return (mode_prob > 0).sum()


def _begin(params: Params, prior: Gaussian, mode_prob: Array, key: Any) -> Belief:
    del params, key
    bank = banks.begin(prior, mode_prob)
    log_active = jnp.where(bank.log_weight > -jnp.inf, 0.0, -jnp.inf)
    log_active = log_active.astype(bank.log_weight.dtype)
    return Belief(*bank, log_active, log_active)


def _belief(bank: Mixture, view: View) -> Belief:
    return Belief(*bank, view.seen.log_active, view.log_next)


def _predict(
    method: linearize.Method, params: Params, belief: Belief, interval: Array
) -> tuple[Belief, Array]:
    """Moves all modes out of those that were active, and goes on with the next set."""
    bank, log_survive = banks.predict(method, params, belief.counted, interval)
    blocked = mixture.total(bank.log_weight + belief.log_next) == -jnp.inf
    log_active = jnp.where(blocked, 0.0, belief.log_next)
    log_weight = blending.log_normalise(bank.log_weight, log_active)
    return Belief(log_weight, *bank[1:], log_active, log_active), log_survive


def _miss(params: Params, belief: Belief) -> tuple[Belief, Array]:
    bank, log_prob = banks.miss(params, belief.bank, belief.log_active)
    return Belief(*bank, belief.log_active, belief.log_next), log_prob


def _collapse(log_weight: Array, many: Belief) -> Belief:
    """Merges N beliefs mode by mode; a mode is active where any has it active.

    Then only those count that have it active, so that the moments of the pool are kept;
    a mode that none has active is merged over all.
    """
    log_share = mixture.log_normalise(log_weight)
    there = log_share[:, None] > -jnp.inf
    active = jnp.where(there, many.log_active, -jnp.inf).max(0)  # [M]
    following = jnp.where(there, many.log_next, -jnp.inf).max(0)

    idle = active == -jnp.inf
    relative = many.log_active - jnp.where(idle, 0.0, active)[None]
    relative = jnp.where(idle[None], 0.0, relative)
    log_joint = log_share[:, None] + many.log_weight + relative
    weight = jax.vmap(mixture.normalise, 1)(log_joint)  # [M, N]
    merged = jax.vmap(mixture.moment_match, (0, 1, 1))(weight, many.mean, many.cov)
    log_total = mixture.total(log_joint)
    return Belief(log_total, *merged, active, following)


def _adapt(
    min_modes: int,
    temperature: float,
    params: Params,
    belief: Belief,
    existence_prob: Array,
) -> Belief:
    del existence_prob
    log_active, log_next = likely_set.adapt(
        belief.counted.log_weight,
        belief.log_active,
        params.switching.adjacent(),
        params.unlikely_prob,
        params.principal_prob,
        min_modes,
        temperature,
    )
    log_weight = blending.log_normalise(belief.log_weight, log_active)
    return Belief(log_weight, belief.mean, belief.cov, log_active, log_next)
