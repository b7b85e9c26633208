"""Tests of `jaxtrack.engine` on a scenario that compiles in a second."""

import json
import os
import pathlib
import subprocess
import sys

import chex
import jax
import numpy as np
import pytest
from reference import metrics as reference
from reference import small

from jaxtrack import engine
from jaxtrack.scenarios.world import observe
from jaxtrack.study.scores import Scores

SWEEP = {"clutter_rate": [1, 3]}
RUNS = 7
INDEX = [0, 2]  # where positions stand
simulate = jax.jit(observe, static_argnums=6)
score_chunk = jax.jit(engine.score_chunk, static_argnums=(0, 1))


def make(clutter_rate=1.0):
    """Has a tracker of its own, which no other test file has compiled before."""
    return small.make(clutter_rate, max_tracks=5)


@pytest.fixture(scope="module")
def sweep():
    """Three chunks, the last of which is short, at two clutter rates."""
    calls = []
    small.traces.clear()
    data = engine.monte_carlo(
        make,
        ["near", "far"],
        runs=RUNS,
        seed=3,
        settings=SWEEP,
        chunk=3,
        progress=lambda *done: calls.append(done),
    )
    return data, list(small.traces), calls


def run_by_hand(name, seed, run, clutter_rate, max_detections):
    """One run, scan by scan, with the keys that `run_keys` promises."""
    scenario = make(clutter_rate)
    key = jax.random.fold_in(jax.random.key(seed), run)
    scan_key, tracker_key = jax.random.split(key)
    scans = simulate(scan_key, *scenario.world, max_detections)
    tracker, params = scenario.trackers[name]
    state, step = tracker.init(params, tracker_key), jax.jit(tracker.step)
    for t in range(small.NUM_SCANS):
        scan = jax.tree.map(lambda x, t=t: x[t], scans)
        state, estimate = step(params, state, scan)
        truth = scenario.world.truth
        there = np.asarray(truth.state[t])[np.asarray(truth.exists[t])][:, INDEX]
        told = np.asarray(estimate.mean)[np.asarray(estimate.exists)][:, INDEX]
        yield there, told, estimate


@pytest.mark.parametrize(("name", "run", "rate"), [("near", 0, 1), ("far", 6, 3)])
def test_a_run_is_simulated_tracked_and_scored_as_by_hand(sweep, name, run, rate):
    at = {"tracker": name, "run": run, "setting": f"clutter_rate={rate}"}
    scores = sweep[0].sel(at)
    by_hand = run_by_hand(name, 3, run, rate, max_detections=7)
    for t, (there, told, estimate) in enumerate(by_hand):
        one = {key: float(x) for key, x in scores.isel(time=t).data_vars.items()}
        ospa = reference.ospa(there, told, small.CUTOFF, small.ORDER)
        gospa = reference.gospa(there, told, small.CUTOFF, small.ORDER)
        both = [one["ospa"], one["ospa_localisation"], one["ospa_cardinality"]]
        np.testing.assert_allclose(both, ospa, atol=1e-9)
        general = ["gospa", "gospa_localisation", "gospa_missed", "gospa_false"]
        np.testing.assert_allclose([one[x] for x in general], gospa[:4], atol=1e-6)
        assert one["num_true"] == len(there)
        assert one["num_reported"] == len(told)
        assert one["num_expected"] == pytest.approx(0.9 * len(told))
        assert one["log_evidence"] == float(estimate.log_evidence)


def test_study_has_its_dimensions_coordinates_and_attributes(sweep):
    data = sweep[0]
    assert dict(data.sizes) == {"setting": 2, "tracker": 2, "run": RUNS, "time": 6}
    for name in Scores._fields:
        assert data[name].dims == ("setting", "tracker", "run", "time")
    for name in ("seconds", "compile_seconds"):
        assert data[name].dims == ("setting", "tracker")
    assert data["tracker"].values.tolist() == ["near", "far"]
    assert data["clutter_rate"].values.tolist() == [1.0, 3.0]
    assert data["time"].values.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert json.loads(data.attrs["settings"]) == {"clutter_rate": [1.0, 3.0]}
    expected = {"scenario": "small", "seed": 3, "version": "0.1.0", "precision": 64}
    assert expected.items() <= data.attrs.items()
    assert (data.seconds > 0).all()
    assert data["ospa"].attrs == {"long_name": "OSPA", "units": "m"}


def test_sweep_and_short_last_chunk_trace_a_tracker_once(sweep):
    assert len(sweep[1]) == 1  # both names mean the same tracker, with other values
    compiling = sweep[0].compile_seconds.values
    assert compiling[0, 0] > 10 * compiling[1:].max()


def test_progress_counts_the_runs_of_all_trackers_and_settings(sweep):
    total = 2 * 2 * RUNS
    steps = [3, 6, 7, 10, 13, 14, 17, 20, 21, 24, 27, 28]
    assert sweep[2] == [(0, total), *((done, total) for done in steps)]


def test_seed_and_run_change_the_data(sweep):
    data = sweep[0]["ospa"].values[0, 0]
    assert len(np.unique(data[:, 0])) == RUNS
    other = engine.monte_carlo(make, ["near"], 3, 4, SWEEP, chunk=3)
    assert not np.isclose(other["ospa"].values[0, 0], data[:3]).any()


def test_data_do_not_depend_on_the_capacity_of_a_scan():
    world = make(clutter_rate=2).world
    key = jax.random.key(0)
    few, many = (simulate(key, *world, capacity) for capacity in (12, 30))
    assert not many.valid[:, 12:].any()
    cut = many._replace(detections=many.detections[:, :12], valid=many.valid[:, :12])
    chex.assert_trees_all_equal(few.valid, cut.valid)
    seen = few.valid[..., None]
    chex.assert_trees_all_equal(few.detections * seen, cut.detections * seen)


def test_a_run_is_the_same_whatever_the_chunk(sweep):
    scenario = make(3)
    tracker, params = scenario.trackers["near"]
    keys = engine.run_keys(3, 2, 4)
    world = scenario.world
    scores = score_chunk(tracker, 7, params, world, 30.0, 2.0, keys)
    expected = sweep[0].sel(setting="clutter_rate=3", tracker="near", run=range(2, 6))
    for name, values in scores._asdict().items():
        np.testing.assert_allclose(values, expected[name], rtol=1e-12)


@pytest.mark.slow
def test_runs_are_shared_among_devices_and_stay_the_same(sweep):
    """Two chunks of 3 and 1 runs on two devices: neither can be shared evenly."""
    script = """
        import jax, sys
        jax.config.update("jax_enable_x64", True)
        from jaxtrack import engine
        from test_engine import make
        assert jax.local_device_count() == 2
        data = engine.monte_carlo(make, ["far"], 4, 3, {"clutter_rate": [3]}, 3)
        print(data.ospa.values.tolist())
    """
    here = pathlib.Path(__file__).parent
    flags = "--xla_force_host_platform_device_count=2"
    paths = os.pathsep.join([str(here), str(here.parent)])
    told = subprocess.run(
        [sys.executable, "-c", "\n".join(x.strip() for x in script.splitlines())],
        env={**os.environ, "XLA_FLAGS": flags, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    )
    expected = sweep[0].ospa.sel(setting="clutter_rate=3", tracker="far", run=range(4))
    result = np.array(json.loads(told.stdout))[0, 0]
    np.testing.assert_allclose(result, expected, rtol=1e-12)
