"""Births from two points, against straight lines and sampled noise."""

import jax
import numpy as np

from jaxtrack.models.motion import ConstantAcceleration, ConstantVelocity
from jaxtrack.models.pairs import PairBirth
from jaxtrack.models.sensor import Position, RangeBearing, Timed


def array(*values):
    return np.array(values, float)


def pair_birth(num_axes=1, extra=0, **changes):
    birth = PairBirth(
        rate=np.array(2.0),
        max_existence_prob=np.array(0.6),
        max_speed=np.array(10.0),
        extra_std=np.arange(2.0, 2.0 + extra),
        mode_prob=array(0.7, 0.3),
    )
    return birth._replace(**changes)


def propose(birth, sensor, motion, earlier, now, interval):
    def leftovers(points, prob):
        points = np.array(points, float)
        return points.reshape(len(prob), -1), array(*prob)

    call = jax.jit(birth.propose)
    return call(sensor, motion, *leftovers(*now), *leftovers(*earlier), interval)


def test_partners_are_near_enough_and_the_nearest():
    places = propose(
        pair_birth(),
        Position(array(1.0)),
        ConstantVelocity(array(1.0)),
        ([[0.0], [4.0], [100.0]], (1.0, 1.0, 0.0)),
        ([[3.0], [100.0], [12.0], [5.0]], (0.9, 1.0, 1.0, 0.0)),
        0.5,
    )
    # 3 goes with 4; 100's partner is explained, 12 has none in reach, 5 is explained.
    np.testing.assert_allclose(places.existence_prob, [0.6, 0, 0, 0])
    np.testing.assert_allclose(places.mean[0], [3.0, -2.0])
    assert np.isfinite(places.cov).all()


def test_shares_follow_how_unexplained_both_are():
    places = propose(
        pair_birth(max_existence_prob=np.array(1.0), rate=np.array(0.4)),
        Position(array(1.0)),
        ConstantVelocity(array(1.0)),
        ([[0.0], [50.0]], (0.5, 1.0)),
        ([[1.0], [51.0]], (0.8, 0.6)),
        0.5,
    )
    np.testing.assert_allclose(places.existence_prob, 0.2 * array(0.4, 0.6) / 1.0)


def test_moments_are_those_of_the_two_points():
    """Positions of independent noise, the velocity their difference over time."""
    noise, interval = array(2.0, 3.0), 0.8
    places = propose(
        pair_birth(extra=2),
        Position(noise),
        ConstantAcceleration(array(1.0, 1.0)),
        ([[0.0, 1.0]], (1.0,)),
        ([[4.0, -2.0]], (1.0,)),
        interval,
    )
    motion = ConstantAcceleration(array(1.0, 1.0))
    rng = np.random.default_rng(0)
    first = array(0.0, 1.0) + rng.normal(size=(200_000, 2)) * noise
    last = array(4.0, -2.0) + rng.normal(size=(200_000, 2)) * noise
    where, speed = np.array(motion.position_index), np.array(motion.velocity_index)
    mean, cov = places.mean[0], places.cov[0]
    drawn = np.concatenate([last, (last - first) / interval], 1)
    index = np.concatenate([where, speed])
    np.testing.assert_allclose(mean[index], drawn.mean(0), atol=0.05)  # 3 std errors
    counted = np.cov(drawn.T)
    np.testing.assert_allclose(cov[np.ix_(index, index)], counted, atol=0.15)
    rest = [i for i in range(motion.dim) if i not in index]
    np.testing.assert_allclose(cov[rest, rest], [4.0, 9.0])
    np.testing.assert_allclose(mean[np.array(rest)], 0)


def test_ages_count_as_time():
    """Seen at 0.2 s before the last scan's end and 0.1 s before this one's."""
    places = propose(
        pair_birth(),
        Timed(Position(array(1.0))),
        ConstantVelocity(array(1.0)),
        ([[0.0, 0.2]], (1.0,)),
        ([[3.0, 0.1]], (1.0,)),
        0.5,
    )
    np.testing.assert_allclose(places.mean[0], [3.0 + 0.1 * 5.0, 5.0])
    # x = p2 + a v, v = (p2 - p1) / 0.6, each p of variance 1.
    ahead = 0.1 / 0.6
    expected = (1 + ahead) ** 2 + ahead**2
    np.testing.assert_allclose(places.cov[0, 0, 0], expected)
    np.testing.assert_allclose(places.cov[0, 0, 1], (1 + 2 * ahead) / 0.6)
    np.testing.assert_allclose(places.cov[0, 1, 1], 2 / 0.36)


def test_no_time_between_is_no_pair():
    places = propose(
        pair_birth(),
        RangeBearing(array(1.0, 0.1), array(0.0, 0.0), np.array(0.0)),
        ConstantVelocity(array(1.0, 1.0)),
        ([[5.0, 0.1]], (1.0,)),
        ([[5.0, 0.1]], (1.0,)),
        0.0,
    )
    assert places.existence_prob[0] == 0
    assert np.isfinite(places.cov).all()
