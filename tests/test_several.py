"""PHD, CPHD and CBMeMBer filters with two sensors: one scan against enumeration."""

import jax
import numpy as np
import pytest
from cases import slopes
from cases import two_sensors as cases
from reference import kalman as book

from jaxtrack.targets import single
from jaxtrack.trackers import several, several_cbmember, several_phd

pytestmark = pytest.mark.usefixtures("whole_matrices")

NAMES = "phd", "cphd", "cbmember"
EVERY = [(name, form) for name in NAMES for form in cases.FORMS]
every_form = pytest.mark.parametrize(("name", "form"), EVERY)


def scenes_of(number, seed=0, **kind):
    rng = np.random.default_rng(seed)
    return [cases.scene(rng, **kind) for _ in range(number)]


def in_order(estimate):
    """Of each scene the probabilities of all slots, likeliest first."""
    return -np.sort(-estimate.existence_prob, axis=1)


def assert_same(found, expected):
    """The same slots, but for empty ones that only one of them has."""
    np.testing.assert_allclose(found.log_evidence, expected.log_evidence, rtol=1e-10)
    # Absolute: of probabilities.
    np.testing.assert_allclose(in_order(found), in_order(expected), atol=1e-10)
    first = found.mean[:, 0], found.cov[:, 0]
    for one, other in zip(
        first, (expected.mean[:, 0], expected.cov[:, 0]), strict=True
    ):
        # Absolute: of metres.
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@every_form
def test_sensor_that_did_not_look_teaches_nothing(name, form):
    """What is left is the tracker with the other sensor alone."""
    scenes = scenes_of(20)
    expected = cases.answers(name, None, scenes, (0, 1))
    assert_same(cases.answers(name, form, scenes, (0, 1), (True, False)), expected)
    # The same sensor, now the second one.
    assert_same(cases.answers(name, form, scenes, (1, 0), (True, False)), expected)


@every_form
def test_blind_sensor_without_clutter_teaches_nothing(name, form):
    scenes = [
        one._replace(
            detect=(one.detect[0], 0.0), rate=(one.rate[0], 0.0), z=(one.z[0], [])
        )
        for one in scenes_of(20)
    ]
    expected = cases.answers(name, None, scenes)
    assert_same(cases.answers(name, form, scenes), expected)


@pytest.mark.parametrize(("name", "form"), [*EVERY[2:4], ("cbmember", "product")])
def test_one_target_at_most_is_exact(name, form):
    """In number and evidence, with clutter at both sensors."""
    scenes = scenes_of(50, targets=1)
    found = cases.answers(name, form, scenes)
    log_evidence, number = cases.exactly(name, scenes)
    np.testing.assert_allclose(found.log_evidence, log_evidence, rtol=1e-9)
    np.testing.assert_allclose(found.num_mean, number, rtol=1e-8)


# Bounds on the root mean square of the error of the expected number and of the
# log-evidence, a quarter above what was measured over 60 scenes of up to two targets.
MEASURED = {
    ("phd", "iterated"): (0.20, 0.28),
    ("phd", "product"): (0.09, 0.17),
    ("cphd", "iterated"): (0.054, 0.11),
    ("cphd", "product"): (0.064, 0.16),
    ("cbmember", "iterated"): (0.14, 0.27),
    ("cbmember", "product"): (0.14, 0.18),
}


@every_form
def test_two_targets_are_near_bayes(name, form):
    scenes = scenes_of(60)
    found = cases.answers(name, form, scenes)
    log_evidence, number = cases.exactly(name, scenes)
    errors = found.num_mean - number, found.log_evidence - log_evidence
    rms = np.array([np.sqrt((x**2).mean()) for x in errors])
    assert (rms < MEASURED[name, form]).all()


@every_form
def test_sure_target_without_clutter_is_the_stacked_kalman_filter(name, form):
    one = scenes_of(1, targets=1, count=1)[0]
    near = [one.mean[:1] + 0.7, one.mean[:1] - 0.4]
    r = np.array([1.0 - 1e-12, 0.0])
    one = one._replace(r=r, rate=(0.0, 0.0), detect=(1.0, 1.0), z=near)
    found = cases.answers(name, form, [one])
    stacked = book.update(
        np.array([one.mean[0], 0.0]),
        np.diag([one.variance[0], 1.0]),
        np.array([[1.0, 0.0], [1.0, 0.0]]),
        0,
        np.diag(np.square(one.std)),
        np.array([one.z[0][0], one.z[1][0]]),
    )
    np.testing.assert_allclose(found.num_mean[0], 1.0, rtol=1e-6)
    np.testing.assert_allclose(found.mean[0, 0], stacked[0], rtol=1e-6)
    # Absolute: of square metres.
    np.testing.assert_allclose(found.cov[0, 0], stacked[1], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_product_form_knows_no_order(name):
    scenes = scenes_of(20)
    both = [cases.answers(name, "product", scenes, x) for x in ((0, 1), (1, 0))]
    np.testing.assert_allclose(both[0].log_evidence, both[1].log_evidence, rtol=1e-10)
    # Absolute: of probabilities.
    np.testing.assert_allclose(in_order(both[0]), in_order(both[1]), atol=1e-9)


@pytest.mark.parametrize("name", ["phd", "cphd"])
def test_a_newborn_in_sight_of_one_sensor_is_one_more_target(name):
    """Far from it stands a sure target; what both sensors say of that is no news."""
    rng = np.random.default_rng(0)
    one = cases.scene(rng)._replace(
        r=np.array([0.999, 0.1]),
        mean=np.array([-8.0, 8.0]),
        variance=np.array([0.3, 0.3]),
        detect=(0.98, 0.98),
        rate=(0.3, 0.3),
        z=(np.array([-8.1, 8.2]), np.array([-7.7, 7.8])),
    )
    found = cases.answers(name, "product", [one])
    log_evidence, number = cases.exactly(name, [one])
    # Measured: 3e-5 and 2e-3. In one group it is 7e-3 and more, and 3e-2 and more.
    np.testing.assert_allclose(found.num_mean, number, rtol=1e-4)
    np.testing.assert_allclose(found.log_evidence, log_evidence, atol=3e-3)


@every_form
def test_evidence_has_right_gradients(name, form):
    one = scenes_of(1, seed=5)
    params, scan = cases.given(name, one)
    params = jax.tree.map(lambda x: x[0], params)
    moved, scale = slopes.walks(params)
    num = len(jax.tree.leaves(moved)[0])
    every = jax.tree.map(lambda x, y: np.concatenate([x[None], y]), params, moved)
    scans = jax.tree.map(lambda x: np.repeat(x, num + 1, axis=0), scan)
    (found, _), slope = cases.program(name, form)(every, scans)
    slope = jax.tree.map(lambda x: np.asarray(x[0]), slope)
    # Absolute: what differences of numbers of about ten can resolve.
    slopes.assert_right(
        params, slope, slopes.differences(found[1:]), scale, rtol=1e-5, atol=1e-7
    )


@every_form
def test_gradients_are_finite_at_the_edges(name, form):
    """No detections, a blind sensor, one asleep, no clutter, sure detection."""
    rng = np.random.default_rng(2)
    some = cases.scene(rng)
    scenes = [
        some._replace(z=([], [])),
        some._replace(detect=(0.0, 0.9)),
        some._replace(rate=(0.0, 0.0)),
        some._replace(detect=(1.0, 1.0)),
        some._replace(r=np.zeros(cases.NUM)) if name == "cbmember" else some,
    ]
    for looked in ((True, True), (True, False)):
        given = cases.given(name, scenes, looked=looked)
        (_, found), slope = cases.program(name, form)(*given)
        for x in jax.tree.leaves((found, slope)):
            assert np.isfinite(x[x > -np.inf]).all()


def test_settings_that_make_no_sense_are_refused():
    target = single.single()
    for make in (
        several_phd.several_phd,
        several_phd.several_cphd,
        several_cbmember.several_cbmember,
    ):
        with pytest.raises(ValueError, match='form is "?.?parallel'):
            make(target, form="parallel")
    with pytest.raises(ValueError, match="max_targets is 0"):
        several_phd.several_cphd(target, max_targets=0)
    with pytest.raises(ValueError, match="max_tracks is 0"):
        several_cbmember.several_cbmember(target, max_tracks=0)


def test_sensor_asleep_detects_nothing():
    params = cases.params_of(scenes_of(1)[0])
    scans = cases.scans_at(scenes_of(1)[0], looked=(False, True))
    (own, scan), _ = several.split(params, scans)
    assert not scan.valid.any()
    assert own.clutter.rate == 0
