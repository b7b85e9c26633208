"""The benchmark of fits in the harbour, of two ships and without a fit's minutes."""

import numpy as np
import pytest

from benchmarks import harbour_fit, harbour_tables
from jaxtrack import learn
from jaxtrack.data import files
from jaxtrack.learn import history
from jaxtrack.recorded import fitted, reading

TEXT = """[scans]
period = 8
max_detections = 3
[tracker]
name = "nearest"
max_tracks = 3
max_births = 3
[modes.rest]
rest = true
detect_prob = 0.6
[modes.moving]
detect_prob = 0.9
"""


@pytest.fixture(scope="module")
def case():
    time = np.repeat(np.arange(0.0, 160.0, 8.0), 2)
    ship = np.tile([0, 1], len(time) // 2)
    xy = np.stack([5 * time * ship, 400.0 * ship], 1)
    xy = xy + np.random.default_rng(0).standard_normal(xy.shape)
    names = np.array(["Ada", "Bob"], object)[ship]
    table = files.Table(time, xy, {"MMSI": names}, None, None)
    return harbour_fit.make(table, reading.parse(TEXT), "nearest")


def found(case):
    """What `fit` tells, with what it began at for what it found."""
    numbers = harbour_tables.lists(fitted.numbers(case.settings)._asdict())
    ways = {name: [value, value] for name, value in numbers.items()}
    more = {"evidence": [-2.0, -1.0], "history": ways}
    return {"first half, begun by hand": {"numbers": numbers, "seconds": 1.0} | more}


def test_halves_have_each_detection_once(case):
    one, two = case.halves.values()
    assert len(one.table.time) == len(two.table.time) == 20
    assert one.table.time[-1] < two.table.time[0]
    assert one.scan.detections.shape == two.scan.detections.shape == (10, 3, 3)


def test_settings_are_off_to_the_worse_side(case):
    hand, off = (
        fitted.numbers(x) for x in (case.settings, harbour_fit.off(case.settings))
    )
    np.testing.assert_allclose(off.noise_std, 3 * hand.noise_std)
    np.testing.assert_allclose(off.noise_density, 3 * hand.noise_density)
    np.testing.assert_allclose(off.birth_rate, 3 * hand.birth_rate)
    np.testing.assert_allclose(off.lifetime, hand.lifetime / 3)
    np.testing.assert_allclose(off.detect_prob, [0.5 / 1.5, 0.75])


def test_settings_are_mixed_number_by_number(case):
    given = found(case)["first half, begun by hand"]
    given["numbers"] |= {"noise_std": 0.25, "lifetime": 7.0}
    noise, life = harbour_fit.mixed(harbour_fit.rows({"one": given}, case)).values()
    assert (noise.sensor.noise_std, life.sensor.noise_std) == (0.25, 0.25)
    assert noise.targets.lifetime == case.settings.targets.lifetime
    assert life.targets.lifetime == case.settings.targets.lifetime
    assert noise.modes == case.settings.modes


def test_tables_tell_evidence_scores_and_numbers(case, tmp_path):
    made = harbour_fit.rows(found(case), case)
    assert list(made) == ["by hand", "off by 3", "fitted on first half, begun by hand"]
    one = harbour_fit.told(case, case.settings, "second")
    again = harbour_fit.told(
        case, made["fitted on first half, begun by hand"], "second"
    )
    assert again == pytest.approx(one)
    tracked = harbour_fit.tracked(case, case.settings, "second")
    assert one["evidence"] == pytest.approx(tracked.log_evidence[2:].mean())
    assert one["missed"] > 0  # before the tracks are confirmed
    assert one["near"] < 3
    told = {"by hand": {"second half": one}, "off": {"second half": one, "all": one}}
    lines = harbour_tables.scores_table(told).splitlines()
    assert [line.split(" | ")[:2] for line in lines[2:]] == [
        ["| second half", "by hand"],
        ["| second half", "off"],
        ["| all", "off"],
    ]
    table = harbour_tables.numbers_table(case, found(case))
    assert "| `detect_prob` rest | 0.6 | 0.6 |" in table
    harbour_tables.picture(case, found(case), tmp_path / "ways.png")
    assert (tmp_path / "ways.png").stat().st_size > 0


def test_a_fit_is_told_as_json_can_hold_it(case, monkeypatch):
    given = {}

    def stub(tracker, params, scans, optimizer, **more):
        assert tracker is case.tracker
        given.update(more, params=params, scans=scans)
        values = {name: x[None] for name, x in params._asdict().items()}
        ways = history.History(np.array([3.0]), values, values)
        return learn.Fit(params, ways, None, 1, "out of steps", "")

    monkeypatch.setattr(learn, "fit", stub)
    told = harbour_fit.fit(case, "off", "second")
    assert given["scans"] is case.halves["second"].scan
    begin = fitted.numbers(harbour_fit.off(case.settings))
    np.testing.assert_array_equal(told["numbers"]["noise_density"], begin.noise_density)
    assert told["evidence"] == [-3.0]


def test_what_is_kept_is_not_done_again(tmp_path):
    path = tmp_path / "part.json"
    assert harbour_fit.kept(path, lambda: {"a": 1.5}) == {"a": 1.5}
    assert harbour_fit.kept(path, lambda: {"a": 2.5}) == {"a": 1.5}


@pytest.mark.slow
def test_a_fit_raises_the_evidence(case):
    told = harbour_fit.fit(case, "off", "first", steps=10)
    assert told["evidence"][-1] > told["evidence"][0] + 1
