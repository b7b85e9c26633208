"""Tests of `trackers.mcmcda` against the posterior of all hypotheses, and MHT."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes

from jaxtrack import engine
from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.trackers import mcmcda, oracle

SIZES, NUM, MAX = (2, 1, 2, 1), 8, 20
ROOM = {
    "max_tracks": 6,
    "max_detections": 2,
    "max_undetected": 6,
    "exist_threshold": 1e-9,
}


@functools.cache
def drawn():
    problems = scenes.stacked([scenes.draw(seed) for seed in range(NUM)])
    return problems, scenes.stacked([scenes.detections(k, SIZES) for k in range(NUM)])


def track(tracker, problem, places, start=None):
    params = scenes.params_of(problem)._replace(start=start)
    scans = scenes.stacked(scenes.padded(places))
    return engine.run(tracker, params, scans, jax.random.key(0))


def exact(problem, places):
    params, scans = scenes.params_of(problem), scenes.scans_of(places)
    key = jax.random.key(0)
    return oracle.posterior(scenes.target, params, scans, key, max_targets=MAX)


@pytest.mark.slow
def test_with_a_window_over_all_scans_it_is_near_the_posterior():
    tracker = mcmcda.mcmcda(
        scenes.target, num_scans=4, num_samples=2000, burn_in=50, **ROOM
    )
    run = jax.jit(jax.vmap(functools.partial(track, tracker)))
    estimates, truth = run(*drawn()), jax.jit(jax.vmap(exact))(*drawn())
    # 10,000 steps a scan; nearly all hypotheses were found, none of them twice.
    total = estimates.log_evidence.sum(1)
    assert (total < truth.log_evidence + 1e-9).all()
    assert (total > truth.log_evidence - 0.1).all()
    count = np.arange(MAX + 1)
    mean = truth.num_prob @ count
    np.testing.assert_allclose(estimates.num_mean[:, -1], mean, atol=0.1)
    var = truth.num_prob @ count**2 - mean**2
    np.testing.assert_allclose(estimates.num_var[:, -1], var, atol=0.1)
    assert (estimates.dropped < 0.05).all()


@pytest.mark.slow
def test_tracks_go_on_under_their_labels_when_the_window_has_passed():
    """Two known targets, far apart and always seen, and one that is born later."""
    problem = {**scenes.draw(1), "detect": 0.98, "survive": 0.99, "clutter": 0.01}
    problem = {**problem, "undetected": 1e-6, "sensor_var": 0.04, "position_std": 6.0}
    problem = {**problem, "births": 0.02, "time_constant": 30.0}
    places = [np.array([-8.0, 6.0])] * 2 + [np.array([6.0, -8.0, 0.0])] * 5
    cov = np.diag([0.1, 0.01])
    start = MultiBernoulliBirth(
        np.array([0.9, 0.9]),
        np.array([[6.0, 0.0], [-8.0, 0.0]]),
        np.stack([cov, cov]),
        np.ones((2, 1)),
    )
    sizes = {**ROOM, "max_detections": 3, "exist_threshold": 1e-3}
    tracker = mcmcda.mcmcda(scenes.target, num_scans=1, num_samples=200, **sizes)
    numbers = jax.tree.map(jnp.asarray, problem)
    run = jax.jit(lambda x: track(tracker, numbers, x, start))
    estimates, third_label = run(places), -1
    shown, label = np.asarray(estimates.exists), np.asarray(estimates.label)
    for t in range(len(places)):
        named = dict(
            zip(label[t, shown[t]].tolist(), np.where(shown[t])[0], strict=True)
        )
        assert len(named) == (2 if t < 2 else 3)
        found = [estimates.mean[t, named[k], 0] for k in (0, 1)]
        np.testing.assert_allclose(found, [6.0, -8.0], atol=0.5)  # noise is 0.2
        if t > 2:
            (third,) = set(named) - {0, 1}
            assert abs(estimates.mean[t, named[third], 0]) < 0.5
            assert third == third_label
        third_label = max(named)
    # The third one may be clutter at first.
    assert (estimates.existence_prob[shown] > 0.7).all()
    assert np.isfinite(estimates.log_evidence).all()
    # One that is missed until hardly anything is left of it, and then seen again.
    far = [np.array([x, 6.0, -x]) for x in (15.0, 16.0, 17.0)]
    found = run([*places[:2], *far, *places[5:]])
    here = np.asarray(found.exists & (abs(found.mean[:, :, 0] + 8) < 0.5))
    assert np.asarray(found.label)[5:][here[5:]].tolist() == [1, 1]


def test_settings_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match="num_scans is -1; give 0 or more"):
        mcmcda.mcmcda(scenes.target, num_scans=-1)
    with pytest.raises(ValueError, match="max_detections is 0; give at least 1"):
        mcmcda.mcmcda(scenes.target, max_detections=0)
    with pytest.raises(ValueError, match="thin is 0; give at least 1"):
        mcmcda.mcmcda(scenes.target, thin=0)
    start = MultiBernoulliBirth(
        np.ones(3), np.zeros((3, 2)), np.tile(np.eye(2), (3, 1, 1)), np.ones((3, 1))
    )
    params = scenes.params_of(scenes.draw(0))._replace(start=start)
    with pytest.raises(ValueError, match="start has 3 targets and max_tracks is 2"):
        mcmcda.mcmcda(scenes.target, max_tracks=2).init(params, jax.random.key(0))
