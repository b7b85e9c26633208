"""Tests of what the multi-Bernoulli trackers share: labels, births, merging."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.models import birth, motion, probability, sensor
from jaxtrack.targets import single
from jaxtrack.trackers import alternatives, bernoulli
from jaxtrack.types import Gaussian, Scan

PARAMS = single.Params(
    motion=motion.ConstantVelocity(jnp.array([0.5])),
    sensor=sensor.Position(jnp.array([2.0])),
    survive=probability.Constant(jnp.array(0.9)),
    detect=probability.Constant(jnp.array(0.9)),
)
TARGET = single.single()

tell_apart = jax.jit(bernoulli.tell_apart, static_argnums=2)
merge = jax.jit(alternatives.merge, static_argnums=(0, 2))


def tracks_of(prob, label, alias=None, place=None):
    num = len(prob)
    place = jnp.zeros(num) if place is None else jnp.array(place)
    mean = jnp.stack([place, jnp.zeros(num)], 1)
    cov = jnp.tile(jnp.array([[4.0, 1.0], [1.0, 2.0]]), (num, 1, 1))
    alias = [-1] * num if alias is None else alias
    belief = Gaussian(mean, cov)
    return bernoulli.Tracks(jnp.array(prob), belief, jnp.array(label), jnp.array(alias))


def test_only_reported_tracks_are_rivals():
    tracks = tracks_of([0.9, 0.8, 0.7, 0.4], [3, 5, 3, 3])
    named, shown, following = tell_apart(tracks, jnp.array(10), 0.5)
    assert shown.tolist() == [3, 5, 10, 3]
    assert named.label.tolist() == [3, 5, 3, 3]
    assert named.alias.tolist() == [-1, -1, 10, -1]
    assert following == 11


def test_two_targets_under_one_label_keep_their_names_when_their_order_flips():
    first = tracks_of([0.84, 0.83], [7, 7])
    named, shown, following = tell_apart(first, jnp.array(12), 0.5)
    assert shown.tolist() == [7, 12]
    flipped = jax.tree.map(lambda x: x[::-1], named)
    _, shown, following = tell_apart(flipped, following, 0.5)
    assert shown.tolist() == [12, 7]
    assert following == 13


def test_a_rival_left_alone_is_reported_under_the_label():
    alone = tracks_of([0.9, 0.2], [7, 7], alias=[12, -1])
    _, shown, _ = tell_apart(alone, jnp.array(13), 0.5)
    assert shown.tolist() == [7, 7]


def test_rivals_with_one_alias_are_told_apart():
    split = tracks_of([0.9, 0.8, 0.7], [7, 7, 7], alias=[-1, 9, 9])
    _, shown, following = tell_apart(split, jnp.array(12), 0.5)
    assert shown.tolist() == [7, 9, 12]
    assert following == 13


def test_merging_joins_only_what_is_near_and_of_one_label():
    tracks = tracks_of([0.5, 0.4, 0.3, 0.2], [1, 1, 1, 2], place=[0.0, 2.0, 90.0, 0.0])
    merged = merge(TARGET, tracks, 4.0)
    # Zeros need an absolute bound; 1e-12 is rounding.
    np.testing.assert_allclose(merged.existence_prob, [0.9, 0.3, 0.2, 0.0], atol=1e-12)
    assert merged.label[:3].tolist() == [1, 1, 2]
    # The pair in proportion 5 to 4: mean 8/9, and the spread of the means is kept.
    np.testing.assert_allclose(merged.belief.mean[0], [8 / 9, 0.0], atol=1e-12)
    spread = (5 * (8 / 9) ** 2 + 4 * (10 / 9) ** 2) / 9
    expected = [[4.0 + spread, 1.0], [1.0, 2.0]]
    np.testing.assert_allclose(merged.belief.cov[0], expected, atol=1e-12)
    np.testing.assert_allclose(merged.belief.mean[1, 0], 90.0)


def test_merged_tracks_exist_with_one_at_most():
    merged = merge(TARGET, tracks_of([0.9, 0.8], [1, 1]), 4.0)
    np.testing.assert_allclose(merged.existence_prob, [1.0, 0.0])


def test_a_label_is_reported_once_by_all_its_tracks_together():
    tracks = tracks_of([0.45, 0.4, 0.3, 0.2], [1, 1, 2, 1])
    assert alternatives.heirs(tracks, 0.6).tolist() == [True, False, False, False]
    assert not alternatives.heirs(tracks_of([0.0, 0.0], [-1, -1]), 0.5).any()


@pytest.mark.parametrize("num_births", [2, 5])
def test_births_keep_the_likeliest_and_count_the_rest(num_births):
    scan = Scan(
        jnp.array([[1.0], [2.0], [3.0]]), jnp.array([True, True, False]), jnp.array(2.0)
    )
    driven = birth.DetectionBirth(
        rate=jnp.array(0.1),
        max_existence_prob=jnp.array(0.5),
        velocity_std=jnp.array([3.0]),
        extra_std=jnp.zeros(0),
        mode_prob=jnp.ones(1),
    )
    unexplained = jnp.array([0.25, 0.75, 0.9])
    births, lost = jax.jit(bernoulli.from_unexplained, static_argnums=4)(
        driven, PARAMS, scan, unexplained, num_births
    )
    prob = [0.15, 0.05, 0.0, 0.0, 0.0][:num_births]
    # Zeros need an absolute bound; 1e-12 is rounding.
    np.testing.assert_allclose(births.existence_prob, prob, atol=1e-12)
    np.testing.assert_allclose(births.mean[:2, 0], [2.0, 1.0])
    np.testing.assert_allclose(lost, 0.0, atol=1e-12)
    _, lost = bernoulli.from_unexplained(driven, PARAMS, scan, unexplained, 1)
    np.testing.assert_allclose(lost, 0.05, atol=1e-12)


def test_poisson_births_begin_one_track_a_place():
    places = Gaussian(jnp.ones((2, 2)), jnp.tile(jnp.eye(2), (2, 1, 1)))
    births = birth.PoissonBirth(jnp.array([0.1, 0.7]), *places, jnp.ones((2, 1)))
    born = bernoulli.begin(TARGET, PARAMS, births, jnp.array(4), jax.random.key(0))
    np.testing.assert_allclose(born.existence_prob, 1 - np.exp([-0.1, -0.7]))
    assert born.label.tolist() == [4, 5]


def test_survival_lowers_existence_and_moves_the_belief():
    tracks = tracks_of([0.5, 0.0], [1, -1])
    moved = bernoulli.predict(TARGET, PARAMS, tracks, jnp.array(2.0))
    np.testing.assert_allclose(moved.existence_prob, [0.45, 0.0])
    np.testing.assert_allclose(moved.belief.cov[0, 0, 0], 4 + 4 + 8 + 0.5 * 8 / 3)
