"""The trackers that follow hypotheses, for the contract of `cases.trackers`."""

import functools

import numpy as np
from cases import trackers
from cases.trackers import array

from jaxtrack.models import birth
from jaxtrack.targets import imm, single
from jaxtrack.trackers import (
    clustered_mht,
    glmb,
    hypothesis_mht,
    mht,
    pmbm,
    rmm_mht,
    tmbm,
    tpmbm,
    undetected,
)


def line_params(target, num_modes):
    places = trackers.line_births(num_modes)
    births = birth.PoissonBirth(array(0.2, 0.1), *places[1:])
    already = birth.PoissonBirth(array(0.5, 0.4), *places[1:])
    return undetected.Params(target, births, trackers.line_clutter(), already)


def line_case(maker, target, params, num_modes, **room):
    plain = trackers.line_case(target, params, num_modes)
    return plain._replace(
        make=functools.partial(maker, target),
        params=line_params(params, num_modes),
        capacities={"max_tracks": 5, "max_leaves": 4, "max_undetected": 4, **room},
        large={"max_tracks": 16, "max_leaves": 8, "max_undetected": 12, **room},
    )


def driven_case():
    """Births where anything is detected for the first time."""
    plain = line_case(mht.mht, single.single(), trackers.single_params(), 1)
    births = birth.DetectionBirth(
        rate=np.array(0.4),
        max_existence_prob=np.array(1.0),
        velocity_std=array(3.0),
        extra_std=np.zeros(0),
        mode_prob=np.ones(1),
    )
    params = plain.params._replace(birth=births, undetected=None)
    room = {"num_scans": 1, "max_hypotheses": 8}
    return plain._replace(
        params=params,
        capacities={**plain.capacities, **room},
        large={**plain.large, **room},
    )


def rmm_case():
    """Nobody mixes modes, and a window of two scans."""
    plain = line_case(mht.mht, imm.imm(), trackers.two_mode_params(), 2)
    room = {
        "max_leaves": 6,
        "max_detections": 8,
        "max_contested": 4,
        "max_new": 4,
        "worth": 0.05,
    }
    return plain._replace(
        make=rmm_mht.rmm_mht,
        capacities={"max_tracks": 3, "max_undetected": 4, **room},
        large={"max_tracks": 8, "max_undetected": 12, **room},
    )


def glmb_case():
    """At most one target is born at a place."""
    room = {"max_hypotheses": 12, "num_sweeps": 8}
    plain = line_case(glmb.glmb, single.single(), trackers.single_params(), 1, **room)
    places = trackers.line_births(1)
    return plain._replace(
        params=plain.params._replace(birth=places, undetected=None),
        capacities={"max_tracks": 3, "max_leaves": 4, **room},
        large={"max_tracks": 12, "max_leaves": 8, **room},
    )


def trajectory_case(target, params, num_modes, **more):
    """A window of a scan, and one more that is smoothed."""
    room = {"num_scans": 1, "lag": 1, "max_hypotheses": 8, **more}
    return line_case(tpmbm.tpmbm, target, params, num_modes, **room)


def born_case():
    """Trajectories that begin with a birth, at most one at a place."""
    room = {"num_scans": 1, "lag": 1, "max_hypotheses": 8}
    plain = trackers.line_case(single.single(), trackers.single_params(), 1)
    places = trackers.line_births(1)
    return plain._replace(
        make=functools.partial(tmbm.tmbm, single.single()),
        params=line_params(trackers.single_params(), 1)._replace(
            birth=places, undetected=None
        ),
        capacities={"max_tracks": 4, "max_leaves": 4, **room},
        large={"max_tracks": 16, "max_leaves": 8, **room},
    )


CASES = {
    "hypothesis_mht": lambda: line_case(
        hypothesis_mht.hypothesis_mht,
        single.single(),
        trackers.single_params(),
        1,
        max_hypotheses=12,
        max_children=4,
    ),
    "clustered_mht": lambda: line_case(
        clustered_mht.clustered_mht,
        single.single(),
        trackers.single_params(),
        1,
        max_hypotheses=12,
        max_children=32,
        max_clusters=3,
        max_members=4,
        max_detections=4,
    ),
    "mht_detection_birth": driven_case,
    "pmbm": lambda: line_case(
        pmbm.pmbm,
        single.single(),
        trackers.single_params(),
        1,
        max_hypotheses=12,
    ),
    "rmm_mht": rmm_case,
    "glmb": glmb_case,
    "tpmbm": lambda: trajectory_case(single.single(), trackers.single_params(), 1),
    "tpmbm_imm": lambda: trajectory_case(
        imm.imm(),
        trackers.two_mode_params(),
        2,
        trajectories="alive",
        num_birth_times=3,
    ),
    "tmbm": born_case,
}
