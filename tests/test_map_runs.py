"""Tests of `engine.map_runs` and `engine.run_many` against `jax.vmap`."""

import os
import pathlib
import subprocess
import sys

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import small

from jaxtrack import engine
from jaxtrack.study import devices


def walk(scale, start, key):
    """A run: T noisy steps from a start [2]; the path and where it ends."""
    steps = scale * jax.random.normal(key, (5, 2))
    return {"path": start[None] + jnp.cumsum(steps, 0), "end": start + steps.sum(0)}


def arguments(runs):
    keys = jax.random.split(jax.random.key(0), runs)
    return jnp.array(1.5), jnp.arange(2.0 * runs).reshape(runs, 2), keys


AXES = (None, 0, 0)


@pytest.mark.parametrize(("runs", "block"), [(1, 4), (4, 4), (7, 3), (300, 140)])
def test_runs_in_blocks_give_what_vmap_gives(runs, block):
    result = engine.map_runs(walk, *arguments(runs), in_axes=AXES, block=block)
    expected = jax.vmap(walk, AXES)(*arguments(runs))
    chex.assert_trees_all_close(result, expected, rtol=1e-14)


def test_settings_are_static_and_a_function_is_traced_once():
    traced = []

    def power(order, x):
        traced.append(order)
        return sum(x for _ in range(order))

    for _ in range(2):
        result = engine.map_runs(power, jnp.arange(3.0), static=(4,))
        np.testing.assert_array_equal(result, [0, 4, 8])
    assert traced == [4]


def test_it_can_be_compiled_into_a_program_and_differentiated():
    def loss(scale, mapped):
        whole = mapped(scale, *arguments(5)[1:])
        return (whole["path"] ** 2).sum()

    def blocks(*x):
        return engine.map_runs(walk, *x, in_axes=AXES, block=2)

    slope = jax.jit(jax.grad(loss), static_argnums=1)
    np.testing.assert_allclose(
        slope(1.5, blocks), slope(1.5, jax.vmap(walk, AXES)), rtol=1e-12
    )


@pytest.mark.parametrize("axes", [1, None, (0,), (None, None, None), (0, 0, 1)])
def test_axes_without_runs_are_refused(axes):
    with pytest.raises(ValueError, match="give 0 or None for each of the 3 arguments"):
        engine.map_runs(walk, *arguments(2), in_axes=axes)


def test_arguments_with_different_numbers_of_runs_are_refused():
    scale, start, keys = arguments(4)
    with pytest.raises(ValueError, match="of 3, 4 runs; give as many"):
        engine.map_runs(walk, scale, start[:3], keys, in_axes=AXES, block=2)


@pytest.mark.parametrize("runs", [1, 3, 127, 1000, 8192, 10_007, 100_000])
@pytest.mark.parametrize("count", [1, 2, 8])
@pytest.mark.parametrize("block", [1, 16, 1024])
def test_blocks_hold_all_runs_and_few_more(runs, count, block):
    each, size = devices.blocks(runs, count, block)
    assert size <= block + devices.LANES - 1
    total = each * size * count
    assert runs <= total < 1.15 * runs + count * each


def test_many_runs_of_a_tracker_are_those_of_single_ones():
    scenario = small.make()
    tracker, params = scenario.trackers["near"]
    keys = engine.run_keys(0, 0, 3)
    scans = jax.vmap(lambda key: scenario.simulate(key)[1])(keys)
    many = engine.run_many(tracker, params, scans, keys, block=2)
    for run in range(3):
        mine = jax.tree.map(lambda x, run=run: x[run], scans)
        one = engine.run(tracker, params, mine, keys[run])
        told = jax.tree.map(lambda x, run=run: x[run], many)
        chex.assert_trees_all_close(told, one)


@pytest.mark.parametrize(
    ("runs", "told"),
    [
        ((), "of no runs"),
        (np.ones(()), "of 0 runs"),
        ((np.ones(3), np.ones(4)), "of 3, 4 runs"),
    ],
)
def test_what_cannot_be_shared(runs, told):
    with pytest.raises(ValueError, match=told):
        engine.share(runs)


def test_two_devices_share_runs_that_they_cannot_share_evenly():
    script = """
        import jax
        jax.config.update("jax_enable_x64", True)
        jax.config.update("jax_num_cpu_devices", 2)
        import chex
        from jaxtrack import engine
        from test_map_runs import AXES, arguments, walk
        for runs in 1, 7, 8:
            given = arguments(runs)
            result = engine.map_runs(walk, *given, in_axes=AXES, block=2)
            chex.assert_trees_all_close(result, jax.vmap(walk, AXES)(*given))
        assert len(result["end"].sharding.device_set) == 2
        shared = engine.share(given[1:])
        assert len(shared[0].sharding.device_set) == 2
        same = engine.map_runs(walk, given[0], *shared, in_axes=AXES, block=2)
        chex.assert_trees_all_close(same, result)
        try:
            engine.share(arguments(7)[1:])
        except ValueError as error:
            assert "there are 7 runs for 2 devices" in str(error)
        else:
            raise AssertionError
        again = engine.map_runs(walk, given[0], result["end"], given[2], in_axes=AXES)
        slope = jax.grad(lambda s: engine.map_runs(
            walk, s, *given[1:], in_axes=AXES)["end"].sum())(given[0])
        plain = jax.grad(lambda s: jax.vmap(walk, AXES)(s, *given[1:])["end"].sum())
        chex.assert_trees_all_close(slope, plain(given[0]))
        print("done")
    """
    here = pathlib.Path(__file__).parent
    lines = script.splitlines()
    indent = len(lines[1]) - len(lines[1].lstrip())
    told = subprocess.run(
        [sys.executable, "-c", "\n".join(x[indent:] for x in lines)],
        env={**os.environ, "PYTHONPATH": f"{here}{os.pathsep}{here.parent}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.stdout == "done\n", told.stderr
