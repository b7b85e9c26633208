"""The contract that every target keeps, whatever is inside it.

Each case is compiled three times: alone with gradients and a grid of detections to
integrate over, over a batch of variants, and in float32. All tests share these results.
"""

import functools
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import bruteforce, kalman
from reference import imm as imm_book
from reference import mixture as mixture_book

from jaxtrack import linearize
from jaxtrack.models import motion, probability, sensor, switching, turn
from jaxtrack.targets import imm, mixture, single
from jaxtrack.types import Gaussian, Target

NUM = 4  # detections, and beliefs to collapse
KEY = np.array(jax.random.key_data(jax.random.key(0)))
QUICK = {"xla_backend_optimization_level": 0}  # compiling is what takes the time


class Case(NamedTuple):
    """A target, its parameters, a prior, and the span of detections to integrate."""

    target: Target
    params: Any
    prior: Gaussian
    mode_prob: Any
    centre: Any
    reach: Any


class Inputs(NamedTuple):
    """What a story is told about; all arrays."""

    params: Any
    prior: Gaussian
    mode_prob: Any
    detections: Any
    interval: Any
    log_weight: Any


def array(*values):
    return np.array(values, float)


def value(number):
    return np.array(number, float)


ONE_AXIS = Gaussian(array(1.0, -2.0), np.array([[4.0, 1.0], [1.0, 2.0]]))
LINEAR_SPAN = (array(-0.5), array(40.0))
SWITCHING = switching.MarkovSwitching(np.array([[0.8, 0.2], [0.45, 0.55]]))
TURNING = Gaussian(
    array(300.0, 12.0, 400.0, -9.0, 0.1),
    np.diag(array(60.0, 9.0, 90.0, 4.0, 0.01))
    + np.diag(array(3.0, 0, 1.0, 0), 1) / 2
    + np.diag(array(3.0, 0, 1.0, 0), -1) / 2,
)
RADAR = sensor.RangeBearing(array(6.0, 0.015), array(20.0, -30.0), value(0.4))
RADAR_SPAN = (array(525.0, 0.585), array(150.0, 0.3))


def kf_case():
    params = single.Params(
        motion=motion.ConstantVelocity(array(0.7)),
        sensor=sensor.Position(array(1.3)),
        survive=probability.Lifetime(value(30.0)),
        detect=probability.Constant(value(0.85)),
    )
    return Case(single.single(), params, ONE_AXIS, np.ones(1), *LINEAR_SPAN)


def radar_case(method):
    params = single.Params(
        motion=turn.TurnRate(value(2.0), value(1e-3)),
        sensor=RADAR,
        survive=probability.Constant(value(0.95)),
        detect=probability.InsideDisc(
            value(0.9), array(0.0, 0.0), value(600.0), value(100.0)
        ),
    )
    return Case(single.single(method), params, TURNING, np.ones(1), *RADAR_SPAN)


def two_modes():
    return imm.Params(
        motions=(
            motion.ConstantVelocity(array(0.3)),
            motion.OrnsteinUhlenbeck(array(9.0), array(3.0)),
        ),
        switching=SWITCHING,
        sensor=sensor.Position(array(1.3)),
        survive=probability.PerMode(array(0.97, 0.8)),
        detect=probability.PerMode(array(0.9, 0.6)),
    )


def linear_case(target):
    return Case(target, two_modes(), ONE_AXIS, array(0.65, 0.35), *LINEAR_SPAN)


def imm_nonlinear_case():
    params = imm.Params(
        motions=(
            turn.TurnRate(value(2.0), value(1e-3)),
            motion.PiecewiseAcceleration(
                turn.TurnRate(value(9.0), value(1e-2)), array(0.5, 0.8)
            ),
        ),
        switching=SWITCHING,
        sensor=RADAR,
        survive=probability.PerMode(array(0.97, 0.8)),
        detect=probability.PerMode(array(0.9, 0.6)),
    )
    target = imm.imm(linearize.taylor)
    return Case(target, params, TURNING, array(0.65, 0.35), *RADAR_SPAN)


def one_mode_case():
    params = two_modes()._replace(
        motions=(motion.ConstantVelocity(array(0.7)),),
        switching=switching.MarkovSwitching(np.ones((1, 1))),
        survive=probability.PerMode(array(0.9)),
        detect=probability.PerMode(array(0.7)),
    )
    target = mixture.mixture(max_components=4, prune_threshold=0.0, merge_threshold=1.0)
    return Case(target, params, ONE_AXIS, np.ones(1), *LINEAR_SPAN)


MERGING = mixture.mixture(max_components=6, prune_threshold=0.0, merge_threshold=1.0)
ROOMY = mixture.mixture(max_components=16, prune_threshold=0.0, merge_threshold=0.0)
CASES = {
    "single_kf": kf_case,
    "single_ekf": functools.partial(radar_case, linearize.taylor),
    "single_ukf": functools.partial(radar_case, linearize.unscented),
    "single_ckf": functools.partial(radar_case, linearize.cubature),
    "imm": functools.partial(linear_case, imm.imm()),
    "imm_nonlinear": imm_nonlinear_case,
    "mixture": functools.partial(linear_case, MERGING),
    "mixture_one_mode": one_mode_case,
}
every_target = pytest.mark.parametrize("name", CASES)


@functools.cache
def case_of(name):
    return CASES[name]()


def base_inputs(name):
    """Detections near where the target will be, no two alike."""
    case = case_of(name)
    rng = np.random.default_rng(1)
    gap = rng.uniform(-0.08, 0.08, (NUM, case.centre.size)) * np.array(case.reach)
    return Inputs(
        case.params,
        case.prior,
        case.mode_prob,
        np.array(np.array(case.centre) + gap),
        value(0.75),
        array(-1.0, -0.3, -2.0, -0.7),
    )


def story(target, inputs):
    """One life: born, two intervals, then missed, or detected in each of the places."""
    params = inputs.params
    born = target.begin(
        params, inputs.prior, inputs.mode_prob, jax.random.wrap_key_data(KEY)
    )
    middle, log_first = target.predict(params, born, inputs.interval)
    late, log_second = target.predict(params, middle, inputs.interval)
    missed, log_miss = target.miss(params, late)
    score = target.score(params, late, inputs.detections)
    corrected = jax.vmap(target.correct, (None, None, 0))(
        params, late, inputs.detections
    )
    few = jax.tree.map(lambda x: x[:NUM], corrected)
    collapsed = target.collapse(inputs.log_weight, few)
    return {
        "born": born,
        "middle": middle,
        "late": late,
        "missed": missed,
        "corrected": corrected,
        "collapsed": collapsed,
        "log_survive": jnp.stack([log_first, log_second]),
        "log_miss": log_miss,
        "score": score,
    }


BELIEFS = ("born", "middle", "late", "missed", "collapsed")


def summary(target, told):
    """Moments, modes and losses of every belief of a story."""
    views = target.moments, target.modes, target.lost
    short = {name: tuple(view(told[name]) for view in views) for name in BELIEFS}
    short["corrected"] = tuple(jax.vmap(view)(told["corrected"]) for view in views)
    return short


def loss_of(target, inputs):
    """One number that everything in a story bears on."""
    told = story(target, inputs)
    belief = target.moments(told["collapsed"])
    scale = jnp.arange(1.0, belief.mean.size + 1)
    missed = target.moments(told["missed"])
    return (
        told["score"][:NUM].sum()
        + told["log_miss"]
        + told["log_survive"].sum()
        + (belief.mean * scale).sum() / 100
        + (missed.mean * scale).sum() / 100
        + (belief.cov * scale[None] * scale[:, None]).sum() / 100
    ), told


@functools.cache
def batched(name):
    """The compiled story of many variants at once, and how often it was traced."""
    target = case_of(name).target
    traces = []

    def tell(inputs):
        traces.append(name)
        loss, told = loss_of(target, inputs)
        return loss, told, summary(target, told)

    return jax.jit(jax.vmap(tell), compiler_options=QUICK), traces


def variants(name):
    """Named variants of the inputs, to be told in one batch."""
    base = base_inputs(name)
    params = base.params
    weights = base.log_weight
    third = np.arange(NUM) == 2
    nobody = np.full(NUM, -np.inf)
    empty = np.where(third, nobody, weights)
    gap = np.outer(third, case_of(name).reach * 0.1)
    moved = base.detections + gap
    immortal = params.survive
    if not isinstance(immortal, probability.Lifetime):
        immortal = jax.tree.map(np.ones_like, immortal)
    return {
        "base": base,
        "backwards": base._replace(detections=base.detections[::-1]),
        "heavier": base._replace(log_weight=weights + 7),
        "empty": base._replace(log_weight=empty),
        "empty, other": base._replace(log_weight=empty, detections=moved),
        "only third": base._replace(log_weight=np.where(third, -9.0, nobody)),
        "nobody": base._replace(log_weight=nobody),
        "at once": base._replace(
            params=params._replace(survive=immortal), interval=value(0.0)
        ),
    }


def directions(name):
    """For each float leaf of the inputs, a small random step and its place."""
    base = base_inputs(name)
    leaves, tree = jax.tree.flatten(base)
    rng = np.random.default_rng(2)
    for i, leaf in enumerate(leaves):
        scale = np.maximum(
            np.abs(np.array(leaf)), 1e-2 * np.abs(np.array(leaf)).max() + 1e-9
        )
        step = np.array(rng.normal(size=leaf.shape) * scale)
        yield jax.tree.unflatten(
            tree, [step if j == i else np.zeros_like(x) for j, x in enumerate(leaves)]
        )


STEP = 1e-5


@functools.cache
def told(name):
    """All variants of a case: {variant: (loss, story, summary)}, and the slopes."""
    named = variants(name)
    base = named["base"]
    steps = list(directions(name))
    walks = [
        jax.tree.map(lambda x, d, s=s: x + s * STEP * d, base, step)
        for step in steps
        for s in (1, -1)
    ]
    batch = jax.tree.map(lambda *x: np.stack(x), *named.values(), *walks)
    tell, traces = batched(name)
    tell(batch)
    result = jax.tree.map(np.array, tell(batch))
    assert len(traces) == 1
    pick = {
        key: jax.tree.map(lambda x, i=i: x[i], result) for i, key in enumerate(named)
    }
    losses = result[0][len(named) :].reshape(-1, 2)
    return pick, steps, (losses[:, 0] - losses[:, 1]) / (2 * STEP)


@functools.cache
def alone(name):
    """The same story without a batch, its gradient, and a grid of detections."""
    case, base = case_of(name), base_inputs(name)
    axes = [np.linspace(-1, 1, 801 if case.centre.size == 1 else 61)] * case.centre.size
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, case.centre.size)
    cell = np.prod(np.array(case.reach) * (axes[0][1] - axes[0][0]))
    points = np.array(np.array(case.centre) + grid * np.array(case.reach))
    target = case.target

    def tell(inputs):
        (loss, told), slope = jax.value_and_grad(
            lambda inputs: loss_of(target, inputs), has_aux=True
        )(inputs)
        one = jax.tree.map(lambda x: x[:1], told["corrected"])
        only = target.moments(target.collapse(inputs.log_weight[:1], one))
        return loss, slope, told, summary(target, told), only

    wide = base._replace(detections=np.concatenate([base.detections, points]))
    tell = jax.jit(tell, compiler_options=QUICK)
    loss, slope, life, brief, only = jax.tree.map(np.array, tell(wide))
    empty = wide._replace(
        log_weight=np.where(np.arange(NUM) == 2, -np.inf, base.log_weight)
    )
    score, seen = (
        life["score"][NUM:],
        jax.tree.map(lambda x: x[NUM:], brief["corrected"]),
    )
    life["score"] = life["score"][:NUM]
    for told in (life, brief):
        told["corrected"] = jax.tree.map(lambda x: x[:NUM], told["corrected"])
    slope = slope._replace(detections=slope.detections[:NUM])
    empty_slope = jax.tree.map(np.array, tell(empty)[1])
    return loss, slope, life, brief, score, seen[:2], only, cell, empty_slope


@every_target
def test_beliefs_keep_structure_shape_and_dtype(name):
    """In float64 and, whatever the default, in float32."""
    case, base = case_of(name), base_inputs(name)
    for dtype in (jnp.float64, jnp.float32):
        inputs = jax.tree.map(lambda x, d=dtype: x.astype(d), base)
        life = jax.eval_shape(functools.partial(story, case.target), inputs)
        born = life["born"]
        for key in BELIEFS:
            chex.assert_trees_all_equal_shapes_and_dtypes(life[key], born)
        for leaf in jax.tree.leaves(life):
            assert leaf.dtype == dtype


@every_target
def test_scores_do_not_depend_on_each_other(name):
    forwards, backwards = (told(name)[0][k][1]["score"] for k in ("base", "backwards"))
    np.testing.assert_allclose(backwards[::-1], forwards, rtol=1e-10)
    assert len(set(forwards.round(6))) == NUM
    case, base = case_of(name), base_inputs(name)
    late = jax.tree.map(np.asarray, alone(name)[2]["late"])
    score = jax.jit(case.target.score)
    for k in (0, NUM - 1):
        single_score = score(base.params, late, base.detections[k : k + 1])
        np.testing.assert_allclose(single_score, forwards[k : k + 1], rtol=1e-10)


@every_target
def test_scores_integrate_to_the_probability_of_detection(name):
    """The law of total probability, with the chance of a miss computed apart."""
    _, _, life, _, score, _, _, cell, _ = alone(name)
    detected = np.exp(score).sum() * cell
    assert 0.05 < detected < 0.99
    np.testing.assert_allclose(detected + np.exp(life["log_miss"]), 1, rtol=1e-7)


@every_target
def test_a_scan_teaches_nothing_on_average(name):
    """Missed or corrected, weighted by how likely: mean, spread and modes stay."""
    _, _, life, brief, score, (seen, modes), _, cell, _ = alone(name)
    weight = np.exp(score) * cell
    missed, missed_modes, _ = brief["missed"]
    expected, expected_modes, _ = brief["late"]
    chance = np.exp(life["log_miss"])

    def second(belief):
        return belief.cov + belief.mean[..., :, None] * belief.mean[..., None, :]

    mean = chance * missed.mean + np.einsum("g,gd->d", weight, seen.mean)
    np.testing.assert_allclose(mean, expected.mean, rtol=1e-6)
    square = chance * second(missed) + np.einsum("g,gde->de", weight, second(seen))
    np.testing.assert_allclose(square, second(expected), rtol=1e-6)
    average = chance * missed_modes + weight @ modes
    np.testing.assert_allclose(average, expected_modes, rtol=1e-6)


@every_target
def test_collapse_ignores_empty_slots(name):
    chex.assert_trees_all_close(
        told(name)[0]["empty"][1]["collapsed"],
        told(name)[0]["empty, other"][1]["collapsed"],
        rtol=1e-9,
    )


@every_target
def test_collapse_needs_no_normalised_weights(name):
    chex.assert_trees_all_close(
        told(name)[0]["heavier"][1]["collapsed"],
        told(name)[0]["base"][1]["collapsed"],
        rtol=1e-9,
        atol=1e-12,
    )


@every_target
def test_collapse_of_one_gives_it_back(name):
    """One filled slot among empty ones, and one slot in all."""
    brief = told(name)[0]["only third"][2]
    third = jax.tree.map(lambda x: x[2], brief["corrected"])
    chex.assert_trees_all_close(brief["collapsed"][:2], third[:2], rtol=1e-9)
    first = jax.tree.map(lambda x: x[0], alone(name)[3]["corrected"])
    chex.assert_trees_all_close(alone(name)[6], first[0], rtol=1e-9)


@every_target
def test_collapse_keeps_the_moments_of_the_pool(name):
    brief = told(name)[0]["base"][2]
    belief, modes, lost = brief["collapsed"]
    weight = np.exp(np.array(base_inputs(name).log_weight))
    pool, pool_modes, _ = brief["corrected"]
    mean, cov = mixture_book.moment_match(list(zip(weight, *pool, strict=True)))
    assert lost == 0
    np.testing.assert_allclose(belief.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(belief.cov, cov, rtol=1e-9)
    np.testing.assert_allclose(modes, weight / weight.sum() @ pool_modes, rtol=1e-9)


@every_target
def test_collapse_of_nobody_is_the_first(name):
    _, life, brief = told(name)[0]["nobody"]
    chex.assert_tree_all_finite(brief)
    first = jax.tree.map(lambda x: x[0], brief["corrected"])
    chex.assert_trees_all_close(brief["collapsed"][:2], first[:2], rtol=1e-9)


@every_target
def test_no_time_and_no_death_only_mixes_the_modes(name):
    _, life, brief = told(name)[0]["at once"]
    case = case_of(name)
    np.testing.assert_allclose(life["log_survive"], 0, atol=1e-12)
    for key, steps in (("born", 0), ("middle", 1), ("late", 2)):
        belief, modes, _ = brief[key]
        np.testing.assert_allclose(belief.mean, case.prior.mean, rtol=1e-9)
        np.testing.assert_allclose(belief.cov, case.prior.cov, rtol=1e-7, atol=1e-9)
        if modes.size == 2:
            p = np.linalg.matrix_power(np.array(SWITCHING.transition), steps)
            np.testing.assert_allclose(modes, np.array(case.mode_prob) @ p, rtol=1e-9)


@every_target
def test_a_batch_is_a_loop_and_does_not_retrace(name):
    loss, _, life, brief, *_ = alone(name)
    chex.assert_trees_all_close(
        told(name)[0]["base"], (loss, life, brief), rtol=1e-9, atol=1e-9
    )


@every_target
def test_gradients_are_right(name):
    """Along a random direction in each leaf: parameters, prior, detections, weights."""
    slope = alone(name)[1]
    _, steps, expected = told(name)
    for step, difference in zip(steps, expected, strict=True):
        products = jax.tree.map(lambda g, d: (g * d).sum(), slope, step)
        along = sum(jax.tree.leaves(products))
        size = sum(
            jax.tree.leaves(jax.tree.map(lambda g, d: np.abs(g * d).sum(), slope, step))
        )
        np.testing.assert_allclose(
            along, difference, rtol=1e-5, atol=1e-6 + 1e-6 * size
        )


@every_target
def test_gradients_are_finite_with_empty_slots(name):
    chex.assert_tree_all_finite(alone(name)[8])


@pytest.mark.parametrize("name", ["single_kf", "single_ukf", "imm", "mixture"])
def test_float32_is_near_float64(name):
    case = case_of(name)
    inputs = jax.tree.map(lambda x: np.array(x, np.float32), base_inputs(name))
    with jax.enable_x64(False):
        life = story_and_summary(case.target)(inputs)
        rough = jax.tree.map(np.array, life)
    _, fine_life, fine = told(name)[0]["base"]
    for leaf in jax.tree.leaves(rough):
        assert leaf.dtype == np.float32
    np.testing.assert_allclose(
        rough[0]["score"], fine_life["score"], rtol=3e-4, atol=3e-4
    )
    for key in BELIEFS:
        belief, modes, _ = rough[1][key]
        expected, expected_modes, _ = fine[key]
        std = np.sqrt(np.diag(expected.cov))
        np.testing.assert_allclose(belief.mean / std, expected.mean / std, atol=3e-3)
        cov = (belief.cov - expected.cov) / np.outer(std, std)
        np.testing.assert_allclose(cov, 0, atol=3e-3)
        np.testing.assert_allclose(modes, expected_modes, atol=1e-4)


def story_and_summary(target):
    def tell(inputs):
        life = story(target, inputs)
        return life, summary(target, life)

    return jax.jit(tell, compiler_options=QUICK)


# What is true of one target only: it is what its name says.


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


SEEN = [array(0.4), None, array(-3.5)]


@functools.cache
def compiled(target):
    verbs = target.predict, target.miss, target.score, target.correct
    return tuple(jax.jit(verb, compiler_options=QUICK) for verb in verbs)


def live(target, params):
    """Three scans, the second without detection: rows as `bruteforce.jump_markov`."""
    predict, miss, score, correct = compiled(target)
    belief = target.begin(params, ONE_AXIS, array(0.65, 0.35), KEY)
    rows = []
    for z in SEEN:
        belief, log_survive = predict(params, belief, value(0.75))
        if z is None:
            belief, log_prob = miss(params, belief)
        else:
            log_prob = score(params, belief, z[None])[0]
            belief = correct(params, belief, z)
        whole = target.moments(belief)
        rows.append((*np.exp([log_survive, log_prob]), target.modes(belief), *whole))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


@functools.cache
def imm_life():
    return live(imm.imm(), two_modes())


def test_single_is_the_kalman_filter():
    case = case_of("single_kf")
    params, z = case.params, base_inputs("single_kf").detections[1]
    F, Q = (np.array(f(0.75)) for f in (params.motion.transition, params.motion.noise))
    H, R = np.array([[1.0, 0.0]]), np.array(params.sensor.cov())
    m, P = kalman.predict(*(np.array(x) for x in case.prior), F, 0, Q)
    m, P = kalman.predict(m, P, F, 0, Q)
    m, P, log_density = kalman.update(m, P, H, 0, R, np.array(z))
    _, life, brief = told("single_kf")[0]["base"]
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
    chex.assert_trees_all_close(imm_life(), expected, rtol=1e-9)


def test_mixture_of_one_component_a_mode_is_the_imm():
    target = mixture.mixture(
        max_components=1, prune_threshold=0.0, merge_threshold=float("inf")
    )
    chex.assert_trees_all_close(live(target, two_modes()), imm_life(), rtol=1e-9)


def test_roomy_mixture_is_exact():
    """Against the enumeration of all sixteen sequences of modes."""
    params = two_modes()
    expected = bruteforce.jump_markov(
        book_model(params, 0.75, 16, 0.0),
        *(np.array(x) for x in ONE_AXIS),
        [0.65, 0.35],
        [None if z is None else np.array(z) for z in SEEN],
    )
    chex.assert_trees_all_close(live(ROOMY, params), expected, rtol=1e-9)
    difference = np.abs(expected[3] - imm_life()[3]).max()
    assert difference > 1e-4  # the IMM is not, so the scene can tell them apart


def test_mixture_says_what_its_capacity_lost():
    tight = mixture.mixture(max_components=1, prune_threshold=0.0, merge_threshold=0.0)
    params = two_modes()
    model = book_model(params, 0.75, 1, 0.0)
    predict, _, _, correct = compiled(tight)
    belief = tight.begin(params, ONE_AXIS, array(0.65, 0.35), KEY)
    expected = mixture_book.begin(model, *(np.array(x) for x in ONE_AXIS), [0.65, 0.35])
    for z in (array(0.4), array(-3.5)):
        belief, _ = predict(params, belief, value(0.75))
        expected, _ = mixture_book.predict(model, expected)
        np.testing.assert_allclose(
            tight.lost(belief), expected[1], rtol=1e-9, atol=1e-15
        )
        np.testing.assert_allclose(
            tight.modes(belief), mixture_book.mode_prob(expected)
        )
        belief = correct(params, belief, z)
        expected, _ = mixture_book.correct(model, expected, np.array(z))
    assert tight.lost(belief) > 0.05


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
