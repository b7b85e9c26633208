"""The scenarios of the likely modes: what happens in them, and what comes of it."""

import functools

import jax
import numpy as np
import pytest

from jaxtrack.scenarios import gomes_crossing, manoeuvre_digraph
from jaxtrack.study import follow

MAKERS = {"gomes": gomes_crossing.make, "digraph": manoeuvre_digraph.make}


@functools.cache
def followed(scenario, tracker, runs, **settings):
    made = MAKERS[scenario](**settings)
    return jax.tree.map(np.array, follow.follow(made, tracker, runs))


def rms(values):
    """Over all runs, scan by scan, of one array [R, T, N]."""
    return np.sqrt((values**2).mean(0))


def test_targets_of_gomes_cross_once_at_the_meeting():
    for angle in (10.0, 45.0, 90.0):
        truth = gomes_crossing.truth(angle)
        place = np.array(truth.state)[:, :, [0, 2]]
        gap = np.linalg.norm(place[:, 0] - place[:, 1], axis=1)
        np.testing.assert_allclose(place[30], [[3000.0, 4000.0]] * 2)
        assert gap[:29].min() > 20.0
        assert gap[31:].min() > 20.0
        # They come nearer until they meet and part from then on.
        assert (np.diff(gap[15:31]) < 0).all()
        assert (np.diff(gap[30:]) > 0).all()
        velocity = np.array(truth.state)[30][:, [1, 3]]
        cosine = velocity[0] @ velocity[1] / 150.0**2
        np.testing.assert_allclose(np.degrees(np.arccos(cosine)), angle)


def test_targets_of_gomes_turn_as_told_and_keep_their_speed():
    state = np.array(gomes_crossing.truth(45.0).state)
    velocity = state[..., [1, 3]]
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=-1), 150.0)
    heading = np.unwrap(np.arctan2(velocity[..., 1], velocity[..., 0]), axis=0)
    turned = np.diff(heading, axis=0)
    # Angles of a tenth, from headings of some rad: a few roundings of those.
    np.testing.assert_allclose(turned[:, 0], 0.05, atol=1e-12)
    legs = np.repeat([-0.05, 0.0, 0.1, 0.0], [15, 12, 18, 15])
    np.testing.assert_allclose(turned[:, 1], legs, atol=1e-12)


def test_the_radar_of_gomes_is_within_the_bounds_of_the_conversion():
    place = np.array(gomes_crossing.truth(45.0).state)[..., [0, 2]]
    range_std, bearing_std = gomes_crossing.SENSOR_STD
    furthest = np.linalg.norm(place, axis=-1).max()
    assert furthest * bearing_std**2 / range_std < 0.4
    assert bearing_std < 0.4


def test_detections_of_gomes_are_in_the_order_of_the_targets():
    """So that the association probabilities tell who has whose."""
    made = gomes_crossing.make()
    _, scans = jax.jit(made.simulate)(jax.random.key(0))
    assert scans.valid.all()
    place = np.array(made.world.truth.state)[..., [0, 2]]
    assert np.linalg.norm(scans.detections - place, axis=-1).max() < 200.0


def test_the_digraph_is_a_grid_and_the_flight_keeps_to_it():
    near = manoeuvre_digraph.neighbours()
    assert sorted(near.sum(1)) == 4 * [1] + 4 * [2] + 5 * [4]
    np.testing.assert_array_equal(near, near.T)
    p = np.array(manoeuvre_digraph.switching_matrix(0.94))
    np.testing.assert_allclose(p.sum(1), 1.0)
    np.testing.assert_array_equal(p > 0, near | np.eye(13, dtype=bool))
    state = np.array(manoeuvre_digraph.truth().state)[:, 0]
    acceleration = np.diff(state[:, [1, 3]], axis=0)
    nodes = np.array(manoeuvre_digraph.NODES)
    at = [np.flatnonzero((nodes == a.round(6)).all(1))[0] for a in acceleration]
    for before, after in zip(at[:-1], at[1:], strict=True):
        assert p[before, after] > 0
    assert len(set(at)) > 5
    # Position follows velocity and acceleration, exactly.
    half = state[:-1, [1, 3]] + acceleration / 2
    np.testing.assert_allclose(np.diff(state[:, [0, 2]], axis=0), half)


@pytest.mark.slow
def test_likely_modes_are_as_good_as_all_thirteen():
    """The docstring's numbers: the same errors with little more than a third."""
    full, likely = (followed("digraph", x, 100) for x in ("imm-jpda", "lms-jpda"))
    assert full.errors.tracked.all()
    assert likely.errors.tracked.all()
    for field in ("position", "velocity"):
        ratio = [
            np.sqrt((getattr(x.errors, field) ** 2).mean()) for x in (likely, full)
        ]
        assert 0.97 < ratio[0] / ratio[1] < 1.01
    assert full.num_active.mean() > 12.5
    assert likely.num_active.mean() < 5.2


@pytest.mark.slow
def test_the_crossing_of_gomes_gives_the_numbers_of_its_docstring():
    """The peak of the likely modes is above that of all modes, not below."""
    full, likely = (followed("gomes", x, 300) for x in ("imm-jpda", "lms-jpda"))
    peaks = []
    for one in (full, likely):
        kept = ~follow.swapped(one)
        assert kept.mean() > 0.99
        position, velocity = one.errors.position[kept], one.errors.velocity[kept]
        peaks += [rms(position)[24:42].max(), rms(velocity)[24:42].max()]
    np.testing.assert_allclose(peaks, [33.5, 29.1, 37.8, 30.6], rtol=0.06)
    assert full.num_active.mean() == 5
    assert 2.5 < likely.num_active.mean() < 3.1
    own = full.association_prob[:, 30, 0, 0].mean()
    assert 0.3 < own < 0.7  # where they meet, nobody can tell
