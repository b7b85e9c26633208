"""The benchmarks run, on tiny sizes, and say what they should; nothing is timed."""

import doctest
import functools
import importlib
import json

import jax
import numpy as np
import pytest
from scipy import stats

from benchmarks import climit, common, evidence, learning, problems, table

FAST = ("gaussians",)
SLOW = (
    *("kalman", "extended", "imm", "gradient", "assign", "multiscan"),
    *("jpda", "phd", "particles", "cores", "start", "study", "growth", "crowds"),
    "trajectories",
    "lmb",
    "pmbm",
)
KEYS = {
    *("work", "precision", "rate", "unit", "peer", "ratio_to_peer", "limit"),
    *("ratio_to_limit", "spread", "compile_seconds", "error"),
}


def name_and_mark(name):
    return pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else [])


@pytest.mark.filterwarnings("ignore")  # of the peers
@pytest.mark.parametrize("name", [name_and_mark(x) for x in FAST + SLOW])
def test_benchmark_fills_its_rows(name, monkeypatch):
    monkeypatch.setattr(common, "ENOUGH", 0.0)
    monkeypatch.setattr(common, "pin", lambda cores=1: None)
    module = importlib.import_module(f"benchmarks.{name}")
    with jax.numpy_rank_promotion("allow"):
        rows = [json.loads(json.dumps(x._asdict())) for x in module.rows(common.QUICK)]

    assert rows
    for row in rows:
        assert set(row) == KEYS
        assert row["rate"] > 0
        assert (row["peer"] is None) == (row["ratio_to_peer"] is None)
        assert (row["limit"] is None) == (row["ratio_to_limit"] is None)
        assert table.line([row]).count("|") == 6


@pytest.mark.parametrize("name", ["common", "climit", "peers", "problems", "table"])
def test_example_holds(name):
    module = importlib.import_module(f"benchmarks.{name}")
    assert doctest.testmod(module).failed == 0


def test_wrong_result_is_not_timed():
    with pytest.raises(ValueError, match="a peer is off by 5.0e-01"):
        common.check("a peer", np.array([1.0, 3.0]), np.array([1.0, 2.0]), 1e-3)
    with pytest.raises(ValueError, match="a peer is off by nan"):
        common.check("a peer", np.array([1.0, np.nan]), np.array([1.0, 2.0]), 1e-3)


def test_ratios_are_those_of_the_time(monkeypatch):
    clock = iter(range(10**6))
    monkeypatch.setattr(common.time, "process_time", lambda: next(clock))
    fast, slow = (common.Job(name, lambda: None, n) for name, n in (("f", 8), ("s", 2)))
    row = common.compare("work", "float32", fast, [slow], limit=fast, rounds=3)[0]
    assert row.rate == 8.0
    assert row.ratio_to_peer == 4.0
    assert row.ratio_to_limit == 1.0
    assert row.spread == 0.0


def test_without_a_compiler_there_is_no_limit(monkeypatch):
    monkeypatch.setattr(climit.shutil, "which", lambda name: None)
    monkeypatch.setattr(climit, "library", functools.cache(climit.library.__wrapped__))
    assert climit.call("kalman", "float32") is None


def test_no_two_runs_share_a_prior_covariance():
    for problem in problems.linear(8, 2), problems.turning(8, 2):
        assert len(np.unique(problem.cov[:, 0, 0])) == 8


def test_table_is_pasted_between_its_marks(tmp_path, monkeypatch):
    row = common.Row("a filter", "float32", 1234567.0, "steps/s", "a peer", 12.345)
    other = row._replace(peer="another", ratio_to_peer=0.5)
    results = {
        "made_with": {"cpu": "a processor", "versions": {"jax": "1.0"}},
        "rows": [{"benchmark": "kalman", **x._asdict()} for x in (row, other)],
    }
    latest, readme = tmp_path / "latest.json", tmp_path / "README.md"
    latest.write_text(json.dumps(results))
    readme.write_text(f"before\n{table.BEGIN}old\n{table.END}after\n")
    monkeypatch.setattr(table, "LATEST", latest)
    monkeypatch.setattr(table, "README", readme)
    table.paste()
    text = readme.read_text()
    assert text.startswith(f"before\n{table.BEGIN}")
    assert text.endswith(f"{table.END}after\n")
    assert "| 1.23 M steps/s | 12.3 x a peer, 0.500 x another |  |" in text
    assert "old" not in text


def test_benchmarks_named_are_run_anew(monkeypatch, tmp_path, capsys):
    everything = importlib.import_module("benchmarks.__main__")
    monkeypatch.setattr(table, "LATEST", tmp_path / "latest.json")
    monkeypatch.setattr(table, "paste", lambda: None)
    monkeypatch.setattr(everything, "run", lambda name, quick: [{"benchmark": name}])
    old = [{"benchmark": name, "old": True} for name in ("kalman", "imm", "growth")]
    made = {"made_with": everything.made_with(), "rows": old}
    table.LATEST.write_text(json.dumps(made))

    monkeypatch.setattr("sys.argv", ["benchmarks", "imm"])
    everything.main()
    rows = json.loads(table.LATEST.read_text())["rows"]
    assert rows == [old[0], {"benchmark": "imm"}, old[2]]

    table.LATEST.write_text(json.dumps({**made, "made_with": {"cpu": "another"}}))
    with pytest.raises(SystemExit):
        everything.main()
    assert "run all benchmarks" in capsys.readouterr().err

    monkeypatch.setattr("sys.argv", ["benchmarks", "nothing"])
    with pytest.raises(SystemExit):
        everything.main()


# What the page calls it, and which row of the results it is.
PAGE = {
    "Kalman filter, dense": ("Kalman filter, dense, log-likelihood", "float32"),
    "known zeros": ("Kalman filter, models, log-likelihood", "float32"),
    "float64, dense": ("Kalman filter, dense, log-likelihood", "float64"),
    "float64, known zeros": ("Kalman filter, models, log-likelihood", "float64"),
    "all filtered beliefs kept": ("Kalman filter, dense, all beliefs", "float32"),
    "extended, models": ("extended Kalman filter, models", "float32"),
    "extended, a user's functions": (
        "extended Kalman filter, a user's functions",
        "float32",
    ),
    "IMM, five modes": ("IMM, five modes, dense", "float32"),
    "IMM, five modes, as a target": ("IMM, five modes, as a target", "float32"),
    "mixture update, 400 x 30": (
        "mixture update, 400 components, 30 detections",
        "float32",
    ),
    "two cores, 8,192 runs": (
        "Kalman filter, models, 8,192 runs, two cores",
        "float32",
    ),
    "two cores, the runs shared before": (
        "Kalman filter, models, 8,192 runs, two cores, shared before",
        "float32",
    ),
}


def test_the_page_on_performance_tells_the_results_that_are_kept():
    rows = json.loads(table.LATEST.read_text())["rows"]
    page = (table.HERE.parent / "docs" / "performance.md").read_text()
    told = {}
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| ") and len(cells) == 4:
            told[cells[0]] = cells[2]
    for name, (work, precision) in PAGE.items():
        row = next(x for x in rows if (x["work"], x["precision"]) == (work, precision))
        assert table.number(row["ratio_to_peer"] or row["ratio_to_limit"]) in told[name]
        if row["ratio_to_limit"] is not None:
            assert table.number(row["ratio_to_limit"]) in told[name]


def test_the_list_of_what_known_targets_did_is_whole():
    """Of one scan: both missed, one of them seen, or each of them."""
    places, valid = np.array([[1.0, -3.0]]), np.array([[True, True]])
    false = evidence.CLUTTER / (2 * evidence.HALF)
    sequences = np.array([[-1], [0], [1]])
    one, other = (
        np.exp([evidence.alone(place, places, x) for x in sequences])
        for place in evidence.PLACES
    )
    ways = one[:, None] * other[None]
    ways[1, 1] = ways[2, 2] = 0.0
    expected = np.log(ways.sum() * false**2) - evidence.CLUTTER
    assert evidence.listed(places, valid) == pytest.approx(expected, rel=1e-12)
    # The one expected at 2 m has come nearer to 0, and is seen at 1 m.
    x = 1 / evidence.TIME
    mean = np.exp(-x) * (1 + x) * 2.0
    step = np.exp(-x) * np.array([1 + x, 1.0])
    rest = np.array([evidence.STD, evidence.STD / evidence.TIME]) ** 2
    var = rest[0] - (step**2 * rest).sum() + (step**2).sum() * evidence.STD_KNOWN**2
    density = stats.norm(mean, np.hypot(np.sqrt(var), evidence.SENSOR)).pdf(1.0)
    assert other[1] == pytest.approx(evidence.DETECT * density / false, rel=1e-12)


def test_the_table_of_fits_counts_what_lies_within_two_errors():
    row = {"case": "PHD", "seconds": 2.0, "stopped": "converged"}
    found = (1.1, 0.1), (1.3, 0.1), (0.9, None), (1.0, 0.2)
    fits = [row | {"rows": {"noise": [1.0, *pair]}} for pair in found]
    about = {"PHD": learning.About(400, {"noise": "positive"})}
    *_, last = learning.table(fits, about).strip().splitlines()
    told = "0.1 | 50% of 4 | 50%"  # without an error nothing is within it
    assert last == f"| PHD | noise | 1 | 1.075 ± 0.085 | {told} | 400 | 2 |"
    both = [row | {"rows": {"noise": [1.0, 1.1, 0.1], "place": [0, 1, 1]}}]
    about["PHD"].kinds["place"] = "real"
    *_, last = learning.table(both, about).strip().splitlines()
    assert last == "|  | place | 0 | 1 ± inf | 1 | 100% of 1 | 100% |  |  |"
    far = [
        row | {"rows": {"noise": [1.0, *pair]}} for pair in [(0.78, 0.1), (1.3, 0.14)]
    ]
    *_, last = learning.table(far, about).strip().splitlines()
    # exp(0.256) times 0.78 is more than 1, and 1.3 times exp(-0.215) is, too.
    assert last.split(" | ")[5:7] == ["0% of 2", "50%"]
