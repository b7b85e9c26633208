"""Tests of `trackers.oracle` against all lives of all targets, one by one."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.small_scenes import (
    BOX,
    INTERVAL,
    SIZES,
    detections,
    draw,
    model_of,
    params_of,
    scans_of,
    stacked,
    target,
)
from reference import lives

from jaxtrack.trackers import enumeration, oracle
from jaxtrack.types import Scan

NUM, MAX, NUMBERS = 40, 8, 40


@functools.cache
def scenes(**changes):
    """Many random problems, their detections, and both stacked."""
    drawn = [{**draw(seed), **changes} for seed in range(NUM)]
    places = [detections(seed) for seed in range(NUM)]
    return drawn, places, (stacked(drawn), stacked(places))


@functools.cache
def solved():
    return solve(*scenes()[2])


@jax.jit
@jax.vmap
def solve(drawn, places, counts=None):
    params = params_of(drawn)
    scans = scans_of(places)
    return oracle.posterior(
        target, params, scans, jax.random.key(0), counts, max_targets=MAX
    )


def compare(found, k, expected, numbers, sizes=SIZES):
    listed = enumeration.table(sizes)
    total = sum(expected.values())
    assert len(listed.member) == len(expected)
    weights = [
        expected[tuple(map(tuple, listed.track[row].tolist()))] for row in listed.member
    ]
    prob = np.exp(found.log_prob[k])
    np.testing.assert_allclose(prob, np.array(weights) / total, rtol=1e-10)
    np.testing.assert_allclose(found.log_evidence[k], np.log(total), rtol=1e-11)
    np.testing.assert_allclose(found.num_prob[k], numbers, rtol=1e-10)


def test_posterior_evidence_and_number_are_those_of_all_lives():
    (drawn, places, _), found = scenes(), solved()
    for k in range(NUM):
        compare(found, k, *lives.posterior(places[k], model_of(drawn[k]), MAX + 1))


def test_numbers_need_not_be_poisson():
    rng = np.random.default_rng(7)
    drawn, places, given = scenes(births=0.0)
    number = rng.dirichlet(np.ones(5), NUM)
    false = rng.dirichlet(np.ones(4), NUM)
    # Larger numbers are impossible.
    padded = [np.pad(x, [(0, 0), (0, NUMBERS - x.shape[1])]) for x in (number, false)]
    found = solve(*given, oracle.Counts(*map(jnp.log, padded)))
    for k in range(NUM):
        model = model_of(drawn[k], number_prob=number[k], false_prob=false[k])
        compare(found, k, *lives.posterior(places[k], model, MAX + 1))


def test_poisson_numbers_given_as_such_change_nothing():
    drawn, _, given = scenes(births=0.0)
    number = np.arange(NUMBERS)
    factorial = np.cumsum(np.log(np.maximum(number, 1)))

    def poisson(rate):
        return number * np.log(rate) - rate - factorial

    counts = stacked(
        [oracle.Counts(poisson(x["undetected"]), poisson(x["clutter"])) for x in drawn]
    )
    told, plain = solve(*given, counts), solve(*given)
    for name in ("log_prob", "log_evidence", "num_prob", "track_prob"):
        np.testing.assert_allclose(
            getattr(told, name), getattr(plain, name), rtol=1e-10, err_msg=name
        )


def test_tracks_are_believed_as_kalman_filters_do():
    places, model = detections(3), model_of(draw(3))
    found = jax.tree.map(lambda x: x[3], solved())
    for track, mean in zip(
        enumeration.table(SIZES).track, found.belief.mean, strict=True
    ):
        expected = lives.likelihood(track, places, model)[1]
        # Means of order 1, some of which are 0.
        np.testing.assert_allclose(mean, expected, rtol=1e-10, atol=1e-14)
    prob = found.track_prob
    member = enumeration.table(SIZES).member
    np.testing.assert_allclose(prob, np.exp(found.log_prob) @ member, rtol=1e-12)


def test_a_slot_that_is_not_valid_is_nobodys():
    drawn, places = draw(5), detections(5)
    full = scans_of(places)
    longer = [*full[:2], full[2]._replace(valid=jnp.array([True, False]))]
    short = [*full[:2], jax.tree.map(lambda x: x[:1] if x.ndim else x, full[2])]
    key = jax.random.key(0)
    find = jax.jit(lambda scans: oracle.posterior(target, params_of(drawn), scans, key))
    padded, plain = find(longer), find(short)
    np.testing.assert_allclose(padded.log_evidence, plain.log_evidence, rtol=1e-12)
    np.testing.assert_allclose(padded.num_prob, plain.num_prob, rtol=1e-10)


@pytest.mark.parametrize("sizes", [(), (0,), (3,), (2, 0, 1), (2, 3, 2)])
def test_hypotheses_are_counted_and_listed_once(sizes):
    listed = enumeration.table(sizes)
    assert len(listed.member) == enumeration.count(sizes)
    assert len({tuple(row) for row in listed.member.tolist()}) == len(listed.member)
    for row, num, false in zip(
        listed.member, listed.num_tracks, listed.num_false, strict=True
    ):
        used = [
            (k, j)
            for track in listed.track[row].tolist()
            for k, j in enumerate(track)
            if j >= 0
        ]
        assert len(used) == len(set(used))
        assert num == row.sum()
        left = [m - sum(k == scan for k, _ in used) for scan, m in enumerate(sizes)]
        assert false.tolist() == left
    if sizes == (2, 3, 2):
        assert len(listed.member) == 1712  # the number that the paper's extract has


def test_too_many_hypotheses_are_refused_before_they_are_listed():
    with pytest.raises(ValueError, match=r"num_detections is \(9, 9, 9\), which makes"):
        enumeration.table((9, 9, 9))


def test_evidence_integrates_to_one():
    drawn = {**draw(1), "births": 0.02, "undetected": 0.05, "clutter": 0.05}
    grid = np.linspace(-BOX / 2, BOX / 2, 161)
    step = grid[1] - grid[0]
    key = jax.random.key(0)

    @jax.jit
    def density(*places):
        scans = [
            Scan(x[:, None], jnp.ones(len(x), bool), jnp.asarray(INTERVAL))
            for x in places
        ]
        params = params_of(drawn)
        return jnp.exp(oracle.posterior(target, params, scans, key).log_evidence)

    ones, pairs = grid[:, None], np.array(list(itertools.product(grid[::4], grid[::4])))
    total = density(np.zeros(0)) + jax.vmap(density)(ones).sum() * step
    total = total + jax.vmap(density)(pairs).sum() * (4 * step) ** 2 / 2
    # Three detections or more have probability 0.0004 at such rates.
    assert abs(total - 1) < 1e-3
