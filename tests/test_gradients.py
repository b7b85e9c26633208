"""Gradients of the evidence in every number of every model, inside a tracker.

Central differences are held against reverse mode, which alone meets zero times infinity
where a branch is not taken.
"""

import functools

import jax
import numpy as np
import pytest
from cases import slopes
from cases.every_model import CASES, case_of, every_field, fields

from jaxtrack import engine

pytestmark = pytest.mark.usefixtures("whole_matrices")

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
    """Slopes per scale of each entry, by reverse mode and by differences.

    One program tells both: of each row, the evidence and its slopes.
    """
    params = case_of(name).params
    moved, scale = slopes.walks(params, floor=0.1, step=STEP)
    start = jax.tree.map(lambda x, y: np.concatenate([[x], y]), params, moved)
    both = jax.jit(jax.vmap(jax.value_and_grad(functools.partial(evidence, name))))
    value, slope = jax.tree.map(np.array, both(start))
    first = slopes.flat(jax.tree.map(lambda x: x[0], slope))
    return first * scale, slopes.differences(value[1:], STEP)


@every_case
def test_gradients_are_right(name):
    expected, found = compared(name)
    params = case_of(name).params
    slopes.assert_near(params, expected, found, rtol=1e-4, atol=1e-6)


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
