"""Each target is what its name says: the filter of the book, exact, or counted."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.stories import KEY, told
from cases.targets import ONE_AXIS, array, base_inputs, case_of, two_modes, value
from reference import bruteforce, kalman
from reference import imm as imm_book
from reference import mixture as mixture_book

from jaxtrack import linearize
from jaxtrack.targets import imm, mixture, single

SEEN = [array(0.4), None, array(-3.5)]  # three scans, the second without detection
ROOMY = mixture.mixture(max_components=16, prune_threshold=0.0, merge_threshold=0.0)


def book_model(params, interval, max_components, merge_threshold):
    """The linear two-mode case in the letters of the reference."""
    return mixture_book.Model(
        F=[np.array(m.transition(interval)) for m in params.motions],
        Q=[np.array(m.noise(interval)) for m in params.motions],
        H=np.array([[1.0, 0.0]]),
        R=np.array(params.sensor.cov()),
        p=np.array(params.switching.transition),
        survive=np.array(params.survive.value),
        detect=np.array(params.detect.value),
        max_components=max_components,
        prune_threshold=0.0,
        merge_threshold=merge_threshold,
    )


@functools.cache
def live(target):
    """Lives through the scans: after each, the columns of `bruteforce.jump_markov`.

    That is the chances to survive and of what was seen, modes, mean and covariance;
    and, after the prediction of each, what was lost and the modes.
    """
    params = two_modes()

    def scan(belief, seen_here):
        detection, seen = seen_here
        moved, log_survive = target.predict(params, belief, value(0.75))
        missed, log_miss = target.miss(params, moved)
        view = target.look(params, moved)
        score = target.score(params, view, detection[None])[0]
        hit = target.correct(params, view, detection)
        after = jax.tree.map(lambda x, y: jnp.where(seen, x, y), hit, missed)
        chances = jnp.exp(log_survive), jnp.exp(jnp.where(seen, score, log_miss))
        row = (*chances, target.modes(after), *target.moments(after))
        return after, (row, (target.lost(moved), target.modes(moved)))

    def whole(detections, seen):
        key = jax.random.wrap_key_data(KEY)
        belief = target.begin(params, ONE_AXIS, array(0.65, 0.35), key)
        last, rows = jax.lax.scan(scan, belief, (detections, seen))
        return rows, target.lost(last)

    detections = np.array([array(9.0) if z is None else z for z in SEEN])
    seen = np.array([z is not None for z in SEEN])
    return jax.tree.map(np.array, jax.jit(whole)(detections, seen))


def life_of(target):
    return live(target)[0][0]


def test_single_is_the_kalman_filter():
    case = case_of("single_kf")
    params, z = case.params, base_inputs("single_kf").detections[1]
    F, Q = (np.array(f(0.75)) for f in (params.motion.transition, params.motion.noise))
    H, R = np.array([[1.0, 0.0]]), np.array(params.sensor.cov())
    m, P = kalman.predict(*(np.array(x) for x in case.prior), F, 0, Q)
    m, P = kalman.predict(m, P, F, 0, Q)
    m, P, log_density = kalman.update(m, P, H, 0, R, np.array(z))
    _, life, brief = told("single_kf").variant["base"]
    np.testing.assert_allclose(brief["corrected"][0].mean[1], m, rtol=1e-10)
    np.testing.assert_allclose(brief["corrected"][0].cov[1], P, rtol=1e-10)
    np.testing.assert_allclose(life["score"][1], log_density + np.log(0.85), rtol=1e-10)
    np.testing.assert_allclose(life["log_survive"], -0.75 / 30, rtol=1e-10)


def test_imm_is_the_book():
    model = book_model(two_modes(), 0.75, 1, np.inf)
    bank = np.array([0.65, 0.35]), *(np.array([x, x]) for x in ONE_AXIS)
    rows = []
    for z in SEEN:
        bank, survived = imm_book.predict(model, bank)
        seen = (
            imm_book.miss(model, bank)
            if z is None
            else imm_book.correct(model, bank, z)
        )
        bank, density = seen
        whole = mixture_book.moment_match(list(zip(*bank, strict=True)))
        rows.append((survived, density, bank[0], *whole))
    expected = tuple(np.array(column) for column in zip(*rows, strict=True))
    chex.assert_trees_all_close(life_of(imm.imm()), expected, rtol=1e-9)


def test_mixture_of_one_component_a_mode_is_the_imm():
    target = mixture.mixture(
        max_components=1, prune_threshold=0.0, merge_threshold=float("inf")
    )
    chex.assert_trees_all_close(life_of(target), life_of(imm.imm()), rtol=1e-9)


def test_roomy_mixture_is_exact():
    """Against the enumeration of all sixteen sequences of modes."""
    params = two_modes()
    expected = bruteforce.jump_markov(
        book_model(params, 0.75, 16, 0.0),
        *(np.array(x) for x in ONE_AXIS),
        [0.65, 0.35],
        [None if z is None else np.array(z) for z in SEEN],
    )
    chex.assert_trees_all_close(life_of(ROOMY), expected, rtol=1e-9)
    difference = np.abs(expected[3] - life_of(imm.imm())[3]).max()
    assert difference > 1e-4  # the IMM is not, so the scene can tell them apart


def test_mixture_says_what_its_capacity_lost():
    tight = mixture.mixture(max_components=1, prune_threshold=0.0, merge_threshold=0.0)
    (_, (lost, modes)), lost_at_last = live(tight)
    model = book_model(two_modes(), 0.75, 1, 0.0)
    expected = mixture_book.begin(model, *(np.array(x) for x in ONE_AXIS), [0.65, 0.35])
    for t, z in enumerate(SEEN):
        expected, _ = mixture_book.predict(model, expected)
        np.testing.assert_allclose(lost[t], expected[1], rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(modes[t], mixture_book.mode_prob(expected))
        after = mixture_book.miss if z is None else mixture_book.correct
        expected, _ = after(model, expected, *([] if z is None else [np.array(z)]))
    assert lost_at_last > 0.05


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"max_components": 0}, "max_components is 0; a mode needs at least 1"),
        ({"prune_threshold": 1.0}, "prune_threshold is 1.0"),
        ({"merge_threshold": -1.0}, "merge_threshold is -1.0"),
        ({"merge_threshold": float("nan")}, "merge_threshold is nan"),
    ],
)
def test_bad_settings_are_named(setting, words):
    with pytest.raises(ValueError, match=words):
        mixture.mixture(**setting)


def test_makers_are_cached():
    assert imm.imm() is imm.imm()
    assert single.single(linearize.unscented) is single.single(linearize.unscented)
    assert mixture.mixture(3) is mixture.mixture(3)
