"""Groups of components that share detections: who is in them, and how many targets."""

import itertools
import math

import jax
import numpy as np
import pytest

from jaxtrack.trackers import counting, intensity, several_groups

join = jax.jit(several_groups.join)


@pytest.mark.parametrize("seed", range(3))
def test_numbers_are_those_of_all_ways_to_divide_them(seed):
    rng = np.random.default_rng(seed)
    size, num = 4, 3
    prior, share = rng.dirichlet(np.ones(size)), rng.dirichlet(np.ones(num))
    share[1] = 0.0  # an empty slot
    explained, theta = rng.uniform(0.1, 9, (num, size)), rng.uniform(0.2, 5, num)
    expected, joint = np.zeros(num), np.zeros(size)
    for counts in itertools.product(range(size), repeat=num):
        n = sum(counts)
        if n < size:
            worth = prior[n] * math.factorial(n)
            for g, m in enumerate(counts):
                worth *= (share[g] * theta[g]) ** m / math.factorial(m)
                worth *= explained[g, m]
            joint[n] += worth
            expected += worth * np.array(counts)
    with np.errstate(divide="ignore"):
        given = map(np.log, (prior, share, explained, theta))
        found, each = join(*given)
    np.testing.assert_allclose(np.exp(found), joint, rtol=1e-12)
    # Absolute: of the empty group, of which nothing is expected.
    np.testing.assert_allclose(each, expected / joint.sum(), rtol=1e-12, atol=1e-12)


def sighting(log_weight, log_score):
    num, num_detections = log_score.shape
    return intensity.Sighting(
        missed=None,
        views=None,
        log_weight=log_weight,
        log_miss=np.log(np.linspace(0.2, 0.6, num)),
        log_score=log_score,
        log_clutter=np.log(np.full(num_detections, 0.3)),
    )


def test_groups_go_by_the_detections_of_all_sensors():
    """0 and 2 by the first sensor, 2 and 4 by the second; 3 is an empty slot."""
    log_weight = np.log(np.array([0.5, 0.8, 0.1, 1e-300, 1.0]))
    log_weight[3] = -np.inf
    none, some = -60.0, -1.0
    first = np.full((5, 2), none)
    first[[0, 2], 0] = some
    first[[1, 3], 1] = some
    second = np.full((5, 3), none)
    second[[2, 4], 2] = some
    sightings = [sighting(log_weight, first), sighting(log_weight, second)]
    found = jax.jit(several_groups.groups)(sightings)
    assert found.tolist() == [0, 1, 0, 3, 0]


def test_one_group_explains_a_scan_as_the_cphd_filter_does():
    rng = np.random.default_rng(4)
    log_weight = np.log(rng.uniform(0.1, 1, 4))
    seen = sighting(log_weight, rng.normal(size=(4, 3)))
    log_number = np.log(rng.dirichlet(np.ones(6)))

    @jax.jit
    def both(seen, log_number):
        explained = several_groups.explain(seen, np.zeros(4, int), 6)
        return counting.correct(seen, log_number, 1.4), explained

    (update, posterior), explained = both(seen, log_number)
    joint = log_number + explained[0]
    evidence = np.logaddexp.reduce(joint) + seen.log_clutter.sum() - 1.4
    np.testing.assert_allclose(evidence, update.log_evidence, rtol=1e-12)
    np.testing.assert_allclose(joint - np.logaddexp.reduce(joint), posterior, rtol=1e-9)
