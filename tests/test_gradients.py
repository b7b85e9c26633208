"""Gradients of the evidence in every number of every model, inside a tracker.

Central differences are held against forward mode, which is cheap to compile, and in
the slow tests against reverse mode, which alone meets zero times infinity where a
branch is not taken. The trackers' own contract has reverse mode in the fast tests.
"""

import functools

import jax
import numpy as np
import pytest
from cases import slopes
from cases.every_model import CASES, case_of, every_field, fields

from jaxtrack import engine

KEY = np.array(jax.random.key_data(jax.random.key(0)))
STEP = 1e-6
# Its density is flat, so it does not matter from where a place is looked at.
WITHOUT_SLOPE = {"PolarClutter.position", "PolarClutter.heading"}
WITHOUT_SLOPE |= {"PairBirth.max_speed"}  # a limit that a pair keeps or not
every_case = pytest.mark.parametrize("name", CASES)


def evidence(name, params):
    """The log-evidence of all scans."""
    case = case_of(name)
    tracker = case.maker(case.target)
    key = jax.random.wrap_key_data(KEY)
    return engine.run(tracker, params, case.scans, key).log_evidence.sum()


@functools.cache
def compared(name):
    """Slopes per scale of each entry, by forward mode and by differences; the scales.

    One program tells both: of each row, the evidence and its slope in one direction.
    """
    params = case_of(name).params
    moved, scale = slopes.walks(params, floor=0.1, step=STEP)
    size = len(scale)
    still = np.tile(slopes.flat(params), (size, 1))
    directions = slopes.rows_of(
        params, np.concatenate([np.diag(scale), np.zeros((2 * size, size))])
    )
    start = slopes.rows_of(params, still)
    start = jax.tree.map(lambda x, y: np.concatenate([x, y]), start, moved)

    @jax.jit
    @jax.vmap
    def along(params, direction):
        return jax.jvp(functools.partial(evidence, name), (params,), (direction,))

    value, slope = jax.tree.map(np.array, along(start, directions))
    return slope[:size], slopes.differences(value[size:], STEP), scale


@every_case
def test_forward_gradients_are_right(name):
    expected, found, _ = compared(name)
    params = case_of(name).params
    slopes.assert_near(params, expected, found, rtol=1e-4, atol=1e-6)


@pytest.mark.slow
@every_case
def test_reverse_gradients_are_right(name):
    _, found, scale = compared(name)
    params = case_of(name).params
    slope = jax.jit(jax.grad(functools.partial(evidence, name)))(params)
    slopes.assert_right(params, slope, found, scale, rtol=1e-4, atol=1e-6)


def test_every_number_of_every_model_bears_on_the_evidence():
    """A model that stands in no case, or a value that nothing uses, is named here."""
    used = set()
    for name in CASES:
        entries = np.abs(compared(name)[0])
        named = list(fields(case_of(name).params))
        ends = np.cumsum([np.size(leaf) for _, leaf in named])[:-1]
        for (field, _), part in zip(named, np.split(entries, ends), strict=True):
            used |= {field} if part.max(initial=0.0) > 1e-6 else set()
    assert every_field() - used == WITHOUT_SLOPE
