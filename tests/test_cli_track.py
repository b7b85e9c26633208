import json
import types

import numpy as np
import pytest
from typer.testing import CliRunner

from jaxtrack.cli import app, track
from jaxtrack.recorded import settings

pd = pytest.importorskip("pandas")

SMALL = """
[tracker]
max_tracks = 12
max_births = 4
max_parents = 2
"""


def write(path, num_scans=15, noise=2.0):
    """Two ships that report every 8 s."""
    rng = np.random.default_rng(0)
    rows = []
    for t in 8.0 * np.arange(num_scans):
        for name, x, y, vx, vy in (("Ada", 0, 0, 6, 1), ("Bob", 900, 50, -3, 4)):
            dx, dy = noise * rng.standard_normal(2)
            rows.append((t, x + vx * t + dx, y + vy * t + dy, name))
    frame = pd.DataFrame(rows, columns=["time", "x", "y", "ship"])
    frame.to_csv(path, index=False)
    return path


@pytest.fixture
def call(tmp_path):
    """Calls `jaxtrack track` in an empty folder, with settings for a few slots."""

    def run(*args, config=SMALL):
        settings = tmp_path / "settings.toml"
        settings.write_text(config)
        out = ["--out", str(tmp_path / "out")]
        words = ["track", *map(str, args), "--config", str(settings), *out]
        return CliRunner().invoke(app, words)

    return run


@pytest.fixture
def refused(call):
    """Says why a call was refused: in one sentence, with exit code 2."""

    def run(*args, **kwargs):
        result = call(*args, **kwargs)
        assert result.exit_code == 2, result.output
        lines = result.stderr.strip().splitlines()
        assert len(lines) == 1
        assert lines[0].startswith("Error: ")
        return lines[0]

    return run


@pytest.mark.parametrize(
    ("name", "rate", "detect_prob", "word"),
    [
        ("cbmember", 1.0, 0.95, ""),
        ("cbmember", 40.0, 0.95, "0.81 false detections are expected in a gate"),
        ("cbmember", 1.0, 0.7, "takes P_D for near one, and it is 0.7"),
        ("jipda", 40.0, 0.7, ""),
    ],
)
def test_what_a_cbmember_filter_does_not_bear_is_told(
    capsys, name, rate, detect_prob, word
):
    """At 10 m a gate of 5,655 m^2, in a box of 400 x 700 m."""
    some = settings.with_algorithm(settings.Settings(), name)
    some = some._replace(
        sensor=settings.Sensor(noise_std=10.0, clutter_rate=rate),
        modes={"any": settings.Mode(detect_prob=detect_prob)},
    )
    table = types.SimpleNamespace(xy=np.array([[0.0, 0.0], [200.0, 500.0]]))
    track.warn_limits(table, some)
    told = capsys.readouterr().err
    assert word in told
    assert ("jipda" in told) == bool(word)


def test_track_writes_tracks_a_picture_and_scores(call, tmp_path):
    result = call(write(tmp_path / "a.csv"), "--truth-column", "ship")
    assert result.exit_code == 0, result.output
    assert "IDF1" in result.stdout
    assert not result.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["tracks"] == 2
    assert summary["scores"]["num_switches"] == 0
    assert summary["scores"]["idf1"] > 0.85
    assert len(summary["scores"]["gospa_over_time"]["time"]) == summary["scans"] == 15
    assert {"seconds", "compile_seconds", "dropped", "settings"} <= set(summary)
    tracks = pd.read_csv(tmp_path / "out" / "tracks.csv")
    assert list(tracks)[:4] == ["time", "label", "x", "y"]
    assert len(set(tracks["label"])) == 2
    assert len(tracks) == summary["reported"] >= 2 * 13
    assert (tmp_path / "out" / "tracks.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_tracker_of_trajectories_tells_afterwards_where_targets_were(call, tmp_path):
    result = call(
        write(tmp_path / "a.csv"), "--truth-column", "ship", "--tracker", "tpmbm"
    )
    assert result.exit_code == 0, result.output
    assert "Smoothed: IDF1" in result.stdout
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    online, later = summary["scores"], summary["smoothed_scores"]
    assert later["num_missed"] < online["num_missed"]  # the first scans are known now
    assert later["num_switches"] == 0
    tracks = pd.read_csv(tmp_path / "out" / "tracks.csv")
    smoothed = pd.read_csv(tmp_path / "out" / "smoothed.csv")
    assert list(smoothed) == list(tracks)
    assert set(smoothed["label"]) == set(tracks["label"])
    assert len(smoothed) > len(tracks)


def test_without_a_truth_column_nothing_is_scored(call, tmp_path):
    result = call(write(tmp_path / "a.csv"))
    assert result.exit_code == 0, result.output
    assert "scores" not in json.loads((tmp_path / "out" / "summary.json").read_text())


def test_more_detections_than_the_capacity_are_named(call, tmp_path):
    path = write(tmp_path / "a.csv")
    config = SMALL + "[scans]\nmax_detections = 1\n"
    result = call(path, config=config)
    assert result.exit_code == 0, result.output
    assert "Warning: 15 of 30 detections were dropped" in result.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["dropped_detections"] == 15


def test_reports_one_by_one_ask_for_a_period(call, tmp_path):
    path = tmp_path / "a.csv"
    frame = pd.read_csv(write(path))
    frame["time"] += np.arange(len(frame)) % 2
    frame.to_csv(path, index=False)
    result = call(path)
    assert result.exit_code == 0, result.output
    assert "set a period in [scans]" in result.stderr


def test_a_missing_file_or_column_is_refused(refused, tmp_path):
    path = write(tmp_path / "a.csv")
    assert "does not exist" in refused(tmp_path / "b.csv")
    assert "no further column 'boat'" in refused(path, "--truth-column", "boat")
    path.write_text("time,x\n0,1\n")
    assert "no column 'y'" in refused(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no detections"),
        ("time,x,y\n", "has no detections"),
        ("time,x,y\n0,1,2\n", "only one detection"),
        ("time,x,y\n0,1,2\n1,two,3\n", "row 3: 'two' is not a finite number"),
        ("time,x,y\n0,1,2\n5,1,3\n4,1,3\n", "row 4: '4' is earlier"),
        ("time,x,y\n0,1,2\n0,5,3\n", "All detections are in one scan"),
    ],
)
def test_bad_files_get_one_sentence(refused, tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert message in refused(path)


def test_bad_settings_get_one_sentence(refused, tmp_path):
    path = write(tmp_path / "a.csv")
    assert "noise_std in [sensor]" in refused(path, config="[sensor]\nnoise_std = '5'")
    assert "is not TOML" in refused(path, config="[sensor]\nnoise_std = 5 m")
    assert "no section 'sensors'" in refused(path, config="[sensors]\nnoise_std = 5")
    assert "precision is 16" in refused(path, "--precision", "16")


def test_a_file_and_the_harbour_exclude_each_other(refused, tmp_path):
    assert "either a FILE, or --harbour" in refused()
    assert "either a FILE" in refused(write(tmp_path / "a.csv"), "--harbour")


def test_config_prints_a_template_that_track_takes(call, tmp_path):
    template = CliRunner().invoke(app, ["config"])
    assert template.exit_code == 0
    assert "[modes.steady]" in template.stdout
    assert "[modes.moored]" in CliRunner().invoke(app, ["config", "--harbour"]).stdout
    few = template.stdout.replace("# max_tracks = 400", "max_tracks = 12")
    few = few.replace("# max_births = 100", "max_births = 4")
    few = few.replace("max_parents = 6", "max_parents = 2")
    result = call(write(tmp_path / "a.csv"), config=few)
    assert result.exit_code == 0, result.output
