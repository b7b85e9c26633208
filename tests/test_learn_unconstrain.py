"""Free numbers for the parameters of any tracker, and what is chosen of them."""

import collections
import functools
import importlib
import inspect
import pkgutil
from typing import Annotated, Any, NamedTuple, get_type_hints

import jax
import numpy as np
import pytest
from cases.trackers import CASES, array, case_of, two_mode_params, value

from jaxtrack import learn, models
from jaxtrack.constraints import Covariance, Fixed, Positive, below, of
from jaxtrack.learn import leaves
from jaxtrack.models import clutter, probability, sensor
from jaxtrack.targets import likely_modes
from jaxtrack.types import Array

PARAMS = {
    name: functools.partial(lambda name: case_of(name).params, name) for name in CASES
}
PARAMS["likely_modes"] = lambda: likely_modes.Params(
    *two_mode_params(), unlikely_prob=value(0.02), principal_prob=value(0.4)
)


def flat(tree):
    """Arrays by their path in the tree."""
    found = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {jax.tree_util.keystr(path).removeprefix("."): x for path, x in found}


@functools.cache
def round_trips():
    """For each tracker what is free, and the parameters and slopes that it gives."""
    ways = {name: learn.unconstrain(make()) for name, make in PARAMS.items()}
    frees = {name: free for name, (free, _) in ways.items()}

    def back(frees):
        return {name: ways[name][1](free) for name, free in frees.items()}

    return frees, jax.tree.map(np.array, jax.jit(back)(frees))


@pytest.mark.parametrize("name", PARAMS)
def test_the_parameters_of_every_tracker_come_back(name):
    free, params = round_trips()[0][name], round_trips()[1][name]
    assert jax.tree.structure(params) == jax.tree.structure(PARAMS[name]())
    for path, expected in flat(PARAMS[name]()).items():
        # Relative to the array: a covariance's small entries are sums of larger ones.
        size = np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(
            flat(params)[path], expected, rtol=1e-12, atol=1e-14 * size, err_msg=path
        )
    assert all(np.isfinite(x).all() for x in free.values())
    assert set(free) <= set(flat(params))


def test_there_is_one_free_number_for_each_that_can_be_known():
    params = PARAMS["cbmember_imm"]()
    free, _ = learn.unconstrain(params)
    assert {name: x.size for name, x in free.items()} == {
        "target.motions[0].noise_density": 1,
        "target.motions[1].position_std": 1,
        "target.motions[1].time_constant": 1,
        "target.switching.transition": 2,
        "target.sensor.noise_std": 1,
        "target.survive.value": 2,
        "target.detect.value": 2,
        "birth.existence_prob": 2,
        "birth.mean": 4,
        "birth.cov": 6,
        "birth.mode_prob": 2,
        "clutter.rate": 1,
    }


def test_where_chooses_arrays_and_subtrees():
    params = PARAMS["cbmember_imm"]()
    free, constrain = learn.unconstrain(
        params, lambda p: (p.clutter.rate, p.target.motions, p.target.detect.value)
    )
    assert set(free) == {
        "clutter.rate",
        "target.motions[0].noise_density",
        "target.motions[1].position_std",
        "target.motions[1].time_constant",
        "target.detect.value",
    }
    moved = constrain(free | {"clutter.rate": free["clutter.rate"] + np.log(2.0)})
    np.testing.assert_allclose(moved.clutter.rate, 3.0)
    assert moved.birth.mean is params.birth.mean


def test_what_is_fixed_is_learned_only_by_name():
    params = PARAMS["cbmember_ekf"]()
    assert set(learn.unconstrain(params, lambda p: p.target.sensor)[0]) == {
        "target.sensor.noise_std"
    }
    free, constrain = learn.unconstrain(params, lambda p: p.target.sensor.position)
    moved = constrain({name: x + 1 for name, x in free.items()})
    np.testing.assert_allclose(moved.target.sensor.position, [10.0, 1.0])


def test_thresholds_keep_their_order():
    params = PARAMS["likely_modes"]()
    free, constrain = learn.unconstrain(params)
    assert {"unlikely_prob", "principal_prob"} < set(free)
    low = constrain(free | {"unlikely_prob": array(9.0), "principal_prob": array(-9.0)})
    assert 0 < low.unlikely_prob < low.principal_prob < 1e-3

    free, constrain = learn.unconstrain(params, lambda p: p.principal_prob)
    low = constrain({"principal_prob": array(-9.0)})
    assert low.unlikely_prob < low.principal_prob < 0.0203

    free, constrain = learn.unconstrain(params, lambda p: p.unlikely_prob)
    high = constrain({"unlikely_prob": array(9.0)})
    assert 0.399 < high.unlikely_prob < high.principal_prob


class Mine(NamedTuple):
    gain: Positive
    bounds: Fixed
    covs: tuple[Covariance, ...]
    lower: Annotated[Array, below("upper")]
    upper: Array
    free: Any
    count: int
    inner: Any = None


Bare = collections.namedtuple("Bare", "one two")


def mine():
    covs = (np.eye(2), np.array([[2.0, 1.0], [1.0, 1.0]]))
    inner = {"bare": Bare(array(1.0, -2.0), np.array([True]))}
    return Mine(0.5, array(1.0), covs, value(0.1), value(0.6), value(-3.0), 7, inner)


def test_a_tuple_of_ones_own_is_learned_as_it_is_annotated():
    free, constrain = learn.unconstrain(mine())
    assert {name: x.size for name, x in free.items()} == {
        "gain": 1,
        "covs[0]": 3,
        "covs[1]": 3,
        "lower": 1,
        "upper": 1,
        "free": 1,
        "inner['bare'].one": 2,
    }
    again = constrain(free)
    assert again.count == 7
    np.testing.assert_allclose(again.covs[1], mine().covs[1], rtol=1e-15)
    np.testing.assert_allclose(again.gain, 0.5, rtol=1e-15)


def test_entries_have_names():
    plan = leaves.plan(mine(), lambda p: (p.gain, p.covs, p.inner))
    assert leaves.entries(plan, mine()) == [
        *(f"covs[{i}][{j}]" for i in (0, 1) for j in ("0, 0", "1, 0", "1, 1")),
        "gain",
        "inner['bare'].one[0]",
        "inner['bare'].one[1]",
    ]


def test_an_annotation_within_a_union_is_found():
    assert of(Positive | None).kind == "positive"
    assert of(Any) is None


BOX = clutter.UniformClutter(value(1.5), array(-5.0), array(5.0))


@pytest.mark.parametrize(
    ("params", "where", "told"),
    [
        (probability.Constant(value(1.2)), None, "value is 1.2; give probabilities"),
        (sensor.Position(array(1.0, -2.0)), None, r"noise_std is \[ 1., -2.\]; give n"),
        (BOX._replace(rate=value(np.nan)), None, "rate is nan; give finite numbers"),
        (mine()._replace(lower=value(0.7)), None, "lower is 0.7; give probabilities b"),
        (
            mine()._replace(covs=(np.array([[1.0, 2.0], [2.0, 1.0]]),)),
            None,
            r"covs\[0\] is .*; give symmetric, positive definite",
        ),
        (
            two_mode_params().switching._replace(transition=np.ones((2, 2))),
            None,
            "transition is .*; give probabilities that sum to one",
        ),
        (probability.Constant(value(1.0)), None, "nothing is left to be learned"),
        (BOX, "rate", "where is 'rate'; give a function such as lambda p"),
        (BOX, lambda p: "rate", "where returns 'rate', which is no part"),
        (mine(), lambda p: p.count, "count holds .*, which has no slope"),
    ],
)
def test_bad_values_and_choices_are_told_in_a_sentence(params, where, told):
    with pytest.raises(ValueError, match=told):
        learn.unconstrain(params, where)


@pytest.mark.parametrize("rate", [6, np.int32(6), np.array(6)])
def test_a_whole_number_is_learned_where_its_field_says_what_it_may_be(rate):
    free, constrain = learn.unconstrain(BOX._replace(rate=rate))
    np.testing.assert_allclose(free["rate"], [np.log(6.0)], rtol=1e-15)
    assert free["rate"].dtype == float
    found = constrain({"rate": free["rate"] + np.log(1.25)})
    np.testing.assert_allclose(found.rate, 7.5, rtol=1e-14)
    params = PARAMS["cbmember_imm"]()
    mean = np.round(params.birth.mean).astype(int)
    birth = params.birth._replace(mean=mean)
    free, constrain = learn.unconstrain(params._replace(birth=birth))
    np.testing.assert_allclose(constrain(free).birth.mean, mean, rtol=1e-12)
    assert "birth.mean" in free


def test_params_that_are_traced_get_one_sentence():
    with pytest.raises(ValueError, match="traced by jax; call unconstrain outside of"):
        jax.jit(lambda params: learn.unconstrain(params)[0])(BOX)


def test_only_what_may_be_any_number_is_declared_without_constraint():
    free = set()
    for info in pkgutil.iter_modules(models.__path__, f"{models.__name__}."):
        module = importlib.import_module(info.name)
        for name, model in inspect.getmembers(module, inspect.isclass):
            if model.__module__ == info.name and hasattr(model, "_fields"):
                hints = get_type_hints(model, include_extras=True)
                free |= {f"{name}.{field}" for field in hints if hints[field] is Array}
    assert free == {
        "CoordinatedTurn.turn_rate",
        "InsideDisc.centre",
        "KnownAcceleration.acceleration",
    }


def test_keys_and_numbers_alone_are_no_trouble():
    key = jax.random.key(0)
    free, constrain = learn.unconstrain((2.5, key, np.array([True])))
    assert set(free) == {"[0]"}
    np.testing.assert_allclose(constrain({"[0]": array(2.0)})[0], 5.0)
    assert set(learn.unconstrain(value(3.0))[0]) == {"params"}
