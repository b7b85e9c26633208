"""One scan of the PHD filter: the plain filter's, and Bayes' rule where it is exact."""

import functools
import math

import jax
import numpy as np
import pytest
from cases import intensities as cases
from cases import intensity_runs as runs
from cases import intensity_slopes as slopes
from reference import phd as book

from jaxtrack.trackers import phd


@pytest.mark.parametrize("name", cases.TARGETS)
def test_update_is_the_plain_filters(name):
    """Jump Markov as well: an intensity of pairs of a component and a mode."""
    given = cases.scenes(name)
    found_all = cases.answers(name, "phd", given)
    for scene, (found, _, corrected) in zip(given, found_all, strict=True):
        model, clutter, flat, _, detections = cases.plain(name, scene)
        missed, hits, log_evidence = book.update(model, clutter, flat, detections)
        cases.check_weights(name, scene, found, missed, hits)
        cases.check_beliefs(name, scene, found, corrected, missed, hits)
        np.testing.assert_allclose(found.log_evidence, log_evidence, rtol=1e-10)
        # Every detection is explained once: by clutter or by some component.
        explained = np.exp(found.log_hit).sum(0) + found.unexplained_prob
        np.testing.assert_allclose(explained[scene.scan.valid], 1.0, rtol=1e-12)


@pytest.mark.parametrize("count", range(3))
def test_update_is_bayes_rule_for_a_poisson_number(count):
    """Cut off at six targets: seven are as likely as 2e-11."""
    rng = np.random.default_rng(count)
    scene = cases.scene(rng, "single", (0.8, 0.8), 1.2, count)
    with np.errstate(divide="ignore"):
        log_weight = np.log([0.03, 0.07, 0.0, 0.0])
    few = scene.components._replace(log_weight=log_weight)
    scene = scene._replace(components=few)
    ((found, _, _),) = cases.answers("single", "phd", [scene])
    p = [math.exp(-0.1) * 0.1**n / math.factorial(n) for n in range(7)]
    evidence, _, missed, hits = cases.by_enumeration(scene, p)
    np.testing.assert_allclose(found.log_evidence, np.log(evidence), rtol=1e-9)
    np.testing.assert_allclose(np.exp(found.log_missed[:2]), missed, rtol=1e-8)
    seen = np.exp(found.log_hit[:2, scene.scan.valid])
    np.testing.assert_allclose(seen, hits, rtol=1e-8)


@pytest.mark.parametrize("name", ["single", "mixture"])
def test_scans_in_a_row_are_the_plain_filters(name):
    """Nothing is pruned and only equals merge, so intensities grow, but are the same.

    That is survival, motion, switching and birth as well.
    """
    tracker = phd.phd(
        runs.TARGETS[name],
        max_components=90,
        max_updated=90,
        prune_threshold=0.0,
        merge_threshold=0.0,
    )
    found = runs.run(tracker, name)
    for t, (expected, log_evidence) in enumerate(runs.plain_phd(name)):
        total = sum(w for w, *_ in expected)
        np.testing.assert_allclose(found.log_evidence[t], log_evidence, rtol=1e-9)
        np.testing.assert_allclose(found.existence_prob[t].sum(), total, rtol=1e-9)
        assert found.dropped[t] < 1e-9


@functools.cache
def evidence():
    target = cases.TARGETS["single"]
    return slopes.program(
        lambda scene: phd.update(target, *scene[:2], scene.scan).log_evidence
    )


@pytest.mark.parametrize("which", slopes.EDGES)
def test_evidence_has_right_gradients(which):
    slopes.check(evidence(), which)


def test_detection_depends_on_the_components_place():
    """Who is out of sight keeps its weight; in the plain filter it has its own mode."""
    edge, values = slopes.EDGES["field_of_view"][0], slopes.values_of("field_of_view")
    scene = slopes.scene_of(edge, values)
    given = cases.TARGETS["single"], *scene[:2], scene.scan
    found = jax.jit(phd.update, static_argnums=0)(*given)
    detect = 0.9 / (1 + np.exp(values.mean[:, 0] - 0.5))
    model, clutter, flat, _, detections = cases.plain("single", scene)
    model = model._replace(detect=detect)
    flat = [(w, m, P, n) for n, (w, m, P, _) in enumerate(flat)]
    missed, hits, _ = book.update(model, clutter, flat, detections)
    cases.check_weights("single", scene, found, missed, hits)
