"""Trackers of particles follow what trackers of mixtures do, two targets in clutter."""

import functools

import jax
import numpy as np
import pytest
from cases import trackers as cases
from cases.associating import one_point

from jaxtrack import engine
from jaxtrack.targets import mixture, particles, rao_blackwell
from jaxtrack.trackers import cbmember, jpda, single_scan

MAKERS = {
    "cbmember": functools.partial(cbmember.cbmember, max_tracks=6, max_parents=3),
    "jipda": functools.partial(jpda.jipda, max_tracks=6),
}
EXACT = mixture.mixture(max_components=8)
TARGETS = {
    "particles": particles.particles(max_particles=1000, min_particles=300),
    "rao_blackwell": rao_blackwell.rao_blackwell(max_particles=60),
}


@functools.cache
def estimates(maker, target):
    params = cbmember.Params(
        cases.two_mode_params(), cases.line_births(2), cases.line_clutter()
    )
    if maker == "jipda":
        params = single_scan.Params(*params)
    scans = cases.random_scans("cbmember_imm", 0)
    run = jax.jit(functools.partial(engine.run, MAKERS[maker](target)))
    return jax.tree.map(np.array, run(params, scans, jax.random.key(0)))


@pytest.mark.parametrize(
    ("name", "maker"), [("particles", "cbmember"), ("rao_blackwell", "jipda")]
)
def test_particles_follow_as_mixtures_do(maker, name):
    rough, fine = estimates(maker, TARGETS[name]), estimates(maker, EXACT)
    for told in (rough, fine):
        assert told.exists[-1].sum() == 2
    # Bounds are a few standard deviations of what 1000, or 60, particles give.
    expected = fine.existence_prob.sum(1)
    np.testing.assert_allclose(rough.existence_prob.sum(1), expected, atol=0.15)
    np.testing.assert_allclose(rough.log_evidence, fine.log_evidence, atol=0.5)
    for t in range(2, cases.SCANS):
        one, other = (
            np.sort(told.mean[t][told.exists[t]][:, 0]) for told in (rough, fine)
        )
        np.testing.assert_allclose(one, other, atol=0.5)  # of a sensor of 1.2
    there = rough.existence_prob > 0.5
    most = 1000 if name == "particles" else 60
    assert (rough.effective_size[there] > 0.02 * most).all()
    assert (rough.effective_size[there] <= most + 1e-6).all()
    assert (fine.effective_size == 0).all()


def test_births_from_detections_have_clouds_of_their_own():
    params = single_scan.Params(
        cases.single_params(), one_point(), cases.line_clutter(), None
    )
    target = particles.particles(max_particles=200)
    many = params.target
    params = params._replace(
        target=particles.Params(
            (many.motion,),
            cases.two_mode_params().switching._replace(transition=np.ones((1, 1))),
            *many[1:],
        )
    )
    tracker = jpda.jipda(target, max_tracks=6, max_births=5)
    run = jax.jit(functools.partial(engine.run, tracker))
    told = run(params, cases.random_scans("cbmember_imm", 0), jax.random.key(0))
    assert told.exists[-1].sum() == 2
    variance = np.array(told.cov[-1, :, 0, 0][told.existence_prob[-1] > 0.01])
    assert len(set(variance.round(9))) == len(variance)
