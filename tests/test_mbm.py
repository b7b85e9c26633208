"""Tests of `trackers.mbm` against Bayes' recursion over sets of targets."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes
from reference import bernoullis
from test_pmbm import run as run_tracker

from jaxtrack.models import birth
from jaxtrack.trackers import glmb, mbm

SIZES = 1, 2
NUM, MAX = 6, 6
ROOM = {
    "max_hypotheses": 400,
    "max_tracks": 3,
    "max_leaves": 8,
    "gate_prob": 1.0,
    "prune_threshold": 0.0,
}


def draw(seed):
    """Numbers of a random problem, with a birth a scan and one target known before."""
    rng = np.random.default_rng(50 + seed)
    lower = rng.normal(size=(2, 2, 2)) + 2 * np.eye(2)
    return {
        **scenes.draw(seed),
        "prob": rng.uniform(0.2, 0.8, 2),
        "mean": rng.normal(size=(2, 2)),
        "cov": lower @ lower.transpose(0, 2, 1),
    }


def params_of(drawn):
    places = [
        birth.MultiBernoulliBirth(
            drawn["prob"][k, None],
            drawn["mean"][k, None],
            drawn["cov"][k, None],
            jnp.ones((1, 1)),
        )
        for k in range(2)
    ]
    plain = scenes.params_of(drawn)
    return plain._replace(birth=places[0], undetected=None, start=places[1])


def run(drawn, places, tracker):
    return run_tracker(params_of(drawn), places, tracker)


@functools.cache
def drawn():
    return [draw(seed) for seed in range(NUM)], [
        scenes.detections(seed, SIZES) for seed in range(NUM)
    ]


@functools.cache
def found(name):
    tracker = {
        "mbm": lambda: mbm.mbm(scenes.target, exist_threshold=0.0, **ROOM),
        "mbm01": lambda: mbm.mbm01(scenes.target, **ROOM),
        "glmb": lambda: glmb.glmb(scenes.target, method="k-best", **ROOM),
        "glmb drawn": lambda: glmb.glmb(scenes.target, num_sweeps=20, **ROOM),
    }[name]()
    many = jax.jit(jax.vmap(functools.partial(run, tracker=tracker)))
    return jax.tree.map(np.asarray, many(*map(scenes.stacked, drawn())))


@functools.cache
def known():
    """The sets, by Bayes' recursion, and the log-evidence, of each problem."""
    answers = []
    for one, places in zip(*drawn(), strict=True):
        model = scenes.model_of(one)
        transition, stationary = model["transition"], model["stationary"]
        model["noise"] = stationary - transition @ stationary @ transition.T
        each = list(zip(one["prob"], one["mean"], one["cov"], strict=True))
        model["births"], model["start"] = each[:1], each[1:]
        answers.append(bernoullis.recursion(model, places))
    return answers


@pytest.mark.parametrize("name", ["mbm", "glmb"])
def test_it_is_the_recursion_over_sets(name):
    """Sets, numbers, places and evidence; who is there is summed out or said."""
    state, estimate, log_evidence = found(name)
    weight, mean = bernoullis.intensity(state)
    for k, (sets, evidence) in enumerate(known()):
        np.testing.assert_allclose(log_evidence[k], evidence, rtol=1e-10)
        own = (
            np.exp(state.hypotheses.log_weight[k]),
            state.hypotheses.leaf[k],
            state.trees.existence_prob[k],
        )
        apart = bernoullis.kept_apart(*own)
        apart = sorted((w for w in apart.values() if w > 0), reverse=True)
        probs = sorted((w for w, _ in sets.values()), reverse=True)
        np.testing.assert_allclose(apart, probs, rtol=1e-10)
        number = np.zeros(MAX + 1)
        for key, (prob, _) in sets.items():
            number[len(key)] += prob
        np.testing.assert_allclose(
            bernoullis.numbers(*own, 0.0, MAX), number, rtol=1e-10, atol=1e-14
        )  # products of 1 - r leave a rounding where a number is impossible
        mean_number = number @ np.arange(MAX + 1)
        np.testing.assert_allclose(estimate.num_mean[k], mean_number, rtol=1e-10)
        for label, who in enumerate(["start 0", "0 0", "1 0"]):
            mine = [
                (prob, states[member][0])
                for key, (prob, states) in sets.items()
                for member in key
                if member[0] == who
            ]
            at = state.trees.label[k] == label
            expected = sum(prob for prob, _ in mine)
            np.testing.assert_allclose(weight[k][at], expected, rtol=1e-10)
            place = sum(prob * mean for prob, mean in mine) / expected
            # Means of either sign, of order one.
            np.testing.assert_allclose(mean[k][at][0], place, rtol=1e-10, atol=1e-10)


def test_hypotheses_that_know_who_is_there_say_yes_or_no():
    state, estimate, _ = found("glmb")
    assert set(np.unique(state.trees.existence_prob).round(12)) == {0.0, 1.0}
    assert (estimate.dropped < 1e-12).all()  # roundings of sums of order one


def test_glmb_by_k_best_is_mbm01_that_reports_the_likeliest_number():
    room = {**ROOM, "max_hypotheses": 40}
    own = glmb.glmb(scenes.target, method="k-best", **room).step
    other = mbm.mbm01(scenes.target, **room).step
    assert own.func is other.func
    (given,), (same,) = own.args, other.args
    assert given == same._replace(estimator="number")
    _, estimate, _ = found("glmb")
    for k, (sets, _) in enumerate(known()):
        number = np.zeros(MAX + 1)
        for key, (prob, _) in sets.items():
            number[len(key)] += prob
        assert estimate.exists[k].sum() == number.argmax()
        alike = [
            (w, key) for key, (w, _) in sets.items() if len(key) == number.argmax()
        ]
        heaviest = {"start 0": 0, "0 0": 1, "1 0": 2}
        labels = {heaviest[member[0]] for member in max(alike)[1]}
        assert set(estimate.label[k][estimate.exists[k]]) == labels


def test_drawn_children_have_their_weights():
    """None counts for more than it should, and the heavy ones are all found."""
    (state, _, log_evidence), (exact, _, expected) = found("glmb drawn"), found("glmb")
    share = np.exp(log_evidence - expected)
    assert (share > 0.99).all()
    for k in range(NUM):
        drawn, all_of_them = (
            np.sort(
                list(
                    bernoullis.kept_apart(
                        np.exp(one.hypotheses.log_weight[k]),
                        one.hypotheses.leaf[k],
                        one.trees.existence_prob[k],
                    ).values()
                )
            )[::-1]
            for one in (state, exact)
        )
        drawn, all_of_them = share[k] * drawn, all_of_them[: drawn.size]
        assert (drawn <= all_of_them * (1 + 1e-9)).all()
        assert (drawn >= 0.8 * all_of_them)[all_of_them > 1e-3].all()


def test_births_of_another_kind_are_refused():
    plain = scenes.params_of(scenes.draw(0))
    tracker = mbm.mbm(scenes.target)
    with pytest.raises(ValueError, match="birth is a PoissonBirth; give a Multi"):
        tracker.init(plain, jax.random.key(0))
    own = params_of(draw(0))._replace(undetected=plain.undetected)
    with pytest.raises(ValueError, match="undetected is given and births are multi"):
        tracker.init(own, jax.random.key(0))
