"""Fits that are kept in a directory: they go on, and are told from others."""

import functools

import chex
import optax
import pytest
from cases.learning import start, watched, watcher

from jaxtrack import learn

pytestmark = pytest.mark.usefixtures("whole_matrices")

NEWTON = optax.lbfgs()
ADAM = optax.adam(0.1)


def both(p):
    return p.std, p.mean


class Killed(Exception):
    pass


def kill(done, total, value):
    if done == 4:
        raise Killed


@pytest.mark.parametrize("sizes", [{}, {"batch": 2, "window": 9}])
def test_a_fit_that_was_killed_goes_on_and_gives_the_same_numbers(tmp_path, sizes):
    settings = {"where": both, "num_steps": 9, "patience": 3, "errors": False, **sizes}
    run = functools.partial(learn.fit, watcher, start(), watched(), ADAM, **settings)
    with pytest.raises(Killed):
        run(directory=tmp_path, progress=kill)
    steps = []
    again = run(directory=tmp_path, progress=lambda *told: steps.append(told[0]))
    expected = run()
    assert steps == list(range(5, expected.num_steps + 1))
    chex.assert_trees_all_equal(again.history, expected.history)
    chex.assert_trees_all_equal(again.params, expected.params)
    # Once more nothing is left to do, and more steps may be asked for.
    assert run(directory=tmp_path, progress=kill).num_steps == expected.num_steps
    more = run(directory=tmp_path, num_steps=11, patience=None)
    assert more.num_steps == 11


def test_a_directory_holds_one_fit(tmp_path):
    run = functools.partial(
        learn.fit, watcher, start(), optimizer=ADAM, where=both, errors=False
    )
    run(scans=watched(), num_steps=2, directory=tmp_path)
    with pytest.raises(
        ValueError, match=r"keeps another fit \(fingerprint of code and"
    ):
        run(scans=watched(seed=1), num_steps=2, directory=tmp_path)
    told = (
        r"fit.npz keeps another fit \(seed is 0, not 1\); give another directory or r"
    )
    with pytest.raises(ValueError, match=told):
        run(scans=watched(), num_steps=2, directory=tmp_path, seed=1)
    with pytest.raises(ValueError, match="segment is 1, not 2"):
        run(scans=watched(), num_steps=2, directory=tmp_path, segment=2)
    with pytest.raises(ValueError, match="prior is .*, not <function likes>"):
        run(scans=watched(), num_steps=2, directory=tmp_path, prior=likes)
    with pytest.raises(ValueError, match="fit.npz keeps another fit .it is by anot"):
        run(scans=watched(), num_steps=2, directory=tmp_path, optimizer=NEWTON)


def likes(p):
    return -(p.mean**2)


def test_settings_that_have_no_name_are_told_apart_by_the_first_loss(tmp_path):
    def scaled(scale):
        def step(*given):
            return scaled_watch(scale, *given)

        return watcher._replace(step=step)

    run = functools.partial(
        learn.fit, params=start(), scans=watched(), optimizer=ADAM, where=both
    )
    settings = {"num_steps": 1, "directory": tmp_path, "errors": False}
    first = run(scaled(1.0), **settings)
    with pytest.raises(
        ValueError, match=r"another fit \(the first loss is 1\.\d+, not"
    ):
        run(scaled(1.001), **settings)
    bound = watcher._replace(step=functools.partial(scaled_watch, 1.0))
    with pytest.raises(ValueError, match=r"another fit \(tracker is "):
        run(bound, **settings)
    again = run(scaled(1.0), **settings)
    chex.assert_trees_all_equal(again.history, first.history)


def scaled_watch(scale, params, state, scan):
    state, told = watcher.step(params, state, scan)
    return state, told._replace(log_evidence=scale * told.log_evidence)
