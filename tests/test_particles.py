"""Particles against what is exact: mode sequences enumerated, and the Kalman filter.

What is drawn agrees on average only, so these are statistics over many runs with fixed
seeds: bounds are some standard errors. `test_targets` holds the contract that needs no
average.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import targets as cases
from reference import bruteforce

from jaxtrack import linearize, particle, resampling
from jaxtrack.models import motion, probability, sensor, switching
from jaxtrack.targets import clouds, particles, rao_blackwell, single
from jaxtrack.types import Gaussian

INTERVAL = 0.75
PRIOR = Gaussian(np.array([1.0, -2.0]), np.array([[4.0, 1.0], [1.0, 2.0]]))
MODE_PROB = np.array([0.65, 0.35])
DETECTIONS = np.array([[0.3], [-1.9], [np.nan], [-6.2], [-9.8]])
SEEN = np.isfinite(DETECTIONS[:, 0])


def two_modes():
    """The second has noise of rank one; detection and survival depend on the mode."""
    rest = motion.OrnsteinUhlenbeck(np.array([0.0]), np.array([6.0]))
    return particles.Params(
        motions=(
            motion.ConstantVelocity(np.array([0.3])),
            motion.PiecewiseAcceleration(rest, np.array([4.0])),
        ),
        switching=switching.MarkovSwitching(np.array([[0.8, 0.2], [0.4, 0.6]])),
        sensor=sensor.Position(np.array([0.7])),
        survive=probability.PerMode(np.array([0.97, 0.8])),
        detect=probability.PerMode(np.array([0.9, 0.6])),
    )


class Model(NamedTuple):
    """The same as matrices, for the reference."""

    F: list
    Q: list
    H: np.ndarray
    R: np.ndarray
    p: np.ndarray
    survive: np.ndarray
    detect: np.ndarray


@functools.cache
def exact():
    params = two_modes()
    model = Model(
        F=[np.array(x.transition(INTERVAL)) for x in params.motions],
        Q=[np.array(x.noise(INTERVAL)) for x in params.motions],
        H=np.array([[1.0, 0.0]]),
        R=np.array(params.sensor.cov()),
        p=params.switching.transition,
        survive=params.survive.value,
        detect=params.detect.value,
    )
    scans = [z if there else None for z, there in zip(DETECTIONS, SEEN, strict=True)]
    return bruteforce.jump_markov(model, *PRIOR, MODE_PROB, scans)


def life(target, params, key):
    """The log-density of all scans, and mean, covariance and modes after the last."""
    belief = target.begin(params, PRIOR, jnp.array(MODE_PROB), key)

    def scan(belief, seen):
        z, there = seen
        belief, log_survive = target.predict(params, belief, jnp.asarray(INTERVAL))
        view = target.look(params, belief)
        missed, log_miss = target.miss(params, belief)
        hit = target.correct(params, view, z)
        belief = jax.tree.map(lambda x, y: jnp.where(there, x, y), hit, missed)
        log_density = jnp.where(there, target.score(params, view, z[None])[0], log_miss)
        return belief, log_survive + log_density

    scans = jnp.where(SEEN[:, None], DETECTIONS, 0.0), jnp.array(SEEN)
    belief, log_density = jax.lax.scan(scan, belief, scans)
    moments = target.moments(belief)
    told = moments.mean, moments.cov, target.modes(belief)
    return log_density.sum(), told


@functools.cache
def lives(target, runs, seed=0):
    keys = jax.random.split(jax.random.key(seed), runs)
    every = functools.partial(life, target)
    run = jax.jit(jax.vmap(every, (None, 0)))
    return jax.tree.map(np.array, run(two_modes(), keys))


WAYS = {
    "bootstrap": particles.particles(max_particles=300),
    "always resampled, modes drawn evenly": particles.particles(
        max_particles=300, ess_threshold=1.0, mode_proposal=jnp.zeros_like
    ),
    "extended": particles.particles(max_particles=200, proposal=linearize.taylor),
    "moves": particles.particles(max_particles=200, num_moves=2),
    "rao_blackwell": rao_blackwell.rao_blackwell(max_particles=30),
}


@pytest.mark.parametrize("name", WAYS)
def test_filter_agrees_with_all_sequences_of_modes(name):
    """The likelihood on average; the posterior, weighed by each run's likelihood."""
    survived, density, modes, mean, cov = exact()
    log_density, told = lives(WAYS[name], 400)
    ratio = np.exp(log_density - np.log(survived * density).sum())
    assert abs(ratio.mean() - 1) < 4 * ratio.std() / 20
    assert ratio.std() < 0.6
    expected = mean[-1], cov[-1], modes[-1]
    for found, right in zip(told, expected, strict=True):
        weight = ratio.reshape(-1, *[1] * right.ndim) / ratio.sum()
        error = (weight * (found - right[None])).sum(0)
        spread = np.sqrt((weight**2 * (found - right[None]) ** 2).sum(0))
        # Normalised in every run: off by the order of 1 / L, a tenth of the spread.
        assert (np.abs(error) < 4 * spread + 0.1 * found.std(0)).all()


def test_knowing_the_detection_and_the_gaussians_helps():
    spread = {
        name: np.var(lives(WAYS[name], 400)[1][0][:, 1]) * size
        for name, size in (("bootstrap", 300), ("extended", 200), ("rao_blackwell", 30))
    }
    assert spread["rao_blackwell"] < 0.5 * spread["extended"]
    assert spread["extended"] < 0.8 * spread["bootstrap"]


@pytest.mark.slow
def test_error_falls_with_the_root_of_the_number_of_particles():
    *_, mean, cov = exact()
    sizes, errors = (50, 200, 800), []
    for size in sizes:
        log_density, (found, _, _) = lives(particles.particles(size), 300)
        gap = (found - mean[-1][None]) / np.sqrt(np.diag(cov[-1]))[None]
        errors.append(np.sqrt((gap**2).mean()))
    slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert -0.6 < slope < -0.4


@pytest.mark.parametrize(
    "target",
    [particles.particles(100), particles.particles(100, proposal=linearize.cubature)],
    ids=["prior", "given the detection"],
)
def test_blend_is_what_its_parts_are_on_average(target):
    """Each corrected belief by its share, and the missed one."""
    params, log_weight = two_modes(), jnp.array([-0.2, -1.1, -0.7])
    detections = jnp.array([[-1.0], [0.6]])

    def one(key):
        belief = target.begin(params, PRIOR, jnp.array(MODE_PROB), key)
        belief, _ = target.predict(params, belief, jnp.asarray(INTERVAL))
        missed, _ = target.miss(params, belief)
        view = target.look(params, belief)
        args = params, view, missed
        blended = target.blend(*args, log_weight, detections)
        swapped = jnp.array([1, 0, 2, 3])
        padded = jnp.concatenate([detections, jnp.full((1, 1), 7.0)])[swapped[:3]]
        padding = jnp.append(log_weight[swapped[:2]], -jnp.inf)
        padding = jnp.append(padding, log_weight[2])
        again = target.blend(*args, padding, padded)
        parts = jax.vmap(target.correct, (None, None, 0))(params, view, detections)
        several = [jax.tree.map(lambda x, i=i: x[i], parts) for i in range(2)]
        each = [target.moments(x) for x in [*several, missed]]
        share = jax.nn.softmax(log_weight)
        modes = share @ jnp.stack([target.modes(x) for x in [*several, missed]])
        mean = share @ jnp.stack([x.mean for x in each])
        pairs = (target.moments(blended).mean, mean), (target.modes(blended), modes)
        return blended, again, *pairs

    blended, again, *pairs = jax.jit(jax.vmap(one))(
        jax.random.split(jax.random.key(0), 500)
    )
    np.testing.assert_allclose(again.log_weight, blended.log_weight, rtol=1e-9)
    np.testing.assert_allclose(again.state, blended.state, rtol=1e-9)
    for found, right in pairs:
        gap = np.array(found - right)
        spread = gap.std(0) / np.sqrt(len(gap))
        assert (np.abs(gap.mean(0)) < 4 * spread + 3e-3).all()


def test_two_detections_make_two_clouds_and_no_key_twice():
    target, params = particles.particles(20, num_moves=1), two_modes()

    @jax.jit
    def drawn(key):
        belief = target.begin(params, PRIOR, jnp.array(MODE_PROB), key)
        belief, _ = target.predict(params, belief, jnp.asarray(INTERVAL))
        missed, _ = target.miss(params, belief)
        view = target.look(params, belief)
        detections = jnp.array([[0.1], [0.1 + 1e-12]])
        corrected = jax.vmap(target.correct, (None, None, 0))(params, view, detections)
        blended = target.blend(params, view, missed, jnp.zeros(3), detections)
        pooled = target.collapse(jnp.zeros(2), corrected)
        folded = clouds.fold(corrected.key[0], clouds.COLLAPSED)
        last = [clouds.fold(belief.key, jnp.array([0.1, x])) for x in (1.0, 2.0)]
        keys = [belief.key, missed.key, *corrected.key, blended.key, pooled.key]
        later, _ = jax.vmap(target.predict, (None, 0, None))(
            params, corrected, jnp.asarray(INTERVAL)
        )
        return [*keys, folded, *last], later.state

    keys, (one, other) = drawn(jax.random.key(0))
    assert len({tuple(np.array(key)) for key in keys}) == 9
    assert not np.isclose(one, other).any()


def test_noise_that_waits_counts_in_the_moments():
    """Before anything is drawn they are the prior's, and after one motion exact."""
    target, params = WAYS["extended"], two_modes()
    stay = params._replace(switching=switching.MarkovSwitching(jnp.eye(2)))

    @jax.jit
    def told(key):
        belief = target.begin(params, PRIOR, jnp.array([1.0, 0.0]), key)
        moved, _ = target.predict(stay, belief, jnp.asarray(INTERVAL))
        return target.moments(belief), moved.state, target.moments(moved).cov

    born, state, cov = told(jax.random.key(0))
    np.testing.assert_allclose(born.mean, PRIOR.mean)
    np.testing.assert_allclose(born.cov, PRIOR.cov)
    noise = np.array(params.motions[0].noise(INTERVAL))
    np.testing.assert_allclose(cov, np.cov(state.T, bias=True) + noise, rtol=1e-9)


def test_number_of_particles_goes_with_existence():
    target, params = particles.particles(40, min_particles=12), two_modes()

    def later(prob):
        belief = target.begin(params, PRIOR, jnp.array(MODE_PROB), jax.random.key(0))
        adapted = target.adapt(params, belief, prob)
        return target.predict(params, adapted, jnp.asarray(INTERVAL))[0]

    many = jax.jit(jax.vmap(later))(jnp.array([1.0, 0.6, 0.01]))
    filled = np.isfinite(many.log_weight)
    np.testing.assert_array_equal(filled.sum(1), [40, 24, 12])
    np.testing.assert_allclose(np.exp(many.log_weight).sum(1), 1)
    worth = np.array(jax.vmap(target.effective_size)(many))
    assert 39 < worth[0] < 40  # survival depends on the mode
    np.testing.assert_allclose(worth[1:], [24, 12])
    assert np.isfinite(many.state).all()


def test_moves_leave_the_posterior_as_it_is_and_part_the_copies():
    """A cloud of copies from the exact posterior of one normal number."""
    size, noise = 4000, 0.8
    mean, var = 1.2 / (1 + noise**2), noise**2 / (1 + noise**2)
    rng = np.random.default_rng(0)
    state = np.repeat(mean + np.sqrt(var) * rng.normal(size=(size // 4, 1)), 4, axis=0)

    def propose(key):
        return jax.random.normal(key, (size, 1))

    def log_likelihood(x):
        return -((1.2 - x[:, 0]) ** 2) / (2 * noise**2)

    @jax.jit
    def moved(key):
        return particle.move(key, jnp.array(state), propose, log_likelihood)

    new, accepted = moved(jax.random.key(0))
    assert 0.3 < accepted.mean() < 0.9
    assert len(np.unique(new)) > 0.6 * size
    # Standard errors of the thousand numbers that the copies come from.
    np.testing.assert_allclose(new.mean(), mean, atol=4 * np.sqrt(var / 1000))
    np.testing.assert_allclose(new.var(), var, rtol=0.15)


def test_regularising_keeps_each_modes_mean_and_covariance():
    rng = np.random.default_rng(1)
    mode = np.arange(3000) % 2
    state = rng.normal(size=(3000, 2)) @ np.array([[2.0, 1.0], [0.0, 0.5]])
    state = np.repeat(state[:1500], 2, axis=0) + 30.0 * mode[:, None]
    given = particle.Particles(jnp.zeros(3000), jnp.array(state), jnp.array(mode))
    wide = jax.jit(lambda key: particle.regularise(key, given, 2, scale=2.5))
    new = wide(jax.random.key(0))
    assert len(np.unique(new.state[:, 0])) == 3000
    for number in (0, 1):
        before, after = state[mode == number], np.array(new.state)[mode == number]
        gap = after.mean(0) - before.mean(0)
        assert (np.abs(gap) < 4 * before.std(0) / np.sqrt(1500)).all()
        # The off-diagonal entries are of the size of the smaller variance.
        np.testing.assert_allclose(
            np.cov(after.T), np.cov(before.T), rtol=0.15, atol=0.1
        )


def test_gradients_through_soft_resampling_are_less_biased():
    """Of the log-likelihood, in the logs of two noises; the Kalman filter is right."""
    zs = jnp.array([[0.4], [1.9], [2.2], [4.1], [4.6], [6.9], [7.0], [9.3]])

    def likelihood(target, many, log_noise, key):
        moves = motion.ConstantVelocity(jnp.exp(log_noise[:1]))
        sees = sensor.Position(jnp.exp(log_noise[1:]))
        certain = probability.Constant(jnp.ones(()))
        stay = switching.MarkovSwitching(jnp.ones((1, 1)))
        params = single.Params(moves, sees, certain, certain)
        if many:
            params = particles.Params((moves,), stay, sees, certain, certain)
        prior = Gaussian(jnp.array([0.0, 1.0]), jnp.eye(2))

        def scan(belief, z):
            belief, _ = target.predict(params, belief, jnp.ones(()))
            view = target.look(params, belief)
            score = target.score(params, view, z[None])[0]
            return target.correct(params, view, z), score

        first = target.begin(params, prior, jnp.ones(1), key)
        return jax.lax.scan(scan, first, zs)[1].sum()

    def slopes(target, many, runs):
        slope = jax.grad(functools.partial(likelihood, target, many))
        keys = jax.random.split(jax.random.key(0), runs)
        many_slopes = jax.jit(jax.vmap(slope, (None, 0)))
        return np.array(many_slopes(jnp.log(jnp.array([0.3, 1.2])), keys)).mean(0)

    right = slopes(single.single(), False, 1)
    bias = {}
    for name, scheme, runs in (
        ("stopped", resampling.systematic, 300),
        ("soft", resampling.soft(0.5), 300),
    ):
        target = particles.particles(50, scheme=scheme, ess_threshold=1.0)
        bias[name] = np.abs(slopes(target, True, runs) - right).max()
    assert bias["soft"] < 0.4 * bias["stopped"]


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"max_particles": 0}, "max_particles is 0"),
        ({"max_particles": 10, "min_particles": 20}, "min_particles is 20"),
        ({"ess_threshold": 0.0}, "ess_threshold is 0.0"),
        ({"ess_threshold": 1.5}, "ess_threshold is 1.5"),
        ({"num_moves": -1}, "num_moves is -1"),
        ({"num_moves": 1, "proposal": linearize.taylor}, "num_moves is 1"),
    ],
)
def test_settings_are_checked(settings, word):
    with pytest.raises(ValueError, match=word):
        particles.particles(**settings)
    if "max_particles" in settings and len(settings) == 1:
        with pytest.raises(ValueError, match=word):
            rao_blackwell.rao_blackwell(**settings)


@pytest.mark.parametrize(
    "target",
    [
        particles.particles(40, regularise=True),
        particles.particles(40, proposal=linearize.unscented),
        particles.particles(40, num_moves=1),
        rao_blackwell.rao_blackwell(12, linearize.unscented),
    ],
    ids=["regularised", "unscented", "moves", "rao_blackwell"],
)
def test_a_turning_target_seen_by_a_radar_in_float32(target):
    """All verbs, finite and of one type, also for an outlier far from all particles."""
    case = cases.case_of("imm_nonlinear")
    narrow = functools.partial(jax.tree.map, lambda x: np.array(x, np.float32))
    params, prior, mode_prob = map(narrow, (case.params, case.prior, case.mode_prob))
    detections = np.array(case.centre + np.array([[0, 0], [2e3, 2.0]]), np.float32)

    def one(key):
        belief = target.begin(params, prior, jnp.array(mode_prob), key)
        belief, _ = target.predict(params, belief, jnp.float32(0.75))
        missed, _ = target.miss(params, belief)
        view = target.look(params, belief)
        score = target.score(params, view, detections)
        distance = target.distance(params, view, detections)
        hit = jax.vmap(target.correct, (None, None, 0))(params, view, detections)
        log_weight = jnp.array([-1.0, -2.0, -0.5], jnp.float32)
        blended = target.blend(params, view, missed, log_weight, detections)
        one = target.collapse(log_weight[:2], hit)
        return score, distance, [target.moments(x) for x in (blended, one, missed)]

    with jax.enable_x64(False):
        told = jax.jit(one)(jax.random.key(0))
    for leaf in jax.tree.leaves(told):
        assert leaf.dtype == np.float32
        assert np.isfinite(leaf).all()
    score, (square, _), _ = told
    assert score[0] > -20
    assert square[0] < 10 < square[1]
