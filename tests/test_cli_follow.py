"""The command `follow`: known targets, their tracks' errors, and two pictures."""

import json

import pytest
from typer.testing import CliRunner

from jaxtrack.cli import app


def follow(*words):
    return CliRunner().invoke(app, ["follow", *words])


@pytest.mark.slow
def test_a_small_study_writes_what_it_says(tmp_path):
    words = "--trackers", "imm-jpda", "--runs", "3", "--out", str(tmp_path)
    result = follow("gomes-crossing", *words, "--set", "angle=60")
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "follow.json").read_text())["imm-jpda"]
    assert 5 < summary["position_rms"] < 50
    assert summary["active_modes"] == 5
    assert summary["swapped"] == 0
    assert "imm-jpda" in result.output
    for name in ("errors.png", "association.png"):
        assert (tmp_path / name).stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("yuan2013-linear",), "is not told its targets"),
        (("parallel-pair",), "has false detections"),
        (("gomes-crossing", "--trackers", "gnn"), "has no tracker 'gnn'"),
        (("gomes-crossing", "--runs", "0"), "runs is 0"),
        (("nowhere",), "no scenario is called 'nowhere'"),
    ],
)
def test_what_cannot_be_followed_gets_one_sentence(words, message, tmp_path):
    result = follow(*words, "--out", str(tmp_path))
    assert result.exit_code == 2
    assert message in result.output
    assert "Traceback" not in result.output
