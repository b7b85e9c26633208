"""Tests of `jaxtrack.metrics.trajectories` against linear programmes by HiGHS."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from reference import trajectories as reference

from jaxtrack.metrics import coupled, gospa, trajectories

TIMES, ROWS, COLUMNS = 5, 3, 4
TOLERANCE = 1e-3
measure = jax.jit(trajectories.metric)
# To the last digit, as far as steps go: what does not depend on the tolerance.
precise = jax.jit(lambda *sets: trajectories.metric(*sets, tolerance=1e-9))


def random_sets(seed, rows=ROWS, columns=COLUMNS):
    """Targets in a small room, tracks that follow now the one and now the other."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-8, 8, (rows, 2)) + rng.normal(size=(TIMES, rows, 2)) * 2
    follows = rng.integers(rows, size=columns)
    estimate = np.empty((TIMES, columns, 2))
    for time in range(TIMES):
        if rng.random() < 0.4:
            follows = rng.permutation(follows)
        estimate[time] = truth[time, follows] + rng.normal(size=(columns, 2)) * 3
    alive = rng.random((TIMES, rows)) < 0.8, rng.random((TIMES, columns)) < 0.7
    sets = truth, alive[0], estimate, alive[1]
    return tuple(map(jnp.asarray, sets))


def as_lists(states, alive):
    """Trajectories of points, None where there is none."""
    return [
        [x if a else None for x, a in zip(np.asarray(s), np.asarray(b), strict=True)]
        for s, b in zip(jnp.moveaxis(states, 1, 0), alive.T, strict=True)
    ]


def stacked(seeds):
    return jax.tree.map(lambda *x: jnp.stack(x), *map(random_sets, seeds))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("switch_cost", "order"), [(1.5, 2.0), (4.0, 1.0), (9.0, 3.0)])
def test_metric_is_the_linear_programme_of_the_paper(seed, switch_cost, order):
    sets = random_sets(seed)
    lists = as_lists(*sets[:2]), as_lists(*sets[2:])
    expected = reference.metric(*lists, 10.0, switch_cost, order)
    exact = trajectories.exact(*sets, 10.0, switch_cost, order)
    np.testing.assert_allclose(exact.distance, expected, rtol=1e-8)
    found = measure(*sets, 10.0, switch_cost, order)
    np.testing.assert_allclose(found.distance, expected, rtol=TOLERANCE)
    assert found.lower <= expected * (1 + 1e-8)
    assert found.distance >= expected * (1 - 1e-8)
    lower, upper = found.lower**order, found.distance**order
    assert upper - lower <= TOLERANCE * upper * (1 + 1e-8)


def solved_together(cost, change_cost):
    """The least cost of each programme [R, T, N, L] and its weights, by HiGHS.

    They are the blocks of one large programme, which saves most of the time.
    """
    number, times, rows, columns = cost.shape
    large = np.zeros((times, number, rows, number, columns))
    each = np.arange(number)
    large[:, each, :, each] = cost
    shape = times, number * rows, number * columns
    found = coupled.exact(large.reshape(shape), change_cost)
    weight = found.weight.reshape(large.shape)[:, each, :, each]
    return (cost * weight).sum((1, 2, 3)) + change_cost * changes(weight), weight


def changes(weight):
    return np.abs(np.diff(weight, axis=1)).sum((1, 2, 3))


def test_bounds_hold_for_thousands_of_programmes():
    # Costs without any geometry: more of them have an optimum that is not integral.
    number, shape = 100, (4, 3, 3)
    rng = np.random.default_rng(0)
    solve = jax.jit(jax.vmap(coupled.solve, (0, None, None, None)))
    not_integral = 0
    for change in [0.05, 0.2, 0.4] * 7:
        cost = -rng.random((number, *shape)) * (rng.random((number, *shape)) < 0.7)
        least, optimal = solved_together(cost, change)
        not_integral += (np.abs(optimal - np.round(optimal)) > 0.3).any((1, 2, 3)).sum()
        for tolerance in (1e-2, 1e-5):
            found = solve(jnp.asarray(cost), change, 0.0, tolerance)
            lower, upper, weight = (np.asarray(x) for x in (*found[1:], found.weight))
            # HiGHS allows itself 1e-7.
            assert (lower <= least + 1e-8).all()
            assert (upper >= least - 1e-8).all()
            assert (upper - lower <= tolerance * -upper + 1e-12).all()
            paid = (cost * weight).sum((1, 2, 3)) + change * changes(weight)
            np.testing.assert_allclose(paid, upper, rtol=1e-12)
            most = max(weight.sum(2).max(), weight.sum(3).max())
            assert weight.min() >= 0
            assert most <= 1 + 1e-6  # where it comes from steps in float32
    assert not_integral >= 7


def test_metric_of_one_time_is_gospa():
    sets = [x[0] for x in random_sets(3)]
    expected = gospa.gospa(*sets, 10.0)
    found = precise(*(x[None] for x in sets), 10.0, 3.0)
    np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-12)
    parts = found.localisation, found.missed, found.false, found.switch
    np.testing.assert_allclose(parts, (*expected[1:4], 0), rtol=1e-12)


def test_parts_are_counted_as_named():
    truth = jnp.array([[[0.0], [50.0]]] * 6)
    alive = jnp.ones((6, 2), bool)
    swapped = truth.at[3:].set(truth[3:, ::-1]) + 1.0
    score = precise(truth, alive, swapped, alive, 10.0, 2.0)
    # Rounding of sums of up to 12 terms of size 1, which should vanish.
    np.testing.assert_allclose(score[2:], (12, 0, 0, 8), atol=1e-12)
    np.testing.assert_allclose(score[:2], (20**0.5, 20**0.5), rtol=1e-9)

    # One track of two ends half-way, and a third one is false throughout.
    third = jnp.concatenate([truth, truth[:, :1] + 500], 1)
    reported = jnp.ones((6, 3), bool).at[3:, 1].set(False)
    score = precise(truth, alive, third, reported, 10.0, 2.0)
    np.testing.assert_allclose(score[2:], (0, 150, 300, 0), atol=1e-9)  # as above


def test_a_dear_switch_is_not_made():
    truth, alive = jnp.zeros((6, 1, 1)), jnp.ones((6, 1), bool)
    first = (jnp.arange(6) < 3)[:, None]
    halves = jnp.zeros((6, 2, 1)), jnp.concatenate([first, ~first], 1)
    cheap = precise(truth, alive, *halves, 10.0, 2.0)
    np.testing.assert_allclose((cheap.switch, cheap.missed), (4, 0), atol=1e-12)
    # Staying with the first track leaves three times missed, and three times false.
    dear = precise(truth, alive, *halves, 10.0, 30.0)
    np.testing.assert_allclose((dear.switch, dear.missed), (0, 150), atol=1e-9)


def test_metric_is_a_metric():
    x, y, z = stacked(range(30)), stacked(range(30, 60)), stacked(range(60, 90))
    many = jax.jit(jax.vmap(lambda *sets: precise(*sets, 12.0, 3.0)))
    xy, yx = many(*x[:2], *y[:2]), many(*y[:2], *x[:2])
    yz, xz = many(*y[:2], *z[:2]), many(*x[:2], *z[:2])
    np.testing.assert_allclose(xy.distance, yx.distance, rtol=1e-8)
    np.testing.assert_allclose(xy.missed, yx.false, rtol=1e-6)
    assert (xz.distance <= xy.distance + yz.distance + 1e-8).all()
    assert (many(*x[:2], *x[:2]).distance == 0).all()


def test_empty_sets():
    truth, alive, estimate, _ = random_sets(0)
    none = jnp.zeros((TIMES, COLUMNS), bool)
    score = measure(truth, alive, estimate, none, 10.0, 2.0)
    np.testing.assert_allclose(score[2:], (0, 50 * alive.sum(), 0, 0), rtol=1e-12)
    no_slots = measure(truth, alive, estimate[:, :0], none[:, :0], 10.0, 2.0)
    chex.assert_trees_all_close(no_slots, score, rtol=1e-12)
    nothing = measure(truth, alive & False, estimate, none, 10.0, 2.0)
    assert nothing == (0, 0, 0, 0, 0, 0)


def test_padding_and_the_order_of_trajectories_change_nothing():
    truth, alive, estimate, reported = random_sets(2)
    before = precise(truth, alive, estimate, reported, 10.0, 2.0)
    turn = np.array([2, 0, 3, 1])
    after = precise(truth, alive, estimate[:, turn], reported[:, turn], 10.0, 2.0)
    chex.assert_trees_all_close(after, before, rtol=1e-8)
    hidden = jnp.where(reported[..., None], estimate, jnp.nan)
    after = precise(truth, alive, hidden, reported, 10.0, 2.0)
    chex.assert_trees_all_close(after, before, rtol=1e-12)


def test_runs_side_by_side_are_the_runs_alone():
    seeds = range(70)  # more than a block, not a multiple of one
    together = jax.jit(jax.vmap(lambda *x: trajectories.metric(*x, 10.0, 2.0)))
    found = together(*stacked(seeds))
    for seed in (0, 35, 69):
        alone = measure(*random_sets(seed), 10.0, 2.0)
        one = jax.tree.map(lambda x, seed=seed: x[seed], found)
        chex.assert_trees_all_close(one, alone, rtol=1e-6)


def test_gradients_are_right():
    truth, alive, estimate, reported = random_sets(5)

    @jax.jit
    def parts(truth, estimate, cutoff, switch_cost):
        score = trajectories.metric(
            truth, alive, estimate, reported, cutoff, switch_cost, tolerance=1e-9
        )
        return score.distance, score.localisation, score.switch

    at = truth, estimate, 10.0, 2.0
    check_grads(parts, at, order=1, modes=["rev"], rtol=1e-4)
    same = jnp.concatenate([truth, truth[:, :1]], 1)
    slope = jax.grad(lambda x: parts(x, same, 10.0, 2.0)[0])(truth)
    chex.assert_trees_all_equal(jnp.isfinite(slope), jnp.ones(slope.shape, bool))


def test_over_time_is_the_metric_of_what_is_known():
    truth, alive, estimate, reported = random_sets(4)
    each = jax.jit(lambda *x: trajectories.over_time(*x, 10.0, 2.0, tolerance=1e-9))
    found = each(truth, alive, estimate, reported)
    for k in range(TIMES):
        known = (jnp.arange(TIMES) <= k)[:, None]
        sets = truth, alive & known, estimate, reported & known
        expected = trajectories.exact(*sets, 10.0, 2.0)
        np.testing.assert_allclose(
            found.distance[k], expected.distance / (k + 1) ** 0.5, rtol=1e-8
        )
    parts = found.localisation + found.missed + found.false + found.switch
    np.testing.assert_allclose(parts, found.distance**2, rtol=1e-12)

    # Estimates that are made anew at each time.
    many = jnp.stack([estimate] * TIMES), jnp.stack([reported] * TIMES)
    chex.assert_trees_all_close(each(truth, alive, *many), found, rtol=1e-8)


def test_single_precision_stays_in_it_and_near():
    sets = random_sets(6)
    exact = trajectories.exact(*sets, 10.0, 2.0)
    single = [x.astype(jnp.float32) if x.ndim == 3 else x for x in sets]
    found = measure(*single, 10.0, 2.0)
    assert {x.dtype for x in found} == {jnp.dtype("float32")}
    np.testing.assert_allclose(found.distance, exact.distance, rtol=TOLERANCE)
    assert found.lower <= exact.distance * (1 + 1e-5)


def test_when_steps_run_out_the_bounds_still_hold():
    rough = jax.jit(
        jax.vmap(lambda *x: trajectories.metric(*x, 10.0, 2.0, max_steps=1))
    )
    seeds = range(20)
    found = rough(*stacked(seeds))
    exact = [trajectories.exact(*random_sets(s), 10.0, 2.0).distance for s in seeds]
    assert (found.lower <= jnp.array(exact) + 1e-9).all()
    assert (found.distance >= jnp.array(exact) - 1e-9).all()


def test_bad_settings_are_rejected():
    sets = random_sets(0)
    with pytest.raises(ValueError, match="switch_cost is 0.0; give a finite number"):
        trajectories.metric(*sets, 10.0, 0.0)
    with pytest.raises(ValueError, match="cutoff is -1.0"):
        trajectories.metric(*sets, -1.0, 1.0)
