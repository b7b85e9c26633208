"""Trackers to hold the contract against, and the scans they run on.

Everything is NumPy: operations of JAX outside a compiled function cost more than the
functions themselves.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from jaxtrack.models import birth, clutter, motion, probability, sensor, switching
from jaxtrack.targets import imm, mixture, particles, single
from jaxtrack.trackers import cbmember, cphd, phd
from jaxtrack.types import Scan

SCANS, SLOTS, PADDED = 6, 5, 7


class Case(NamedTuple):
    """A maker that takes capacities, parameters, and where detections may fall."""

    make: Any
    params: Any
    low: Any
    high: Any
    paths: Any
    capacities: Any
    large: Any


def array(*values):
    return np.array(values, float)


def value(number):
    return np.array(number, float)


# Two targets on a line, seen with noise 1 among clutter in [-50, 50].
PATHS = np.stack([-20 + 3.0 * np.arange(SCANS), 15 - 2.0 * np.arange(SCANS)], 1)[
    ..., None
]
SMALL = {"max_tracks": 4, "max_parents": 3, "prune_threshold": 1e-4}
LARGE = {"max_tracks": 48, "max_parents": 3, "prune_threshold": 1e-4}


def line_births(num_modes):
    modes = np.array([[0.7, 0.3], [0.4, 0.6]])[:, :num_modes]
    return birth.MultiBernoulliBirth(
        existence_prob=array(0.2, 0.1),
        mean=np.array([[-20.0, 2.0], [15.0, -1.0]]),
        cov=np.array([[[9.0, 1.0], [1.0, 4.0]], [[16.0, -1.0], [-1.0, 5.0]]]),
        mode_prob=np.array(modes / modes.sum(1, keepdims=True)),
    )


def line_clutter():
    return clutter.UniformClutter(value(1.5), array(-50.0), array(50.0))


def single_params():
    return single.Params(
        motion=motion.ConstantVelocity(array(0.5)),
        sensor=sensor.Position(array(1.2)),
        survive=probability.Lifetime(value(40.0)),
        detect=probability.Constant(value(0.9)),
    )


def two_mode_params():
    return imm.Params(
        motions=(
            motion.ConstantVelocity(array(0.2)),
            motion.OrnsteinUhlenbeck(array(20.0), array(6.0)),
        ),
        switching=switching.MarkovSwitching(np.array([[0.85, 0.15], [0.3, 0.7]])),
        sensor=sensor.Position(array(1.2)),
        survive=probability.PerMode(array(0.98, 0.9)),
        detect=probability.PerMode(array(0.92, 0.75)),
    )


def line_case(target, params, num_modes):
    return Case(
        make=functools.partial(cbmember.cbmember, target),
        params=cbmember.Params(params, line_births(num_modes), line_clutter()),
        low=np.array([-50.0]),
        high=np.array([50.0]),
        paths=PATHS,
        capacities=SMALL,
        large=LARGE,
    )


def ekf_case():
    params = single.Params(
        motion=motion.ConstantVelocity(array(0.5, 0.8)),
        sensor=sensor.RangeBearing(array(2.0, 0.01), array(5.0, -4.0), value(0.3)),
        survive=probability.Constant(value(0.97)),
        detect=probability.InsideDisc(
            value(0.95), array(0.0, 0.0), value(300.0), value(30.0)
        ),
    )
    places = np.array([[100.0, 3.0, 80.0, -2.0], [-60.0, 1.0, 120.0, 2.0]])
    births = birth.MultiBernoulliBirth(
        existence_prob=array(0.2, 0.1),
        mean=np.array(places),
        cov=np.tile(np.diag(array(25.0, 4.0, 36.0, 9.0)), (2, 1, 1)),
        mode_prob=np.ones((2, 1)),
    )
    falls = clutter.PolarClutter(
        value(1.5),
        array(-200.0, -200.0),
        array(200.0, 200.0),
        array(5.0, -4.0),
        value(0.3),
    )
    times = np.arange(SCANS)[:, None, None]
    offset = (
        places[None, :, ::2] + times * places[None, :, 1::2] - np.array([5.0, -4.0])
    )
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - 0.3
    return Case(
        make=functools.partial(cbmember.cbmember, single.single()),
        params=cbmember.Params(params, births, falls),
        low=np.array([20.0, -3.0]),
        high=np.array([180.0, 3.0]),
        paths=np.stack([np.linalg.norm(offset, axis=-1), bearing], -1),
        capacities=SMALL,
        large=LARGE,
    )


def detection_birth_case():
    births = birth.DetectionBirth(
        rate=value(0.4),
        max_existence_prob=value(0.3),
        velocity_std=array(3.0),
        extra_std=np.zeros(0),
        mode_prob=np.ones(1),
    )
    return line_case(single.single(), single_params(), 1)._replace(
        params=cbmember.Params(single_params(), births, line_clutter()),
        capacities={**SMALL, "max_births": PADDED},
        large={**LARGE, "max_births": PADDED},
    )


def merging_case():
    maker = functools.partial(cbmember.cbmember, merge_threshold=4.0)
    plain = line_case(single.single(), single_params(), 1)
    return plain._replace(make=functools.partial(maker, single.single()))


def far_field_case():
    """A field of view far from the origin, where the beliefs of empty slots are."""
    offset = array(9e3, 0.0, 0.0, 0.0)
    births = birth.MultiBernoulliBirth(
        existence_prob=array(0.2, 0.1),
        mean=np.array([[-20.0, 2.0, 4.0, 1.0], [15.0, -1.0, -6.0, 0.5]]) + offset,
        cov=np.tile(np.diag(array(9.0, 4.0, 16.0, 5.0)), (2, 1, 1)),
        mode_prob=np.array([[0.7, 0.3], [0.4, 0.6]]),
    )
    low, high = array(9e3 - 60, -60.0), array(9e3 + 60, 60.0)
    target = two_mode_params()._replace(
        motions=tuple(motion.ConstantVelocity(array(q, q)) for q in (0.2, 4.0)),
        sensor=sensor.Position(array(1.2, 0.8)),
        detect=probability.InsideDisc(
            value(0.95), array(9e3, 0.0), value(500.0), value(10.0)
        ),
    )
    paths = np.stack([PATHS[..., 0] + 9e3, 0.3 * PATHS[..., 0]], -1)
    return Case(
        make=functools.partial(cbmember.cbmember, imm.imm()),
        params=cbmember.Params(
            target, births, clutter.UniformClutter(value(1.5), low, high)
        ),
        low=low,
        high=high,
        paths=paths,
        capacities=SMALL,
        large=LARGE,
    )


# Merging only what is equal, so that a tracker with more room is in the same state.
FEW = {"max_components": 4, "max_updated": 40, "merge_threshold": 0.0}
MANY = {"max_components": 48, "max_updated": 240, "merge_threshold": 0.0}


def intense_case(maker, target, params, num_modes):
    """PHD and CPHD filters, by pairs of a component and a detection."""
    plain = line_case(target, params, num_modes)
    return plain._replace(
        make=functools.partial(maker, target, prune_threshold=1e-4),
        params=phd.Params(*plain.params),
        capacities=FEW,
        large=MANY,
    )


def cphd_detection_birth_case():
    """By detection, merging, and told of births by the last scan."""
    plain = detection_birth_case()
    room = {"max_births": PADDED, "merge_threshold": 4.0}
    return plain._replace(
        make=functools.partial(cphd.cphd, single.single(), partition="detections"),
        params=cphd.Params(*plain.params),
        capacities={"max_components": 4, **room},
        large={"max_components": 48, **room},
    )


CASES = {
    "phd_single": lambda: intense_case(phd.phd, single.single(), single_params(), 1),
    "cphd_imm": lambda: intense_case(cphd.cphd, imm.imm(), two_mode_params(), 2),
    "cphd_detection_birth": cphd_detection_birth_case,
    "cbmember_single": lambda: line_case(single.single(), single_params(), 1),
    "cbmember_imm": lambda: line_case(imm.imm(), two_mode_params(), 2),
    "cbmember_mixture": lambda: line_case(
        mixture.mixture(max_components=2), two_mode_params(), 2
    ),
    "cbmember_particles": lambda: line_case(
        particles.particles(max_particles=64), two_mode_params(), 2
    ),
    "cbmember_ekf": ekf_case,
    "cbmember_detection_birth": detection_birth_case,
    "cbmember_merging": merging_case,
    "cbmember_far_field": far_field_case,
}


def associating_case(name):
    """The trackers that keep one belief a track have a file of their own."""
    from cases import associating

    return associating.CASES[name]()


ASSOCIATING = ("nearest", "gnn", "ipda", "jpda", "jipda", "lmb")
CASES |= {name: functools.partial(associating_case, name) for name in ASSOCIATING}


def hypothesis_case(name):
    """So have those that follow hypotheses."""
    from cases import hypothesis_trackers

    return hypothesis_trackers.CASES[name]()


HYPOTHESES = (
    "hypothesis_mht",
    "clustered_mht",
    "mht_detection_birth",
    "rmm_mht",
    "pmbm",
    "glmb",
    "tpmbm",
    "tpmbm_imm",
    "tmbm",
)
CASES |= {name: functools.partial(hypothesis_case, name) for name in HYPOTHESES}
# They report where targets have been, too.
TRAJECTORIES = "tpmbm", "tpmbm_imm", "tmbm"
# Slopes stop where particles are resampled, and other digits draw other numbers.
SAMPLED = {"cbmember_particles", "glmb"}
# They compile for long.
SECOND_VARIANTS = {
    "cbmember_far_field",
    "rmm_mht",
    "glmb",
    "lmb",
    "tpmbm_imm",
}


@functools.cache
def case_of(name):
    return CASES[name]()


def tracker_of(name, large=False):
    case = case_of(name)
    return case.make(**(case.large if large else case.capacities))


def random_scans(name, seed, full=False):
    """The two targets, mostly detected, and clutter; irregular intervals."""
    case = case_of(name)
    rng = np.random.default_rng(seed)
    num_outputs = case.low.size
    points = rng.uniform(case.low, case.high, (SCANS, SLOTS, num_outputs))
    noise = np.array(case.params.target.sensor.noise_std)
    points[:, 1:3] = case.paths + rng.normal(size=case.paths.shape) * noise
    valid = rng.random((SCANS, SLOTS)) < np.array([0.4, 0.95, 0.95, 0.4, 0.4])
    return Scan(
        detections=np.array(points),
        valid=np.array(valid | full),
        interval=np.array(rng.uniform(0.7, 1.3, SCANS)),
    )


def padded(scans, filler=0.0):
    extra = PADDED - SLOTS
    return scans._replace(
        detections=np.pad(
            scans.detections, ((0, 0), (0, extra), (0, 0)), constant_values=filler
        ),
        valid=np.pad(scans.valid, ((0, 0), (0, extra))),
    )


def variants(name):
    """Named scans of one shape, to be run in one batch."""
    scans = random_scans(name, 0)
    wide = padded(scans)
    kept = wide.valid[..., None]
    far = case_of(name).paths.mean((0, 1))
    return {
        "base": wide,
        "backwards": wide._replace(
            detections=wide.detections[:, ::-1], valid=wide.valid[:, ::-1]
        ),
        "noisy padding": wide._replace(detections=np.where(kept, wide.detections, far)),
        "other run": padded(random_scans(name, 1)),
        "empty": wide._replace(valid=np.zeros_like(wide.valid)),
        "full": padded(random_scans(name, 2, full=True))._replace(
            valid=np.ones_like(wide.valid)
        ),
    }
