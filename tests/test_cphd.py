"""One scan of the CPHD filter: the plain filter's, and exactly Bayes' rule."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import intensities as cases
from cases import intensity_runs as runs
from cases import intensity_slopes as slopes
from reference import cphd as book

from jaxtrack.trackers import counting, cphd, intensity, phd


@pytest.mark.parametrize("name", cases.TARGETS)
def test_update_is_the_plain_filters(name):
    """Jump Markov as well: an intensity of pairs of a component and a mode."""
    given = cases.scenes(name)
    found_all = cases.answers(name, "cphd", given)
    for scene, (found, log_number, corrected) in zip(given, found_all, strict=True):
        model, clutter, flat, p, detections = cases.plain(name, scene)
        missed, hits, p, log_evidence = book.update(model, clutter, flat, p, detections)
        cases.check_weights(name, scene, found, missed, hits)
        cases.check_beliefs(name, scene, found, corrected, missed, hits)
        np.testing.assert_allclose(found.log_evidence, log_evidence, rtol=1e-10)
        # Absolute: what cannot be is zero but for the plain filter's rounding.
        np.testing.assert_allclose(np.exp(log_number), p, rtol=1e-10, atol=1e-14)
        expected = np.exp(found.log_missed).sum() + np.exp(found.log_hit).sum()
        mean = np.exp(log_number) @ np.arange(cases.NUMBERS)
        np.testing.assert_allclose(expected, mean, rtol=1e-12, atol=1e-14)


def exact_scenes():
    """Up to three targets of two components, up to three detections; at times no
    clutter, detection that is sure, or a number that is known."""
    rng = np.random.default_rng(7)
    made = []
    for index in range(36):
        detect = rng.choice([0.3, 0.8, 1.0])
        rate = rng.choice([0.0, 0.4, 3.0])
        scene = cases.scene(rng, "single", (detect, detect), rate, index % 4)
        log_weight, p = scene.components.log_weight.copy(), np.zeros(cases.NUMBERS)
        log_weight[2] = -np.inf
        p[:4] = rng.dirichlet(np.ones(4)) if index % 3 else np.eye(4)[index % 4]
        with np.errstate(divide="ignore"):
            scene = scene._replace(log_number=np.log(p))
        few = scene.components._replace(log_weight=log_weight)
        made.append(scene._replace(components=few))
    return made


def test_update_is_bayes_rule():
    """For targets that are independent and identically distributed."""
    given, possible = exact_scenes(), 0
    found_all = cases.answers("single", "cphd", given)
    for scene, (found, log_number, _) in zip(given, found_all, strict=True):
        p = np.exp(scene.log_number)[:4]
        with np.errstate(invalid="ignore"):
            evidence, number, missed, hits = cases.by_enumeration(scene, p)
        if not evidence > 0:  # too few targets for so many detections, and no clutter
            assert found.log_evidence < -100
            continue
        possible += 1
        np.testing.assert_allclose(found.log_evidence, np.log(evidence), rtol=1e-10)
        # Absolute: what cannot be is zero but for rounding, or a miracle of e^-200.
        np.testing.assert_allclose(
            np.exp(log_number[:4]), number, rtol=1e-10, atol=1e-14
        )
        np.testing.assert_allclose(
            np.exp(found.log_missed[:2]), missed, rtol=1e-10, atol=1e-14
        )
        seen = np.exp(found.log_hit[:2, scene.scan.valid])
        np.testing.assert_allclose(seen, hits, rtol=1e-10, atol=1e-14)
    assert possible > 20


def test_unexplained_are_the_detections_of_clutter():
    """Each detection is explained once, as in the PHD filter."""
    given = cases.scenes("single")
    found_all = cases.answers("single", "cphd", given)
    for scene, (found, _, _) in zip(given, found_all, strict=True):
        explained = np.exp(found.log_hit).sum(0) + found.unexplained_prob
        np.testing.assert_allclose(explained[scene.scan.valid], 1.0, rtol=1e-10)


def test_poisson_number_makes_it_the_phd_filter():
    """With so many targets possible that the cut does not matter."""
    scene = cases.scenes("single")[4]
    weight = np.exp(scene.components.log_weight).sum()
    log_number = np.array([np.log(book.poisson(weight, n)) for n in range(60)])
    target = cases.TARGETS["single"]
    update = jax.jit(cphd.update, static_argnums=0)
    found, _ = update(target, *scene[:2], log_number, scene.scan)
    expected = jax.jit(phd.update, static_argnums=0)(target, *scene[:2], scene.scan)
    for name in ("log_missed", "log_hit", "log_evidence", "unexplained_prob"):
        one, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(np.exp(one), np.exp(other), rtol=1e-10)


@pytest.mark.parametrize("name", ["single", "mixture"])
def test_scans_in_a_row_are_the_plain_filters(name):
    """Nothing is pruned and only equals merge, so intensities grow, but are the same.

    That is survival, motion, switching and birth as well.
    """
    tracker = cphd.cphd(
        runs.TARGETS[name],
        max_components=90,
        max_targets=runs.MAX_TARGETS,
        max_updated=90,
        prune_threshold=0.0,
        merge_threshold=0.0,
    )
    found = runs.run(tracker, name)
    for t, (expected, p, log_evidence) in enumerate(runs.plain_cphd(name)):
        total = sum(w for w, *_ in expected)
        np.testing.assert_allclose(found.log_evidence[t], log_evidence, rtol=1e-9)
        np.testing.assert_allclose(found.existence_prob[t].sum(), total, rtol=1e-9)
        # Absolute: numbers that are less likely than rounding.
        np.testing.assert_allclose(found.cardinality_prob[t], p, atol=1e-12)
        assert found.dropped[t] < 1e-9


@pytest.mark.parametrize("log_clutter", [-8.2, -200.0])
def test_float32_bears_three_hundred_detections(log_clutter):
    """Ratios to the clutter from e^-1800 to e^200; with clutter, and without any."""
    rng = np.random.default_rng(11)
    score = -(rng.uniform(0, 60, (30, 300)) ** 2) / 2
    score[np.arange(20), np.arange(20)] = -1.5
    if log_clutter < -100:
        score[:, 25:] = -np.inf
    clutter = np.where(np.isfinite(score).any(0), log_clutter, 0.0)
    sighting = intensity.Sighting(
        None, None, np.log(rng.uniform(0.1, 1, 30)), np.full(30, -2.3), score, clutter
    )
    log_number = -(((np.arange(33) - 22) / 4) ** 2) / 2
    found = []
    for kind in ("float64", "float32"):
        with jax.enable_x64(kind == "float64"):
            given = jax.tree.map(
                lambda x, kind=kind: jnp.asarray(x, kind), (sighting, log_number, 270.0)
            )
            found.append(jax.tree.map(np.array, jax.jit(counting.correct)(*given)))
    (right, number), (rough, rough_number) = found
    assert rough.log_hit.dtype == np.float32
    assert np.exp(right.log_hit).sum() > 15
    for exact, near in (
        (right.log_missed, rough.log_missed),
        (right.log_hit, rough.log_hit),
        (number, rough_number),
    ):
        # Absolute: of probabilities and of numbers of targets.
        np.testing.assert_allclose(np.exp(near), np.exp(exact), atol=2e-3)
    np.testing.assert_allclose(rough.log_evidence, right.log_evidence, rtol=1e-5)


@functools.cache
def evidence():
    target = cases.TARGETS["single"]
    return slopes.program(lambda scene: cphd.update(target, *scene)[0].log_evidence)


@pytest.mark.parametrize("which", slopes.EDGES)
def test_evidence_has_right_gradients(which):
    slopes.check(evidence(), which)


def test_detection_depends_on_the_components_place():
    """Who is out of sight keeps its weight; in the plain filter it has its own mode."""
    edge, values = slopes.EDGES["field_of_view"][0], slopes.values_of("field_of_view")
    scene = slopes.scene_of(edge, values)
    update = jax.jit(cphd.update, static_argnums=0)
    found, _ = update(cases.TARGETS["single"], *scene)
    detect = 0.9 / (1 + np.exp(values.mean[:, 0] - 0.5))
    model, clutter, flat, p, detections = cases.plain("single", scene)
    model = model._replace(detect=detect)
    flat = [(w, m, P, n) for n, (w, m, P, _) in enumerate(flat)]
    missed, hits, _, _ = book.update(model, clutter, flat, p, detections)
    cases.check_weights("single", scene, found, missed, hits)
