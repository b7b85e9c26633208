"""Tests of `assign.sample`: frequencies against enumeration, with fixed seeds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import assign as reference
from scipy import stats
from test_assign_k_best_of_many import events

from jaxtrack.assign import best, sample

INF = np.inf
DRAWS = 10_000
LEAST = 1e-3  # the seeds are fixed, so that a right sampler passes for good


def scores(seed, gate):
    return reference.scores(np.random.default_rng(seed), 4, 4, gate) / 2


def surprise(columns, listed):
    """The p-value of as many draws of whole joint events."""
    listed = dict(listed)
    weight = np.exp(np.array(list(listed.values())))
    expected = DRAWS * weight / weight.sum()
    count = dict.fromkeys(listed, 0)
    for column in np.asarray(columns).tolist():
        count[tuple(column)] += 1  # KeyError: an event that is impossible
    seen = np.array(list(count.values()), float)
    rare = expected < 5
    seen = np.append(seen[~rare], seen[rare].sum())
    expected = np.append(expected[~rare], expected[rare].sum())
    return stats.chisquare(seen[expected > 0], expected[expected > 0]).pvalue


@pytest.mark.parametrize("gate", [0.4, 1.0])
def test_events_are_as_frequent_as_they_are_likely(gate):
    log_score = scores(1, gate)
    log_score[0, -1] = -INF
    keys = jax.random.split(jax.random.key(0), DRAWS)
    drawn = jax.jit(jax.vmap(sample.sample, (0, None)))(keys, jnp.asarray(log_score))
    assert drawn.exact.all()
    assert drawn.feasible.all()
    assert surprise(drawn.column, reference.events(log_score)) > LEAST


def test_gibbs_comes_to_the_same_frequencies():
    log_score = scores(2, 0.8)
    start = best.best(jnp.asarray(log_score)).column
    keys = jax.random.split(jax.random.key(0), DRAWS)

    def walk(key):
        return sample.gibbs(key, jnp.asarray(log_score), 30, start)

    assert surprise(jax.jit(jax.vmap(walk))(keys), reference.events(log_score)) > LEAST


def test_a_walk_comes_to_every_way_of_having_no_detection():
    """Three tracks and detections, absent or missed; one cannot be missed."""
    log_score = np.random.default_rng(5).normal(size=(3, 5))
    log_score[0, 3], log_score[1, 0] = -INF, -INF
    keys = jax.random.split(jax.random.key(2), DRAWS)
    start = jnp.full(3, 4)

    def go(key):
        return sample.walk(key, jnp.asarray(log_score), 8, start, ways=2)[-1]

    assert surprise(jax.jit(jax.vmap(go))(keys), events(log_score)) > LEAST


def test_large_clusters_are_walked_and_told():
    log_score = np.full((5, 6), -INF)
    log_score[:4, :4] = scores(3, 1.0)[:, :4]
    log_score[4, 4] = 1.0
    log_score[:, 5] = 0.0
    keys = jax.random.split(jax.random.key(1), DRAWS)
    draw = jax.jit(
        jax.vmap(lambda key: sample.sample(key, jnp.asarray(log_score), 3, 20))
    )
    drawn = draw(keys)
    np.testing.assert_array_equal(drawn.exact[0], [False] * 4 + [True])
    assert surprise(drawn.column, reference.events(log_score)) > LEAST


def test_nothing_feasible_and_nothing_detected_leave_all_missed():
    key = jax.random.key(0)
    none = jax.jit(sample.sample)(key, jnp.array([[1.0, -INF], [1.0, -INF]]))
    assert not none.feasible
    np.testing.assert_array_equal(none.column, [1, 1])
    empty = jax.jit(sample.sample)(key, jnp.zeros((2, 1)))
    np.testing.assert_array_equal(empty.column, [0, 0])


def test_settings_are_checked():
    with pytest.raises(ValueError, match="max_cluster is 0; give 1 to 20"):
        sample.sample(jax.random.key(0), jnp.zeros((2, 3)), max_cluster=0)
