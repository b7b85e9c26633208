"""Tests of `trackers.pmb` and of recycling, against the PMBM filter, which is exact."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes
from reference import bernoullis
from test_pmbm import ROOM, run

from jaxtrack.models import birth
from jaxtrack.trackers import pmb, pmbm

NUM, SIZES = 40, (3,)
SMALL = {key: ROOM[key] for key in ("max_tracks", "max_undetected", "gate_prob")}
RECYCLE = 0.3


def params_of(drawn):
    """Two targets may be known before the first scan, and others undetected."""
    plain = scenes.params_of(drawn)
    covs = jnp.tile(4 * jnp.eye(2), (2, 1, 1))
    places = birth.MultiBernoulliBirth(
        drawn["prob"], drawn["mean"], covs, jnp.ones((2, 1))
    )
    return plain._replace(start=places)


@functools.cache
def drawn():
    problems = []
    for seed in range(NUM):
        rng = np.random.default_rng(200 + seed)
        more = {"prob": rng.uniform(0.1, 1.0, 2), "mean": rng.normal(size=(2, 2))}
        problems.append({**scenes.draw(seed), **more})
    places = [scenes.detections(seed, SIZES) for seed in range(NUM)]
    return scenes.stacked(problems), scenes.stacked(places)


@functools.cache
def told(name):
    """The state, the estimate and the evidence after a scan."""
    tracker = {
        "pmb": lambda: pmb.pmb(scenes.target, exist_threshold=0.0, **SMALL),
        "pmb recycled": lambda: pmb.pmb(
            scenes.target, exist_threshold=0.0, recycle_threshold=RECYCLE, **SMALL
        ),
        "pmbm": lambda: pmbm.pmbm(scenes.target, **{**ROOM, "max_hypotheses": 40}),
        "pmbm recycled": lambda: pmbm.pmbm(
            scenes.target, **{**ROOM, "max_hypotheses": 40}, recycle_threshold=RECYCLE
        ),
    }[name]()
    many = jax.jit(jax.vmap(lambda d, p: run(params_of(d), p, tracker)))
    return jax.tree.map(np.asarray, many(*drawn()))


def test_after_one_scan_it_knows_all_about_each_track_by_itself():
    (state, estimate, log_evidence), (exact, best, expected) = told("pmb"), told("pmbm")
    np.testing.assert_allclose(log_evidence, expected, rtol=1e-10)
    weight, mean = bernoullis.intensity(exact)
    tracks = state.tracks
    for k in range(NUM):
        for label in range(2 + SIZES[0]):
            own, other = tracks.label[k] == label, exact.trees.label[k] == label
            prob = tracks.existence_prob[k][own]
            np.testing.assert_allclose(prob, weight[k][other], rtol=1e-10)
            np.testing.assert_allclose(
                tracks.belief.mean[k][own], mean[k][other], rtol=1e-10, atol=1e-10
            )  # of either sign, of order one
    np.testing.assert_allclose(estimate.num_mean, best.num_mean, rtol=1e-10)
    assert (estimate.dropped < 1e-12).all()  # roundings of sums of order one


@pytest.mark.parametrize("name", ["pmb", "pmbm"])
def test_recycling_keeps_the_expected_number(name):
    (_, plain, evidence), (state, estimate, same) = told(name), told(f"{name} recycled")
    np.testing.assert_allclose(same, evidence, rtol=1e-12)
    # What finds no room among the undetected is dropped, and said to be.
    kept = estimate.num_mean + estimate.dropped
    np.testing.assert_allclose(kept, plain.num_mean, rtol=1e-10)
    tracks = state.tracks if name == "pmb" else state.trees
    prob = np.where(tracks.existence_prob > 0, tracks.existence_prob, 1.0)
    if name == "pmb":
        assert (prob >= RECYCLE).all()
    hidden = np.exp(state.undetected.log_weight).sum(1)
    assert (hidden > np.exp(told(name)[0].undetected.log_weight).sum(1)).any()


def test_recycling_needs_places_where_nobody_is_detected():
    given = params_of({key: x[0] for key, x in drawn()[0].items()})
    births = birth.DetectionBirth(
        jnp.array(0.1), jnp.array(0.5), jnp.ones(1), jnp.zeros(0), jnp.ones(1)
    )
    given = given._replace(birth=births, undetected=None)
    tracker = pmb.pmb(scenes.target, recycle_threshold=0.1)
    with pytest.raises(ValueError, match="recycle_threshold is given and birth is a"):
        tracker.init(given, jax.random.key(0))
