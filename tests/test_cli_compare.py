"""Tests of the commands `jaxtrack scenarios` and `jaxtrack compare`."""

import json
import os
import pathlib
import subprocess
import sys
import types

import matplotlib.image
import pytest
import xarray
from reference import small
from typer.testing import CliRunner

from jaxtrack import engine, scenarios
from jaxtrack.cli import app, compare
from jaxtrack.study import table
from jaxtrack.study.scores import Scores

ROOT = pathlib.Path(__file__).parent.parent
KEYS = {"tracker", "setting", "ospa", "gospa", "cardinality_bias", "seconds"}
KEYS |= {"expected_cardinality_bias", "compile_seconds", "runs_per_second", "dropped"}
FILES = ["cardinality.png", "numbers.png", "ospa.png", "result.nc", "summary.json"]


@pytest.fixture(autouse=True)
def known(monkeypatch):
    monkeypatch.setitem(scenarios.MAKERS, "small", small.make)


def jaxtrack(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """All trackers at two clutter rates, seven runs each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(scenarios.MAKERS, "small", small.make)
        out = tmp_path_factory.mktemp("compare") / "deep" / "out"
        options = ("--runs", 7, "--seed", 3, "--set", "clutter_rate=1,3", "--out", out)
        return jaxtrack("compare", "small", *options), out


def test_compare_writes_its_files_and_leaves_no_parts(compared):
    result, out = compared
    assert result.exit_code == 0, result.output
    found = sorted(path.name for path in out.iterdir())
    assert found == sorted([*FILES, "tracks-near.png", "tracks-far.png"])
    for path in out.glob("*.png"):
        picture = matplotlib.image.imread(path)
        assert min(picture.shape[:2]) > 400
        assert picture[..., :3].std() > 0.01
        assert path.name in result.stdout


def test_summary_is_that_of_the_library(compared):
    summary = json.loads((compared[1] / "summary.json").read_text())
    known = {"scenario": "small", "runs": 7, "seed": 3, "version": "0.1.0"}
    assert known.items() <= summary.items()
    settings = {"clutter_rate": [1, 3]}
    data = engine.monte_carlo(small.make, ["near", "far"], 7, 3, settings)
    expected = table.summary(data)["rows"]
    assert len(summary["rows"]) == 4
    for row, other in zip(summary["rows"], expected, strict=True):
        assert set(row) == KEYS
        for key in KEYS - {"seconds", "compile_seconds", "runs_per_second"}:
            assert row[key] == other[key]
        assert row["setting"].keys() == {"clutter_rate"}
        assert row["seconds"] > 0


def test_result_holds_every_score_of_every_run(compared):
    with xarray.open_dataset(compared[1] / "result.nc", engine="h5netcdf") as data:
        assert data.ospa.dims == ("setting", "tracker", "run", "time")
        assert data.ospa.shape == (2, 2, 7, 6)
        assert set(Scores._fields) <= set(data.data_vars)
        summary = json.loads((compared[1] / "summary.json").read_text())
        mean = float(data.ospa.sel(setting="clutter_rate=3", tracker="far").mean())
        assert summary["rows"][3]["ospa"]["mean"] == pytest.approx(mean)


def test_table_has_a_line_for_each_row_and_the_published_number(compared):
    lines = compared[0].stdout.splitlines()
    rows = [line.split() for line in lines if line.split()[:1] in (["near"], ["far"])]
    assert [row[:2] for row in rows] == [
        ["near", "1"],
        ["far", "1"],
        ["near", "3"],
        ["far", "3"],
    ]
    summary = json.loads((compared[1] / "summary.json").read_text())
    for cells, row in zip(rows, summary["rows"], strict=True):
        shown = f"{row['ospa']['mean']:.2f} ± {row['ospa']['stderr']:.2f}"
        assert " ".join(cells[2:5]) == shown
    assert [cells[5] == "12.5" for cells in rows] == [True, False, False, False]


def test_same_command_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    options = (
        "compare",
        "small",
        "--trackers",
        "near",
        "--runs",
        12,
        "--out",
        tmp_path,
    )

    def stopped(*arguments, **keywords):
        keywords["progress"] = interrupt
        return original(*arguments, **keywords)

    def interrupt(done, total):
        if done == 10:
            raise KeyboardInterrupt

    original = engine.monte_carlo
    monkeypatch.setattr(engine, "monte_carlo", stopped)
    assert jaxtrack(*options).exit_code == 130
    kept = list((tmp_path / "parts").iterdir())
    assert len(kept) == 1
    other = jaxtrack(*options, "--seed", 1)
    assert other.exit_code == 2
    assert "holds parts of another study (seed is 0, not 1)" in other.stderr
    assert other.stderr.count("\n") == 1

    monkeypatch.setattr(engine, "monte_carlo", original)
    again = jaxtrack(*options)
    assert again.exit_code == 0
    assert not (tmp_path / "parts").exists()


def test_too_small_capacities_get_a_warning_that_says_what_to_raise(tmp_path):
    options = ("--runs", 2, "--set", "lost=0.5", "--trackers", "near", "--out")
    result = jaxtrack("compare", "small", *options, tmp_path)
    assert result.exit_code == 0
    expected = "Warning: near dropped 0.5 expected targets a scan, or parts of "
    assert expected in result.stderr
    assert "for want of room; raise max_tracks with --set." in result.stderr


def test_negligible_losses_get_no_warning(compared):
    assert "Warning" not in compared[0].stderr


BAD = {
    "unknown scenario": (["nowhere"], "no scenario is called 'nowhere'; there are"),
    "unknown tracker": (
        ["small", "--trackers", "nera"],
        "no tracker 'nera'; it has far",
    ),
    "no tracker": (["small", "--trackers", ","], "no tracker is named; small has far"),
    "unknown setting": (["small", "--set", "speed=3"], "no setting 'speed'; it has"),
    "letters": (
        ["small", "--set", "clutter_rate=1,x"],
        "clutter_rate has the value 'x'",
    ),
    "empty value": (
        ["small", "--set", "clutter_rate=1,,2"],
        "has the value ''; give num",
    ),
    "no equals": (["small", "--set", "clutter_rate"], "is not NAME=VALUE,VALUE,..."),
    "set twice": (
        ["small", "--set", "clutter_rate=1", "--set", "clutter_rate=2"],
        "names clutter_rate twice",
    ),
    "negative": (
        ["small", "--set", "clutter_rate=-5"],
        "clutter_rate is -5; give 0 or",
    ),
    "infinite": (["small", "--set", "clutter_rate=inf"], "inf; give a finite number"),
    "no runs": (["small", "--runs", "0"], "runs is 0; give at least 1"),
    "runs in letters": (
        ["small", "--runs", "many"],
        "'--runs': 'many' is no whole number; give digits",
    ),
    "seed below zero": (["small", "--seed", "-1"], "seed is -1; give a whole number"),
    "precision": (["small", "--precision", "16"], "precision is 16; give 32 or 64"),
    "out below a file": (["small", "--out", __file__ + "/x"], "give another --out"),
    "nothing": ([], "Missing argument '"),
    "unknown option": (["small", "--rnus", "3"], "No such option: --rnus"),
}


@pytest.mark.parametrize(("words", "message"), BAD.values(), ids=list(BAD))
def test_bad_input_gets_one_sentence_and_code_2(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = jaxtrack("compare", *words)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.startswith("Error: ")
    assert result.stderr.count("\n") == 1
    assert not result.stdout
    assert not list(tmp_path.iterdir())


def test_unknown_command_gets_one_sentence_and_code_2():
    result = jaxtrack("campare")
    assert result.exit_code == 2
    assert "No such command 'campare'" in result.stderr
    assert result.stderr.count("\n") == 1


def test_scenarios_are_listed_with_trackers_and_settings():
    result = jaxtrack("scenarios")
    assert result.exit_code == 0
    shown = " ".join(result.stdout.split())
    for name in scenarios.MAKERS:
        scenario = scenarios.make(name)
        assert f"{name} {scenario.summary}" in shown
        assert f"trackers: {', '.join(scenario.trackers)} settings:" in shown
    assert "clutter_rate=1, detect_prob=0.9, max_tracks=4, lost=0" in shown


def test_version_and_help():
    assert jaxtrack("--version").stdout == "jaxtrack 0.1.0\n"
    assert "compare" in jaxtrack().stdout
    assert jaxtrack("--help").exit_code == 0


def test_settings_and_numbers_out_of_reach_are_shown_as_text():
    row = {"tracker": "near", "setting": {}, "cardinality_bias": None}
    row |= {"ospa": {"mean": None, "stderr": None}, "expected_cardinality_bias": 0.0}
    row |= {"gospa": {"mean": 1.0, "stderr": None}, "dropped": 0.0, "seconds": 1.0}
    row |= {"runs_per_second": 3.0, "compile_seconds": 0.0}
    summary = {"scenario": "small", "runs": 1, "seed": 0, "rows": [row]}
    cells = [list(x.cells)[0] for x in compare.as_table("small", summary).columns]
    assert cells[1:4] == ["not finite", "12.5", "1.00"]


def in_a_process(code, **environment):
    """Runs Python as a user would: jax is not there yet."""
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX", "XLA"))}
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**kept, "PYTHONPATH": paths, **environment},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def test_help_is_quick_because_jax_stays_away():
    code = "import sys; import jaxtrack.cli; print('jax' in sys.modules)"
    assert in_a_process(code) == "False\n"


START = """
from jaxtrack.cli import common
common.start_jax({precision})
import jax, os
cores = len(os.sched_getaffinity(0))
print(jax.local_device_count() == cores, jax.numpy.zeros(1).dtype)
print(jax.config.values["jax_compilation_cache_dir"])
"""


def test_jax_is_started_with_all_cores_double_precision_and_a_cache(tmp_path):
    told = in_a_process(START.format(precision=64), XDG_CACHE_HOME=str(tmp_path))
    assert told.split() == ["True", "float64", str(tmp_path / "jaxtrack" / "jax")]
    assert list((tmp_path / "jaxtrack" / "jax").iterdir())


def test_the_user_s_own_choices_for_jax_are_kept(tmp_path):
    mine = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "mine")}
    mine["XLA_FLAGS"] = "--xla_force_host_platform_device_count=1"
    told = in_a_process(START.format(precision=32), **mine).split()
    assert told == [
        str(len(os.sched_getaffinity(0)) == 1),
        "float32",
        f"{tmp_path}/mine",
    ]


@pytest.mark.parametrize(
    ("name", "told"), [("cbmember", True), ("cbmember-claims", False), ("phd", False)]
)
def test_a_balance_by_claims_is_not_told_to_use_claims(capsys, name, told):
    world = scenarios.make("yuan2013-linear", detect_prob=0.7).world
    job = types.SimpleNamespace(name=f"gm-mm-{name}", values=(None, world))
    compare.warn_limits(types.SimpleNamespace(jobs=[job]))
    assert ("P_D" in capsys.readouterr().err) == told
