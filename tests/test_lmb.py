"""Tests of `trackers.lmb` against Bayes' recursion over sets of targets."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes
from reference import bernoullis

from jaxtrack.models import birth
from jaxtrack.trackers import glmb, jpda, lmb
from jaxtrack.types import Scan

NUM, SIZE = 40, 3
LONE = 28  # problems from here on have a single detection
ROOM = {"max_tracks": 3, "gate_prob": 1.0, "exist_threshold": 0.0}
MORE = {
    "auto": {},
    "belief": {},
    "k-best": {"max_events": 34},  # all there are
    "gibbs": {"max_events": 80},
}


def draw(seed):
    """Two targets may be known before the first scan, and one be born."""
    rng = np.random.default_rng(300 + seed)
    more = {"prob": rng.uniform(0.1, 0.95, 3), "mean": rng.normal(size=(3, 2))}
    return {**scenes.draw(seed), **more}


def params_of(drawn):
    covs = jnp.tile(4 * jnp.eye(2), (3, 1, 1))
    every = drawn["prob"], drawn["mean"], covs, jnp.ones((3, 1))
    start = birth.MultiBernoulliBirth(*(x[:2] for x in every))
    births = birth.MultiBernoulliBirth(*(x[2:] for x in every))
    return scenes.params_of(drawn)._replace(birth=births, undetected=None, start=start)


def drawn():
    places = [scenes.detections(seed, (SIZE,))[0] for seed in range(NUM)]
    return [draw(seed) for seed in range(NUM)], places


@functools.cache
def told(name):
    """How likely each target is to exist, its mean, and the estimate, after a scan."""
    tracker = lmb.lmb(scenes.target, method=name, **ROOM, **MORE[name])

    def run(drawn, place, number):
        params = params_of(drawn)
        valid = jnp.arange(SIZE) < number
        scan = Scan(place[:, None], valid, jnp.asarray(scenes.INTERVAL))
        state, estimate = tracker.step(
            params, tracker.init(params, jax.random.key(0)), scan
        )
        order = jnp.argsort(state.tracks.label)
        tracks = jax.tree.map(lambda x: x[order], state.tracks)
        return tracks.existence_prob, tracks.belief.mean, estimate

    number = np.where(np.arange(NUM) < LONE, SIZE, 1)
    given = *map(scenes.stacked, drawn()), number
    return jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(*given))


@functools.cache
def known():
    """The same by listing all sets of targets, and the log-evidence."""
    probs, means, evidences = np.zeros((NUM, 3)), np.zeros((NUM, 3, 2)), np.zeros(NUM)
    for k, (one, place) in enumerate(zip(*drawn(), strict=True)):
        model = scenes.model_of(one)
        transition, stationary = model["transition"], model["stationary"]
        model["noise"] = stationary - transition @ stationary @ transition.T
        each = [
            (p, mean, 4 * np.eye(2))
            for p, mean in zip(one["prob"], one["mean"], strict=True)
        ]
        model["start"], model["births"] = each[:2], each[2:]
        scan = place if k < LONE else place[:1]
        sets, evidences[k] = bernoullis.recursion(model, [scan])
        for key, (prob, states) in sets.items():
            for member in key:
                n = ["start 0", "start 1", "0 0"].index(member[0])
                probs[k, n] += prob
                means[k, n] += prob * states[member][0]
    return probs, means / probs[..., None], evidences


def assert_same(name, which):
    """What is told is what is known, for some of the problems."""
    (prob, mean, estimate), (weight, place, evidence) = told(name), known()
    np.testing.assert_allclose(
        estimate.log_evidence[which], evidence[which], rtol=1e-10
    )
    np.testing.assert_allclose(prob[which], weight[which], rtol=1e-10)
    # Of either sign, of order one.
    np.testing.assert_allclose(mean[which], place[which], rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("name", ["auto", "k-best"])
def test_after_one_scan_it_knows_all_about_each_target_by_itself(name):
    assert_same(name, slice(None))
    estimate = told(name)[2]
    np.testing.assert_allclose(estimate.num_mean, known()[0].sum(1), rtol=1e-10)
    assert (estimate.dropped < 1e-12).all()  # roundings of sums of order one


def test_belief_propagation_is_exact_where_nothing_is_a_loop():
    """Of one detection and any number of targets none is."""
    assert_same("belief", slice(LONE, None))


@pytest.mark.parametrize(
    ("name", "most", "usual"),
    [
        ("belief", 0.1, 0.02),  # what loops cost, see `assign.belief`
        ("gibbs", 0.03, 0.003),  # what no chain came to
    ],
)
def test_the_others_are_near(name, most, usual):
    (prob, _, estimate), (weight, _, evidence) = told(name), known()
    gap = np.abs(prob - weight)[:LONE]
    assert 1e-4 < gap.max() < most
    assert gap.mean() < usual
    if name == "gibbs":
        lost = evidence - estimate.log_evidence
        assert ((lost > -1e-10) & (lost < most)).all()


def test_a_miss_that_was_not_drawn_does_not_end_a_target():
    """Sure targets: the heaviest event alone says nearly all, their misses nothing."""
    log_score = np.array([[6.0, 5.0, -np.inf, -2.0], [0.5, 7.0, -np.inf, -1.5]])
    # Track 0 has one detection or the other; a slot is empty.
    events = np.array([[0, 1], [1, 2], [1, 3], [0, 0]])
    weights = np.array([13.0, -np.inf, 3.5, -np.inf])
    ratio = jax.jit(jpda.of_events)(log_score, events, weights, False).log_ratio
    total = np.logaddexp(13.0, 3.5)
    # Without its detection, in the heaviest event; of track 1 the miss is among them.
    np.testing.assert_allclose(ratio, [total - 13.0 + 6.0, -1.5 + total - 3.5])
    every = jax.jit(jpda.rule("auto", 8, None))(log_score).log_ratio
    # What is left out has less than 1e-2 of the weight.
    assert every[0] < ratio[0] < every[0] + 1e-2
    slope = jax.jit(jax.grad(lambda x: _ratios(x, events, weights).sum()))(log_score)
    assert np.isfinite(slope).all()


def _ratios(log_score, events, weights):
    return jpda.of_events(log_score, events, weights, False).log_ratio


def test_births_begin_where_nobody_was_under_labels_of_their_own():
    births = birth.DetectionBirth(
        jnp.array(0.3), jnp.array(0.5), jnp.ones(1), jnp.zeros(0), jnp.ones(1)
    )
    tracker = lmb.lmb(
        scenes.target, "belief", **{**ROOM, "max_tracks": 6}, max_births=3
    )

    @jax.jit
    def run(drawn):
        params = params_of(drawn)._replace(birth=births, start=None)
        places = jnp.array([[-9.0], [0.0], [9.0]])
        scan = Scan(places, jnp.ones(3, bool), jnp.array(scenes.INTERVAL))
        state = tracker.init(params, jax.random.key(0))
        step = functools.partial(tracker.step, params)

        def on(state, _):
            state, _ = step(state, scan)
            return state, state.tracks

        return jax.lax.scan(on, state, length=2)[1]

    tracks = run(draw(0))
    for k in range(2):
        there = tracks.existence_prob[k] > 0
        labels = np.sort(tracks.label[k][there])
        np.testing.assert_array_equal(labels, np.arange(3 * k + 3))
        # Its number is the rate, shared among the detections.
        new = tracks.existence_prob[k, 6:].sum()
        np.testing.assert_allclose(new, 0.3 * scenes.INTERVAL, rtol=1e-9)


def test_it_reports_as_many_as_it_is_likeliest_that_there_are():
    estimate = told("auto")[2]
    for prob, exists in zip(estimate.existence_prob, estimate.exists, strict=True):
        number = np.ones(1)
        for one in prob:
            number = np.convolve(number, [1 - one, one])
        assert exists.sum() == number.argmax()
        assert prob[exists].min(initial=1) >= prob[~exists].max(initial=0)


def test_parameters_and_settings_of_others_are_refused():
    plain = scenes.params_of(scenes.draw(0))
    with pytest.raises(ValueError, match="birth is a PoissonBirth; give a Multi"):
        lmb.lmb(scenes.target).init(plain, jax.random.key(0))
    driven = birth.DetectionBirth(
        jnp.array(0.1), jnp.array(0.5), jnp.ones(1), jnp.zeros(0), jnp.ones(1)
    )
    with pytest.raises(ValueError, match="undetected is given and nobody is"):
        lmb.lmb(scenes.target).init(plain._replace(birth=driven), jax.random.key(0))
    with pytest.raises(ValueError, match="method is 'murty'; give one of auto, belief"):
        lmb.lmb(scenes.target, method="murty")
    with pytest.raises(ValueError, match="num_sweeps is 0; give at least 1"):
        glmb.glmb(scenes.target, num_sweeps=0)
