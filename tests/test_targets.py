"""The contract that every target keeps, whatever is inside it.

Each case is compiled twice, and some a third time: alone with gradients and a grid of
detections to integrate over, over a batch of variants and of steps for finite
differences, and in float32. All tests share these results; `cases.stories` has them.
"""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import slopes
from cases.stories import BELIEFS, alone, blend_weight, in_float32, story, told
from cases.targets import (
    CASES,
    NUM,
    SAMPLED,
    SECOND_VARIANTS,
    SWITCHING,
    base_inputs,
    case_of,
)
from reference import mixture as mixture_book


def parametrised(names):
    marks = {x: [pytest.mark.slow] if x in SECOND_VARIANTS else [] for x in names}
    return pytest.mark.parametrize(
        "name", [pytest.param(x, marks=marks[x]) for x in names]
    )


every_target = parametrised(CASES)
every_certain_target = parametrised([x for x in CASES if x not in SAMPLED])


@every_target
def test_beliefs_keep_structure_shape_and_dtype(name):
    """In float64 and, whatever the default, in float32."""
    case, base = case_of(name), base_inputs(name)
    for dtype in (jnp.float64, jnp.float32):
        inputs = jax.tree.map(lambda x, d=dtype: x.astype(d), base)
        life = jax.eval_shape(functools.partial(story, case.target), inputs)
        for key in BELIEFS:
            chex.assert_trees_all_equal_shapes_and_dtypes(life[key], life["born"])
        for leaf in jax.tree.leaves(life):
            assert leaf.dtype == dtype or jnp.issubdtype(leaf.dtype, jnp.integer)


@every_target
def test_scores_do_not_depend_on_each_other(name):
    """In whichever order, and alone among a grid of thousands."""
    forwards, backwards = (
        told(name).variant[key].life["score"] for key in ("base", "backwards")
    )
    np.testing.assert_allclose(backwards[::-1], forwards, rtol=1e-10)
    np.testing.assert_allclose(alone(name).telling.life["score"], forwards, rtol=1e-10)
    assert len(set(forwards.round(6))) == NUM


@every_target
def test_scores_integrate_to_the_probability_of_detection(name):
    """The law of total probability, with the chance of a miss computed apart."""
    one = alone(name)
    detected = np.exp(one.score).sum() * one.cell
    assert 0.05 < detected < 0.99
    log_miss = one.telling.life["log_miss"]
    np.testing.assert_allclose(detected + np.exp(log_miss), 1, rtol=1e-7)


@every_target
def test_a_scan_teaches_nothing_on_average(name):
    """Missed or corrected, weighted by how likely: mean, spread and modes stay."""
    one = alone(name)
    weight = np.exp(one.score) * one.cell
    seen, modes = one.seen
    missed, missed_modes, _ = one.telling.brief["missed"]
    expected, expected_modes, _ = one.telling.brief["late"]
    chance = np.exp(one.telling.life["log_miss"])

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
    one, other = (told(name).variant[key] for key in ("empty", "empty, other"))
    assert not np.allclose(one.life["score"], other.life["score"])
    chex.assert_trees_all_close(
        one.life["collapsed"], other.life["collapsed"], rtol=1e-9
    )


@every_target
def test_collapse_needs_no_normalised_weights(name):
    one, other = (told(name).variant[key] for key in ("heavier", "base"))
    chex.assert_trees_all_close(
        one.life["collapsed"], other.life["collapsed"], rtol=1e-9, atol=1e-12
    )


@every_target
def test_collapse_of_one_gives_it_back(name):
    """One filled slot among empty ones, and one slot in all."""
    brief = told(name).variant["only third"].brief
    third = jax.tree.map(lambda x: x[2], brief["corrected"])
    chex.assert_trees_all_close(brief["collapsed"][:2], third[:2], rtol=1e-9)
    one = alone(name)
    first = jax.tree.map(lambda x: x[0], one.telling.brief["corrected"])
    chex.assert_trees_all_close(one.only, first[0], rtol=1e-9)


@every_certain_target
def test_collapse_keeps_the_moments_of_the_pool(name):
    brief = told(name).variant["base"].brief
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
    brief = told(name).variant["nobody"].brief
    chex.assert_tree_all_finite(brief)
    first = jax.tree.map(lambda x: x[0], brief["corrected"])
    chex.assert_trees_all_close(brief["collapsed"][:2], first[:2], rtol=1e-9)


@every_target
def test_blend_keeps_the_moments_of_the_pool(name):
    """Corrected by each detection, or missed, as likely as the weights say."""
    brief = told(name).variant["base"].brief
    belief, modes, lost = brief["blended"]
    weight = np.exp(np.array(blend_weight(base_inputs(name))))
    missed, missed_modes, _ = brief["missed"]
    pool, pool_modes, _ = brief["corrected"]
    means = np.concatenate([pool.mean, missed.mean[None]])
    covs = np.concatenate([pool.cov, missed.cov[None]])
    mean, cov = mixture_book.moment_match(list(zip(weight, means, covs, strict=True)))
    np.testing.assert_allclose(lost, 0, atol=1e-15)  # one minus a sum, to a rounding
    np.testing.assert_allclose(belief.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(belief.cov, cov, rtol=1e-9)
    every = np.concatenate([pool_modes, missed_modes[None]])
    np.testing.assert_allclose(modes, weight / weight.sum() @ every, rtol=1e-9)


@every_target
def test_blend_of_nobody_is_missed(name):
    brief = told(name).variant["nobody"].brief
    chex.assert_trees_all_close(brief["blended"], brief["missed"], rtol=1e-9)


@every_target
def test_blend_ignores_empty_slots(name):
    one, other = (told(name).variant[key] for key in ("empty", "empty, other"))
    chex.assert_trees_all_close(one.life["blended"], other.life["blended"], rtol=1e-9)


@every_target
def test_distances_grow_as_scores_fall(name):
    """One Gaussian's score is its distance; a bank's distances are its own."""
    life = told(name).variant["base"].life
    assert (life["square"] > 0).all()
    if name.startswith("single"):
        size = case_of(name).centre.size
        log_density = -(life["square"] + life["log_det"] + size * np.log(2 * np.pi)) / 2
        level = life["score"] - log_density
        np.testing.assert_allclose(level, level[0], rtol=1e-9)
        detected = 1 - np.exp(life["log_miss"])
        np.testing.assert_allclose(np.exp(level[0]), detected, rtol=1e-9)


@every_certain_target
def test_no_time_and_no_death_only_mixes_the_modes(name):
    _, life, brief = told(name).variant["at once"]
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
    many = told(name)
    assert many.num_traces == 1
    chex.assert_trees_all_close(
        many.variant["base"], alone(name).telling, rtol=1e-9, atol=1e-9
    )


@every_certain_target
def test_gradients_are_right(name):
    """In every entry of the parameters, the prior, the detections and the weights."""
    many, base = told(name), base_inputs(name)
    slope = alone(name).slope
    slopes.assert_right(base, slope, many.slopes, many.scale, rtol=1e-5, atol=1e-6)


@every_target
def test_gradients_are_finite_with_empty_slots(name):
    chex.assert_tree_all_finite(alone(name).empty_slope)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("single_kf", marks=pytest.mark.slow),
        "single_ukf",
        pytest.param("imm", marks=pytest.mark.slow),
        "mixture",
    ],
)
def test_float32_is_near_float64(name):
    rough, fine = in_float32(name), told(name).variant["base"]
    for leaf in jax.tree.leaves(rough):
        assert leaf.dtype == np.float32
    np.testing.assert_allclose(
        rough.life["score"], fine.life["score"], rtol=3e-4, atol=3e-4
    )
    for key in BELIEFS:
        belief, modes, _ = rough.brief[key]
        expected, expected_modes, _ = fine.brief[key]
        std = np.sqrt(np.diag(expected.cov))
        np.testing.assert_allclose(belief.mean / std, expected.mean / std, atol=3e-3)
        cov = (belief.cov - expected.cov) / np.outer(std, std)
        np.testing.assert_allclose(cov, 0, atol=3e-3)
        np.testing.assert_allclose(modes, expected_modes, atol=1e-4)
