"""Tests of `trackers.birth_times`, and of what is known of undetected targets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes
from reference.lives import gauss

from jaxtrack.models.birth import DetectionBirth, PoissonBirth
from jaxtrack.trackers import birth_times, undetected
from jaxtrack.types import Scan

pytestmark = pytest.mark.usefixtures("whole_matrices")

KEY = jax.random.key(0)
PLACES, RATES = np.array([-2.0, 5.0]), np.array([0.3, 0.9])
SCAN = Scan(np.array([[-1.0], [4.0]]), np.ones(2, bool), np.array(scenes.INTERVAL))


def params_of(drawn):
    """Two places of birth, one of which had targets before the first scan."""
    plain = scenes.params_of(drawn)
    mean = np.stack([PLACES, np.zeros(2)], 1)
    cov = np.repeat(plain.birth.cov, 2, axis=0)
    births = PoissonBirth(RATES, mean, cov, np.ones((2, 1)))
    first = jax.tree.map(lambda x: x[1:], births)
    return plain._replace(birth=births, undetected=first)


def test_first_detections_mix_times_of_birth_by_what_the_components_say():
    """By hand, after three scans without a detection, of components that differ."""
    drawn = scenes.draw(5)
    none = SCAN._replace(valid=np.zeros(2, bool))

    def see(params, size):
        hidden = undetected.begin(scenes.target, params, size, KEY, 3)
        for scan in (none, none, SCAN):
            args = scan.interval, KEY
            hidden = undetected.predict(scenes.target, params, hidden, *args)
            firsts = undetected.see(scenes.target, params, hidden, scan, KEY)
            hidden, _ = undetected.reduce(firsts.missed, size)
        return firsts.birth_prob, hidden.born.sum(1)

    told, total = jax.jit(see, static_argnums=1)(params_of(drawn), 8)
    model = scenes.model_of(drawn)
    F, P = model["transition"], model["stationary"]
    stay = drawn["survive"] * (1 - drawn["detect"])
    expected = np.zeros((2, 3))
    for k, z in enumerate((-1.0, 4.0)):
        for age in range(4):
            move = np.linalg.matrix_power(F, age)
            for place, rate in zip(PLACES, RATES, strict=True):
                if age == 3 and place != PLACES[1]:
                    continue  # before the first scan
                missed = stay**age / (1 - drawn["detect"] if age == 3 else 1.0)
                mean = (move @ np.array([place, 0.0]))[0]
                density = gauss(z, mean, P[0, 0] + drawn["sensor_var"])
                expected[k, min(age, 2)] += rate * missed * density
    expected /= expected.sum(1, keepdims=True)
    np.testing.assert_allclose(told, expected, rtol=1e-9)
    np.testing.assert_allclose(total, 1.0, rtol=1e-12)


def test_who_is_born_with_the_detection_was_not_there_before():
    births = DetectionBirth(
        rate=np.array(0.4),
        max_existence_prob=np.array(1.0),
        velocity_std=np.array([3.0]),
        extra_std=np.zeros(0),
        mode_prob=np.ones(1),
    )
    params = scenes.params_of(scenes.draw(0))._replace(birth=births, undetected=None)

    def see(params):
        hidden = undetected.begin(scenes.target, params, 2, KEY, 3)
        hidden = undetected.predict(scenes.target, params, hidden, SCAN.interval, KEY)
        return undetected.see(scenes.target, params, hidden, SCAN, KEY).birth_prob

    assert jax.jit(see)(params).tolist() == 2 * [[1.0, 0.0, 0.0]]


def test_new_trees_have_the_births_of_the_detections_that_began_them():
    old, first = np.full((1, 2), 0.5), np.array([[1.0, 0.0], [0.2, 0.8], [0.6, 0.4]])
    told = birth_times.added(old, jnp.asarray(first), np.array([2, 1]))
    np.testing.assert_array_equal(told, [old[0], first[2], first[1]])


def test_what_is_not_asked_for_is_not_there():
    assert birth_times.newborn(3, 0) is None
    assert birth_times.older(None) is None
    assert birth_times.number(None) == 0
    assert birth_times.detected(jnp.zeros((2, 1)), None) is None
    assert birth_times.added(None, jnp.ones((2, 1)), jnp.zeros(1, int)) is None
