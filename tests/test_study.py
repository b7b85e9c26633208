"""Tests of `jaxtrack.study`: sweeps, parts on disk, resuming, tables."""

import json
import math

import jax
import numpy as np
import pytest
import xarray
from reference import small

from jaxtrack import engine, plot
from jaxtrack.study import devices, numbers, parts, sweep, table
from jaxtrack.study.scores import Scores

SWEEP = {"clutter_rate": [1, 3]}
ARGUMENTS = (small.make, ["near", "far"], 7, 3, SWEEP, 3)
SCORES = list(Scores._fields)


class Killed(Exception):
    pass


@pytest.fixture(scope="module")
def expected():
    return engine.monte_carlo(*ARGUMENTS)


@pytest.fixture
def calls(monkeypatch):
    """Counts compiled calls."""
    made = []

    def counted(*arguments):
        made.append(arguments)
        return original(*arguments)

    original = devices.call
    monkeypatch.setattr(devices, "call", counted)
    return made


def kill_after(runs):
    def progress(done, total):
        if done >= runs:
            raise Killed

    return progress


def test_killed_study_goes_on_and_gives_the_same_numbers(tmp_path, calls, expected):
    with pytest.raises(Killed):
        engine.monte_carlo(*ARGUMENTS, tmp_path, kill_after(10))
    files = sorted(path.name for path in (tmp_path / "parts").iterdir())
    assert len(files) == len(calls) == 4
    assert files[0] == "clutter_rate=1 near 000000.npz"
    calls.clear()
    again = engine.monte_carlo(*ARGUMENTS, tmp_path)
    assert len(calls) == 12 - 4
    xarray.testing.assert_identical(again[SCORES], expected[SCORES])
    calls.clear()
    once_more = engine.monte_carlo(*ARGUMENTS, tmp_path)
    assert not calls
    xarray.testing.assert_identical(once_more, again)


def test_damaged_part_is_computed_again(tmp_path, calls, expected):
    engine.monte_carlo(*ARGUMENTS, tmp_path)
    files = sorted((tmp_path / "parts").iterdir())
    files[0].write_bytes(files[0].read_bytes()[:300])
    files[1].write_bytes(b"")
    np.savez(files[2], identity="{}")
    files[3].write_text("not a zip file")
    calls.clear()
    again = engine.monte_carlo(*ARGUMENTS, tmp_path)
    assert len(calls) == 4
    xarray.testing.assert_identical(again[SCORES], expected[SCORES])


def test_longer_study_takes_up_the_parts_of_a_shorter_one(tmp_path, calls, expected):
    shorter = (*ARGUMENTS[:2], 5, *ARGUMENTS[3:])
    engine.monte_carlo(*shorter, tmp_path)
    calls.clear()
    longer = engine.monte_carlo(*ARGUMENTS, tmp_path)
    assert len(calls) == 4  # a third chunk for each tracker and setting
    xarray.testing.assert_identical(longer[SCORES], expected[SCORES])


def make_with_other_numbers(clutter_rate: float = 1.0):
    return small.make(clutter_rate, detect_prob=0.8)


@pytest.mark.parametrize(
    ("number", "other", "what"),
    [
        (3, 4, "seed is 3, not 4"),
        (5, 2, "chunk is 3, not 2"),
        (4, {"clutter_rate": [1, 4]}, "max_detections is 7, not 8"),
        (0, make_with_other_numbers, "fingerprint of code and values is"),
    ],
)
def test_parts_of_another_study_are_refused(tmp_path, number, other, what):
    plan = sweep.plan(*ARGUMENTS)
    with pytest.raises(Killed):
        engine.monte_carlo(*ARGUMENTS, tmp_path, kill_after(3))
    arguments = [*ARGUMENTS]
    arguments[number] = other
    with pytest.raises(parts.ForeignPart, match=what) as error:
        engine.monte_carlo(*arguments, tmp_path)
    assert str(tmp_path / "parts") in str(error.value)
    assert "remove it or give another directory" in str(error.value)
    parts.discard(tmp_path, plan)
    assert not (tmp_path / "parts").exists()


def test_part_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "parts" / "one.npz"
    part = parts.Part({"ospa": np.arange(6.0).reshape(2, 3)}, 1.5, 0.5, {})
    parts.write(path, {"seed": 1}, part)

    def broken(file, **arrays):
        file.write(b"half a")
        raise Killed

    monkeypatch.setattr(np, "savez", broken)
    with pytest.raises(Killed):
        parts.write(path, {"seed": 2}, part)
    back = parts.read(path, {"seed": 1})
    assert back.seconds == 1.5
    assert back.compile_seconds == 0.5
    np.testing.assert_array_equal(back.scores["ospa"], part.scores["ospa"])


def test_example_is_run_0(tmp_path, expected):
    engine.monte_carlo(*ARGUMENTS, tmp_path)
    plan = sweep.plan(*ARGUMENTS)
    for job in plan.jobs:
        seen = parts.read_example(tmp_path, job)
        scores = expected.sel(setting=sweep.label(job.point), tracker=job.name, run=0)
        np.testing.assert_array_equal(seen.exists.sum(1), scores.num_reported)
        np.testing.assert_array_equal(-1.0 * seen.valid.sum(1), scores.log_evidence)
        assert seen.mean.shape == (6, 7, 4)
        assert seen.detections.shape == (6, 7, 2)
        # The echo of a detection moves by the same step in every scan.
        gap = seen.mean[..., [0, 2]] - seen.detections
        gap -= np.asarray(job.values[0].shift)
        np.testing.assert_allclose(gap[1], 1.5 * gap[0], atol=1e-9)
    with pytest.raises(ValueError, match="is missing; run the study"):
        parts.read_example(tmp_path / "elsewhere", plan.jobs[0])


def test_dataset_survives_a_file(tmp_path, expected):
    expected.to_netcdf(tmp_path / "result.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as back:
        xarray.testing.assert_identical(back.load()[SCORES], expected[SCORES])


def test_points_are_all_combinations_with_the_last_setting_fastest():
    settings = {"a": [1, 2], "b": [3, 4]}
    found = [tuple(point.values()) for point in sweep.points(settings)]
    assert found == [(1, 3), (1, 4), (2, 3), (2, 4)]
    assert sweep.points(None) == sweep.points({}) == [{}]
    assert sweep.label({"a": 1.0, "b": 0.25}) == "a=1, b=0.25"
    assert sweep.label({}) == "default"


@pytest.mark.parametrize("runs", [1, 9, 10, 25, 49, 51, 99, 100, 1000])
def test_chunks_cover_the_runs_and_waste_few(runs):
    chunks = sweep.chunks(runs)
    assert len({len(chunk) for chunk in chunks}) == 1
    everyone = [run for chunk in chunks for run in chunk]
    assert everyone == list(range(len(everyone)))
    assert runs <= len(everyone) < runs + 10


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"scenario": "nowhere"},
            "no scenario is called 'nowhere'; there are .*yuan2013",
        ),
        ({"trackers": []}, "no tracker is named; small has far, near"),
        ({"trackers": ["nera"]}, "small has no tracker 'nera'; it has far, near"),
        ({"trackers": ["far", "far"]}, "the list of trackers has far twice"),
        ({"runs": 0}, "runs is 0; give at least 1"),
        ({"chunk": 0}, "chunk is 0; give at least 1"),
        ({"seed": -1}, "seed is -1; give a whole number from 0"),
        ({"seed": 2**32}, "seed is 4294967296; give a whole number from 0"),
        (
            {"settings": {"speed": [1]}},
            "no setting is called 'speed'; there are clutter",
        ),
        ({"settings": {"clutter_rate": []}}, "clutter_rate has no values"),
        ({"settings": {"clutter_rate": [2, 2.0]}}, "clutter_rate has 2.0 twice"),
        ({"settings": {"clutter_rate": [-1]}}, "clutter_rate is -1; give 0 or more"),
        ({"settings": {"clutter_rate": [math.nan]}}, "clutter_rate is nan; give a fin"),
        (
            {"settings": {"detect_prob": [1.1]}},
            "detect_prob is 1.1; give a probability",
        ),
        ({"settings": {"max_tracks": [2.5]}}, "max_tracks is 2.5; give a whole number"),
        ({"settings": {"max_tracks": [0]}}, "max_tracks is 0; give at least 1"),
    ],
)
def test_what_makes_no_sense_is_named_with_a_remedy(change, message):
    arguments = {"scenario": small.make, "trackers": ["near"], "runs": 1, "seed": 0}
    with pytest.raises(ValueError, match=message) as error:
        sweep.plan(**{**arguments, **change})
    assert "\n" not in str(error.value)


def test_named_scenario_gets_whole_numbers_where_it_wants_them():
    plan = sweep.plan(
        "yuan2013-linear", ["gm-cv-cbmember"], 1, 0, {"max_tracks": [7.0]}
    )
    assert plan.attributes["scenario"] == "yuan2013-linear"
    assert plan.jobs[0].point == {"max_tracks": 7.0}


def test_published_numbers_belong_to_the_paper_s_own_setting():
    assert sweep.published(small.make, {}, "near") == 12.5
    assert sweep.published(small.make, {"clutter_rate": 1.0}, "near") == 12.5
    assert sweep.published(small.make, {"clutter_rate": 2.0}, "near") is None
    assert sweep.published(small.make, {"detect_prob": 0.5}, "near") is None
    assert sweep.published(small.make, {}, "far") is None


def test_summary_averages_over_time_and_then_over_runs(expected):
    data = expected.copy(deep=True)
    summary = table.summary(data)
    known = {"scenario": "small", "seed": 3, "version": "0.1.0", "runs": 7}
    assert known.items() <= summary.items()
    order = [
        (row["setting"]["clutter_rate"], row["tracker"]) for row in summary["rows"]
    ]
    assert order == [(1.0, "near"), (1.0, "far"), (3.0, "near"), (3.0, "far")]
    row = summary["rows"][1]
    ospa = data.ospa.values[0, 1].mean(1)
    assert row["ospa"]["mean"] == pytest.approx(ospa.mean())
    assert row["ospa"]["stderr"] == pytest.approx(ospa.std(ddof=1) / math.sqrt(7))
    gospa = data.gospa.values[0, 1].mean(1)
    assert row["gospa"]["mean"] == pytest.approx(gospa.mean())
    reported, true = data.num_reported.values[0, 1], data.num_true.values[0, 1]
    assert row["cardinality_bias"] == pytest.approx((reported - true).mean())
    expected_bias = (0.9 * reported - true).mean()
    assert row["expected_cardinality_bias"] == pytest.approx(expected_bias)
    assert row["runs_per_second"] == pytest.approx(7 / row["seconds"])
    assert row["dropped"] == 0
    json.dumps(summary, allow_nan=False)


def make_with_every(every: int = 1):
    """The small scenario with a scan left out, or with all of them."""
    made = small.make()
    flights = jax.tree.map(lambda x: x[::every], made.world.truth)
    return made._replace(world=made.world._replace(truth=flights))


def test_settings_may_have_scans_at_other_times():
    both = engine.monte_carlo(make_with_every, ["far"], 4, 3, {"every": [1, 2]})
    times = small.truth().time
    np.testing.assert_array_equal(both.time, times)
    rows = table.summary(both)["rows"]
    for setting, every in enumerate((1, 2)):
        own = engine.monte_carlo(make_with_every, ["far"], 4, 3, {"every": [every]})
        np.testing.assert_array_equal(
            both.ospa[setting, :, :, ::every], own.ospa[0], strict=True
        )
        alone = table.summary(own)["rows"][0]
        for name in ("ospa", "gospa", "cardinality_bias", "dropped"):
            assert rows[setting][name] == alone[name]
    assert both.ospa[1, :, :, 1::2].isnull().all()
    axes = plot.over_time(both, "num_reported").axes[1]
    assert len(axes.lines[-1].get_xdata()) == len(times[::2])
    assert numbers.numbers_chart(both, setting=1).axes[0].lines[-1].get_ydata().size < 5


def test_summary_of_one_run_or_of_no_number_can_be_written(expected):
    single = expected.isel(run=[0])
    assert table.summary(single)["rows"][0]["ospa"]["stderr"] is None
    broken = expected.copy(deep=True)
    broken["ospa"][0, 0, 0, 0] = math.nan
    summary = table.summary(broken)
    assert summary["rows"][0]["ospa"] == {"mean": None, "stderr": None}
    json.dumps(summary, allow_nan=False)
