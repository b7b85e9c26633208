"""Tests of `trackers.retrodiction`, and of the smoothers of targets it stands on."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes
from reference import kalman as plain

from jaxtrack.entries import dense
from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant, PerMode
from jaxtrack.models.sensor import Position
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.targets import imm, mixture, single
from jaxtrack.trackers import mht, retrodiction
from jaxtrack.types import Gaussian, Scan

NUM, DELAY = 12, 3
INTERVALS = np.tile([0.7, 1.3, 0.4], NUM // 3)
ROOM = {"max_tracks": 3, "max_leaves": 6, "max_undetected": 2, "gate_prob": 1.0}


def problem(**changed):
    return {**scenes.draw(0), "clutter": 1e-3, "births": 1e-4, **changed}


@functools.cache
def program(target):
    tracker = mht.mht(target, num_scans=1, delay=DELAY, **ROOM)

    def run(params, scans):
        step = functools.partial(tracker.step, params)
        state = tracker.init(params, jax.random.key(0))
        return jax.lax.scan(lambda s, x: step(s, x), state, scans)[1]

    return jax.jit(run)


def estimates(target, params, places, seen):
    """One detection a scan, or none."""
    scans = Scan(places[:, None, None], seen[:, None], INTERVALS)
    return program(target)(params, scans)


def known(mean, cov, modes=1):
    """One target that is there."""
    share = np.full((1, modes), 1 / modes)
    return MultiBernoulliBirth(np.ones(1), mean[None], cov[None], share)


def moves(model):
    """The transition and the noise of each interval."""
    pace = model["time_constant"]
    for interval in INTERVALS:
        x = interval / pace  # a critically damped oscillator
        move = np.exp(-x) * np.array([[1 + x, interval], [-x / pace, 1 - x]])
        yield move, model["stationary"] - move @ model["stationary"] @ move.T


def joint(model, mean, cov):
    """Moments of all states together, the first one interval after the prior."""
    means, every = [], np.zeros((2 * NUM, 2 * NUM))
    for k, (move, noise) in enumerate(moves(model)):
        mean, cov = move @ mean, move @ cov @ move.T + noise
        means.append(mean)
        here, before = slice(2 * k, 2 * k + 2), slice(0, 2 * k)
        every[here, here] = cov
        every[here, before] = move @ every[2 * k - 2 : 2 * k, before] if k else 0.0
        every[before, here] = every[here, before].T
    return np.concatenate(means), every


def path(rng, model, mean):
    for move, noise in moves(model):
        mean = move @ mean + rng.multivariate_normal(np.zeros(2), noise)
        yield mean


@pytest.mark.parametrize("bank", [False, True])
def test_it_is_the_state_then_given_all_detections_until_now(bank):
    rng, drawn = np.random.default_rng(1), problem(survive=1.0, detect=0.8)
    model, (mean, cov) = scenes.model_of(drawn), (np.array([1.0, 0.0]), 4 * np.eye(2))
    truth = np.array(list(path(rng, model, mean)))
    places = truth[:, 0] + rng.normal(0, drawn["sensor_var"] ** 0.5, NUM)
    seen = rng.uniform(size=NUM) < 0.8
    params = scenes.params_of(drawn)._replace(start=known(mean, cov, 1 + bank))
    target = scenes.target
    if bank:  # of two modes alike
        target, one = imm.imm(), params.target
        switching = MarkovSwitching(np.array([[0.7, 0.3], [0.4, 0.6]]))
        both = imm.Params((one.motion, one.motion), switching, *one[1:])
        places_of = params.birth._replace(mode_prob=np.full((1, 2), 0.5))
        params = params._replace(target=both, birth=places_of, undetected=places_of)
    found = estimates(target, params, places, seen).retrodicted
    first, every = joint(model, mean, cov)
    for k in range(DELAY, NUM):
        at = 2 * np.flatnonzero(seen[: k + 1])
        cross = every[:, at] @ np.linalg.inv(
            every[np.ix_(at, at)] + drawn["sensor_var"] * np.eye(len(at))
        )
        then = slice(2 * (k - DELAY), 2 * (k - DELAY) + 2)
        expected = first + cross @ (places[at // 2] - first[at])
        spread = (every - cross @ every[at])[then, then]
        np.testing.assert_allclose(found.mean[k, 0], expected[then], rtol=1e-8)
        # Entries of order one; rounding is about the largest of them.
        np.testing.assert_allclose(found.cov[k, 0], spread, rtol=1e-8, atol=1e-10)
    assert not found.exists[:DELAY].any()
    assert found.exists[DELAY:, 0].all()
    assert not found.exists[:, 1:].any()


def alive_given(seen, until, survive, detect):
    """Probability to be there at each scan, by the sum over times of death."""
    last = np.flatnonzero(seen[: until + 1]).max()
    weight = {}
    for death in range(last + 1, until + 2):  # dead from this scan on
        lived = survive ** (death - 1 - last) * (1 - detect) ** (death - 1 - last)
        weight[death] = lived * (1 - survive if death <= until else 1.0)
    total = sum(weight.values())
    return [
        sum(w for death, w in weight.items() if death > k) / total
        for k in range(until + 1)
    ]


def test_existence_is_that_given_what_came_later():
    drawn = problem(survive=0.8, detect=0.5, clutter=1e-6)
    rng, model = np.random.default_rng(2), scenes.model_of(drawn)
    places = np.array(list(path(rng, model, np.zeros(2))))[:, 0]
    seen = np.array([1, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0], bool)
    start = known(np.zeros(2), model["stationary"])
    params = scenes.params_of(drawn)._replace(start=start)
    found = estimates(scenes.target, params, places, seen).retrodicted
    for k in range(DELAY, NUM):
        expected = alive_given(seen, k, 0.8, 0.5)[k - DELAY]
        # A false detection or a second target is 1e-4 as likely.
        np.testing.assert_allclose(found.existence_prob[k, 0], expected, atol=2e-3)


def test_a_target_that_died_is_reported_until_it_was_last_detected():
    drawn = problem(survive=0.9, detect=0.999, births=0.5)
    rng, model = np.random.default_rng(3), scenes.model_of(drawn)
    places = np.array(list(path(rng, model, np.zeros(2))))[:, 0]
    seen = np.arange(NUM) < 5
    start = known(np.zeros(2), model["stationary"])
    params = scenes.params_of(drawn)._replace(start=start)
    found = estimates(scenes.target, params, places, seen)
    assert not found.exists[6:].any()
    later = retrodiction.align(found, DELAY)
    assert (later.exists.sum(1) == seen).all()
    assert len(np.unique(later.label[later.exists])) == 1
    short = jax.tree.map(lambda x: x[: DELAY - 1], found)
    np.testing.assert_array_equal(retrodiction.align(short, DELAY).mean, short.mean)
    with pytest.raises(ValueError, match="retrodicted is None; make the tracker with"):
        retrodiction.align(found._replace(retrodicted=None), DELAY)


def test_a_target_that_cannot_be_missed_nor_die_existed_though_it_was_missed():
    sure, impossible = jnp.ones(5, jnp.float32), jnp.full(5, -200, jnp.float32)
    slope = jax.jit(jax.value_and_grad(retrodiction.existed, (0, 1)))
    for seen in (np.zeros(5, bool), np.arange(5) == 4):
        prob, slopes = slope(sure, impossible, seen)
        assert prob == 1
        assert all(np.isfinite(x).all() for x in slopes)


def two_modes():
    """A calm and a rough mode, seen with noise 1."""
    return imm.Params(
        motions=(
            ConstantVelocity(np.array([0.01])),
            ConstantVelocity(np.array([4.0])),
        ),
        switching=MarkovSwitching(np.array([[0.9, 0.1], [0.25, 0.75]])),
        sensor=Position(np.array([1.0])),
        survive=PerMode(np.array([0.95, 0.9])),
        detect=Constant(np.array(0.9)),
    )


def exact_smoother(model, prior, places):
    """Mean of the state before the first scan, by the sum over sequences of modes."""
    motions, switch, survive = model
    H, R = np.array([[1.0, 0.0]]), np.eye(1)
    total, weighted = 0.0, np.zeros(2)
    for modes in itertools.product(range(2), repeat=len(places) + 1):
        weight, rows = 0.5, [prior]
        for (i, j), z in zip(itertools.pairwise(modes), places, strict=True):
            m, P = plain.predict(*rows[-1], motions[j][0], 0.0, motions[j][1])
            m, P, log_density = plain.update(m, P, H, np.zeros(1), R, z)
            weight *= survive[i] * switch[i, j] * np.exp(log_density)
            rows.append((m, P))
        F, Q = zip(*(motions[j] for j in modes), strict=True)
        mean, cov = (np.array(x) for x in zip(*rows, strict=True))
        smoothed, _ = plain.smooth(mean, cov, (F, np.zeros(len(F)), Q))
        total, weighted = total + weight, weighted + weight * smoothed[0]
    return weighted / total


def test_modes_are_smoothed_nearly_as_by_all_their_sequences():
    params, rng = two_modes(), np.random.default_rng(4)
    motions = [
        (np.asarray(dense(m.transition(1.0))), np.asarray(dense(m.noise(1.0))))
        for m in params.motions
    ]
    switch, survive = params.switching.transition, params.survive.value
    prior = Gaussian(np.array([0.0, 2.0]), np.diag([9.0, 16.0]))
    truths, places = [], []
    for _ in range(40):
        state, mode = rng.multivariate_normal(*prior), rng.integers(2)
        truths.append(state)
        row = []
        for _ in range(4):
            mode = rng.choice(2, p=switch[mode])
            F, Q = motions[mode]
            state = F @ state + rng.multivariate_normal(np.zeros(2), Q)
            row.append(state[:1] + rng.normal(size=1))
        places.append(row)
    target, interval = imm.imm(), jnp.array(1.0)

    def smoothed(params, places):
        bank = target.begin(params, prior, jnp.full(2, 0.5), jax.random.key(0))

        def forward(bank, z):
            moved, _ = target.predict(params, bank, interval)
            return target.correct(params, target.look(params, moved), z), bank

        def back(later, bank):
            return target.smooth(params, bank, later, interval), None

        last, before = jax.lax.scan(forward, bank, places)
        return target.moments(jax.lax.scan(back, last, before, reverse=True)[0]).mean

    found = jax.jit(jax.vmap(lambda x: smoothed(params, x)))(np.array(places))
    model = motions, switch, survive
    exact = np.array([exact_smoother(model, prior, x) for x in places])
    off = np.abs(found - exact).mean(0)
    assert (off < 0.01 * np.abs(prior.mean[None] - exact).mean(0)).all()
    error = np.sqrt(((found - np.array(truths)) ** 2).mean(0))
    best = np.sqrt(((exact - np.array(truths)) ** 2).mean(0))
    assert (error < 1.01 * best).all()

    def value(noise):
        motions = tuple(ConstantVelocity(x[None]) for x in noise)
        return smoothed(params._replace(motions=motions), np.array(places[0])).sum()

    slope = jax.jit(jax.value_and_grad(value))
    np.testing.assert_allclose(*plain.slopes(slope, np.array([0.5, 4.0])), rtol=1e-6)


def test_wrong_settings_get_one_sentence():
    with pytest.raises(ValueError, match="delay is 1; give at least 2"):
        mht.mht(single.single(), num_scans=2, delay=1)
    with pytest.raises(ValueError, match="cannot be smoothed; use targets.single"):
        mht.mht(mixture.mixture(), num_scans=2, delay=2)
