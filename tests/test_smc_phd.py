"""One scan of the PHD and CPHD filters on particles: those of the plain SMC filters.

Detection depends on the state, so that every particle has its own probability.
"""

import functools

import jax
import numpy as np
import pytest
from cases import intensities as cases
from cases.intensity_slopes import Sight
from reference import cphd as cphd_book
from reference import phd as book

from jaxtrack.models import probability, switching
from jaxtrack.targets import particles
from jaxtrack.trackers import cphd, intensity, phd
from jaxtrack.types import Gaussian

NUM, SLOPE = 3, 0.9
TARGET = particles.particles(max_particles=40)


@functools.cache
def scene():
    """Three clouds, each about a Gaussian; two detections and two empty slots."""
    rng = np.random.default_rng(9)
    one = cases.scene(rng, "single", (SLOPE, SLOPE), 1.5, 2)
    old = one.params.target
    target = particles.Params(
        motions=(old.motion,),
        switching=switching.MarkovSwitching(np.ones((1, 1))),
        sensor=old.sensor,
        survive=probability.Constant(np.array(1.0)),
        detect=Sight(np.array(SLOPE), np.array(0.5)),
    )
    belief = one.components.belief

    def begin(mean, cov, key):
        prior = Gaussian(mean, cov)
        return TARGET.begin(target, prior, np.ones(1), key)

    keys = jax.random.split(jax.random.key(0), NUM)
    clouds = jax.jit(jax.vmap(begin))(belief.mean[:NUM], belief.cov[:NUM], keys)
    # Weights of their own, as after a scan.
    log_weight = np.log(rng.dirichlet(np.ones(clouds.log_weight.shape[1]), NUM))
    components = intensity.Components(
        one.components.log_weight[:NUM],
        clouds._replace(log_weight=log_weight),
        np.arange(NUM),
    )
    params = one.params._replace(target=target)
    return one._replace(params=params, components=components)


def plain():
    """detect, likelihood, clutter and all particles, as the plain filters take them."""
    params, components = scene().params, scene().components
    share = np.exp(components.log_weight[:, None] + components.belief.log_weight)
    states = np.asarray(components.belief.state)
    cloud = list(zip(share.ravel(), states.reshape(-1, 2), strict=True))
    box = book.Clutter(
        float(params.clutter.rate), lambda z: 1 / (cases.HIGH - cases.LOW)
    )

    def detect(x):
        return SLOPE / (1 + np.exp(x[0] - 0.5))

    def likelihood(z, x):
        far = (z[0] - x[0]) / cases.STD
        return np.exp(-far * far / 2) / np.sqrt(2 * np.pi) / cases.STD

    return detect, likelihood, box, cloud


@functools.cache
def update(which):
    def one(scene):
        if which == "phd":
            found, number = phd.update(TARGET, *scene[:2], scene.scan), scene.log_number
        else:
            found, number = cphd.update(TARGET, *scene)
        correct = jax.vmap(TARGET.correct, (None, None, 0))
        correct = jax.vmap(correct, (None, 0, None))
        hits = correct(scene.params.target, found.views, scene.scan.detections)
        return found._replace(views=None), number, hits.log_weight

    return jax.tree.map(np.asarray, jax.jit(one)(scene()))


@pytest.mark.parametrize("which", ["phd", "cphd"])
def test_update_is_the_plain_smc_filters(which):
    found, log_number, corrected = update(which)
    valid = scene().scan.valid
    detections = list(scene().scan.detections[valid])
    if which == "phd":
        *parts, log_evidence = book.update_particles(*plain(), detections)
    else:
        given = np.exp(scene().log_number), detections
        *parts, p, log_evidence = cphd_book.update_particles(*plain(), *given)
        # Absolute: one number is impossible, and zero but for rounding.
        np.testing.assert_allclose(np.exp(log_number), p, rtol=1e-10, atol=1e-14)
    missed, hits = (w.reshape(NUM, -1, *w.shape[1:]) for w in book.weights(*parts))
    np.testing.assert_allclose(found.log_evidence, log_evidence, rtol=1e-10)
    np.testing.assert_allclose(np.exp(found.log_missed), missed.sum(1), rtol=1e-10)
    seen = np.exp(found.log_hit[:, valid])
    np.testing.assert_allclose(seen, hits.sum(1), rtol=1e-10)

    # The particles themselves: their weights within a component.
    share = np.exp(found.missed.log_weight)
    np.testing.assert_allclose(share, missed / missed.sum(1)[:, None], rtol=1e-9)
    share = np.swapaxes(np.exp(corrected[:, valid]), 1, 2)
    np.testing.assert_allclose(share, hits / hits.sum(1)[:, None], rtol=1e-9)
