"""Targets to hold the contract against: each with parameters, a prior and detections.

Everything is NumPy: operations of JAX outside a compiled function cost more than the
functions themselves.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from jaxtrack import linearize
from jaxtrack.models import motion, probability, sensor, switching, turn
from jaxtrack.targets import imm, likely_modes, mixture, particles, single
from jaxtrack.types import Gaussian, Target

NUM = 4  # detections, and beliefs to collapse


class Case(NamedTuple):
    """A target, its parameters, a prior, and the span of detections to integrate."""

    target: Target
    params: Any
    prior: Gaussian
    mode_prob: Any
    centre: Any
    reach: Any


class Inputs(NamedTuple):
    """What a story is told about; all arrays."""

    params: Any
    prior: Gaussian
    mode_prob: Any
    detections: Any
    interval: Any
    log_weight: Any


def array(*values):
    return np.array(values, float)


def value(number):
    return np.array(number, float)


ONE_AXIS = Gaussian(array(1.0, -2.0), np.array([[4.0, 1.0], [1.0, 2.0]]))
LINEAR_SPAN = (array(-0.5), array(40.0))
SWITCHING = switching.MarkovSwitching(np.array([[0.8, 0.2], [0.45, 0.55]]))
TURNING = Gaussian(
    array(300.0, 12.0, 400.0, -9.0, 0.1),
    np.diag(array(60.0, 9.0, 90.0, 4.0, 0.01))
    + np.diag(array(3.0, 0, 1.0, 0), 1) / 2
    + np.diag(array(3.0, 0, 1.0, 0), -1) / 2,
)
RADAR = sensor.RangeBearing(array(6.0, 0.015), array(20.0, -30.0), value(0.4))
RADAR_SPAN = (array(525.0, 0.585), array(150.0, 0.3))


def kf_case():
    params = single.Params(
        motion=motion.ConstantVelocity(array(0.7)),
        sensor=sensor.Position(array(1.3)),
        survive=probability.Lifetime(value(30.0)),
        detect=probability.Constant(value(0.85)),
    )
    return Case(single.single(), params, ONE_AXIS, np.ones(1), *LINEAR_SPAN)


def radar_case(method):
    params = single.Params(
        motion=turn.TurnRate(value(2.0), value(1e-3)),
        sensor=RADAR,
        survive=probability.Constant(value(0.95)),
        detect=probability.InsideDisc(
            value(0.9), array(0.0, 0.0), value(600.0), value(100.0)
        ),
    )
    return Case(single.single(method), params, TURNING, np.ones(1), *RADAR_SPAN)


def two_modes():
    return imm.Params(
        motions=(
            motion.ConstantVelocity(array(0.3)),
            motion.OrnsteinUhlenbeck(array(9.0), array(3.0)),
        ),
        switching=SWITCHING,
        sensor=sensor.Position(array(1.3)),
        survive=probability.PerMode(array(0.97, 0.8)),
        detect=probability.PerMode(array(0.9, 0.6)),
    )


def linear_case(target):
    return Case(target, two_modes(), ONE_AXIS, array(0.65, 0.35), *LINEAR_SPAN)


def likely_modes_case():
    """Both modes stay active until the end of the story."""
    params = likely_modes.Params(*two_modes(), value(0.2), value(0.5))
    target = likely_modes.likely_modes()
    return Case(target, params, ONE_AXIS, array(0.65, 0.35), *LINEAR_SPAN)


def imm_nonlinear_case():
    return nonlinear_case(imm.imm())


def nonlinear_case(target):
    params = imm.Params(
        motions=(
            turn.TurnRate(value(2.0), value(1e-3)),
            motion.PiecewiseAcceleration(
                turn.TurnRate(value(9.0), value(1e-2)), array(0.5, 0.8)
            ),
        ),
        switching=SWITCHING,
        sensor=RADAR,
        survive=probability.PerMode(array(0.97, 0.8)),
        detect=probability.PerMode(array(0.9, 0.6)),
    )
    return Case(target, params, TURNING, array(0.65, 0.35), *RADAR_SPAN)


def one_mode_case():
    params = two_modes()._replace(
        motions=(motion.ConstantVelocity(array(0.7)),),
        switching=switching.MarkovSwitching(np.ones((1, 1))),
        survive=probability.PerMode(array(0.9)),
        detect=probability.PerMode(array(0.7)),
    )
    target = mixture.mixture(max_components=4, prune_threshold=0.0, merge_threshold=1.0)
    return Case(target, params, ONE_AXIS, np.ones(1), *LINEAR_SPAN)


MERGING = mixture.mixture(max_components=6, prune_threshold=0.0, merge_threshold=1.0)
FEW = particles.particles(max_particles=60, mode_proposal=lambda x: x / 2 - 1)
CASES = {
    "single_kf": kf_case,
    "single_ekf": functools.partial(radar_case, linearize.taylor),
    "single_ukf": functools.partial(radar_case, linearize.unscented),
    "single_ckf": functools.partial(radar_case, linearize.cubature),
    "imm": functools.partial(linear_case, imm.imm()),
    "imm_nonlinear": imm_nonlinear_case,
    "likely_modes": likely_modes_case,
    "mixture": functools.partial(linear_case, MERGING),
    "mixture_one_mode": one_mode_case,
    "particles": functools.partial(linear_case, FEW),
    "particles_nonlinear": functools.partial(nonlinear_case, FEW),
}
# What they draw agrees with the others on average only: see `test_particles`.
SAMPLED = {"particles", "particles_nonlinear"}
# The CKF is the UKF with other weights, one mode is less than two, and with all modes
# active the likely ones are those of the IMM.
SECOND_VARIANTS = {"single_ckf", "mixture_one_mode", "likely_modes"}


@functools.cache
def case_of(name):
    return CASES[name]()


def base_inputs(name):
    """Detections near where the target will be, no two alike."""
    case = case_of(name)
    rng = np.random.default_rng(1)
    gap = rng.uniform(-0.08, 0.08, (NUM, case.centre.size)) * np.array(case.reach)
    return Inputs(
        case.params,
        case.prior,
        case.mode_prob,
        np.array(np.array(case.centre) + gap),
        value(0.75),
        array(-1.0, -0.3, -2.0, -0.7),
    )


def grid(name):
    """Detections [G, Z] all over the span of a case, and the volume of each."""
    case = case_of(name)
    size = case.centre.size
    axis = np.linspace(-1, 1, 801 if size == 1 else 61)
    points = np.stack(np.meshgrid(*[axis] * size, indexing="ij"), -1).reshape(-1, size)
    cell = np.prod(np.array(case.reach) * (axis[1] - axis[0]))
    return np.array(case.centre) + points * np.array(case.reach), cell
