"""The trackers that keep one belief a track, for the contract of `cases.trackers`."""

import functools

import numpy as np
from cases import trackers as cases

from jaxtrack.models import birth, pairs
from jaxtrack.targets import imm, single
from jaxtrack.trackers import gnn, jpda, lmb, management, nearest, pda, undetected
from jaxtrack.trackers.single_scan import Params

TIGHT = {"max_tracks": 4, "max_births": cases.PADDED}
FEW = {**TIGHT, "max_tracks": 2}
ROOMY = {"max_tracks": 40, "max_births": cases.PADDED}


def one_point():
    return birth.DetectionBirth(
        rate=cases.value(0.4),
        max_existence_prob=cases.value(0.3),
        velocity_std=cases.array(3.0),
        extra_std=np.zeros(0),
        mode_prob=np.ones(1),
    )


def two_points():
    return pairs.PairBirth(
        rate=cases.value(0.4),
        max_existence_prob=cases.value(0.3),
        max_speed=cases.value(6.0),
        extra_std=np.zeros(0),
        mode_prob=cases.array(0.6, 0.4),
    )


def two_known():
    """The two targets of the scene, a scan before the first; not believed in yet."""
    mean, cov = np.array([[-23.0, 3.0], [17.0, -2.0]]), np.tile(np.eye(2), (2, 1, 1))
    prob = cases.array(0.4, 0.45)
    return birth.MultiBernoulliBirth(prob, mean, 4 * cov, np.ones((2, 1)))


def case(maker, births, target=None, params=None, tight=TIGHT, start=None):
    line = cases.line_case(target, params, 1)
    params = params or cases.single_params()
    return line._replace(
        make=functools.partial(maker, target or single.single()),
        params=Params(params, births, cases.line_clutter(), start),
        capacities=tight,
        large={**tight, **ROOMY},
    )


def lmb_case():
    """With births where the last scan left detections unexplained."""
    plain = case(functools.partial(lmb.lmb, method="belief"), one_point())
    return plain._replace(params=undetected.Params(*plain.params[:3]))


QUICK = management.MofN(2, 3, 2, 3)
TESTED = management.ScoreTest(1e-2, 1e-2, 3.0)
CASES = {
    "nearest": lambda: case(nearest.nearest, one_point(), tight={**FEW, "rule": QUICK}),
    "gnn": lambda: case(
        gnn.gnn,
        two_points(),
        imm.imm(),
        cases.two_mode_params(),
        {**TIGHT, "max_tracks": 1, "rule": QUICK},
    ),
    "ipda": lambda: case(pda.ipda, one_point()),
    "jpda": lambda: case(
        jpda.jpda, one_point(), tight={**FEW, "rule": TESTED}, start=two_known()
    ),
    "jipda": lambda: case(
        jpda.jipda, cases.line_births(2), imm.imm(), cases.two_mode_params()
    ),
    "lmb": lmb_case,
}
