import json

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.data import files
from jaxtrack.data.errors import DataError
from jaxtrack.metrics import gospa
from jaxtrack.models.rest import Rest
from jaxtrack.recorded import (
    guess,
    picture,
    reading,
    scoring,
    settings,
    tracking,
)
from jaxtrack.targets import imm
from jaxtrack.trackers import management

NAMES = np.array(["Ada", "Bob"])
SPEED = np.array([[6.0, 1.0], [-3.0, 4.0]])
START = np.array([[0.0, 0.0], [900.0, 50.0]])
SMALL = "[tracker]\nmax_tracks = 12\nmax_births = 4\nmax_parents = 2\n"


def table(times, noise=2.0, seed=0):
    """Two ships far apart, of which both report at each of the times."""
    rng = np.random.default_rng(seed)
    when = np.repeat(np.asarray(times, float), 2)
    who = np.tile([0, 1], len(times))
    xy = START[who] + SPEED[who] * when[:, None]
    xy = xy + noise * rng.standard_normal(xy.shape)
    return files.Table(when, xy, {"ship": NAMES[who].astype(object)}, None, None)


@pytest.fixture(scope="module")
def recording():
    data = table(np.arange(0.0, 120.0, 8.0))
    return data, tracking.track(data, reading.parse(SMALL))


def test_two_ships_become_two_tracks(recording):
    data, result = recording
    scores = scoring.score(result, data, "ship")
    assert scores.identity.num_switches == 0
    assert scores.identity.idf1 > 0.85
    assert (scores.gospa.num_missed[3:] == 0).all()
    assert (scores.gospa.num_false == 0).all()


def test_tracks_are_where_the_ships_are_and_as_fast(recording):
    _, result = recording
    mean = result.estimates.mean[-1][result.estimates.exists[-1]]
    place = START + SPEED * result.scans.time[-1]
    mine, theirs = np.argsort(mean[:, 0]), np.argsort(place[:, 0])
    np.testing.assert_allclose(mean[mine][:, [1, 3]], SPEED[theirs], atol=0.5)
    np.testing.assert_allclose(mean[mine][:, [0, 2]], place[theirs], atol=6.0)


def test_scores_are_those_of_the_metric_scan_by_scan(recording):
    data, result = recording
    scores = scoring.score(result, data, "ship")
    t, cutoff = 6, result.settings.score.cutoff
    truth = jnp.asarray(START + SPEED * result.scans.time[t])
    seen = jnp.asarray(data.xy[2 * t : 2 * t + 2])  # the truth is what was reported
    assert np.abs(seen - truth).max() < 8
    exists = result.estimates.exists[t]
    mean = jnp.asarray(result.estimates.mean[t][exists][:, [0, 2]])
    expected = gospa.gospa(seen, jnp.ones(2, bool), mean, exists[exists], cutoff)
    chex.assert_trees_all_close(
        jax.tree.map(lambda x: x[t], scores.gospa), expected, rtol=1e-9
    )
    summary = scoring.summary(scores, result.settings.score)
    assert summary["gospa"]["mean"] == pytest.approx(scores.gospa.distance.mean())
    assert summary["gospa"]["num_missed"] == scores.gospa.num_missed.mean()
    json.dumps(summary, allow_nan=False)


def test_identities_never_reach_the_tracker(recording):
    data, result = recording
    renamed = data._replace(other={"ship": data.other["ship"][::-1]})
    again = tracking.track(renamed, reading.parse(SMALL))
    chex.assert_trees_all_equal(again.estimates, result.estimates)


def test_ages_place_a_ship_at_the_end_of_its_scan():
    # All but the first reports are 8 s old when their scan of 20 s ends.
    data = table([0.0, *np.arange(32.0, 300.0, 20.0)])
    text = "[scans]\nperiod = 20\n[modes.only]\nnoise_density = 0.5\n"
    result = tracking.track(data, reading.parse(SMALL + text))
    assert result.scans.scan.detections.shape[-1] == 3
    assert result.scans.time[-1] == data.time[-1] + 8
    mean = result.estimates.mean[-1][result.estimates.exists[-1]][:, [0, 2]]
    place = START + SPEED * result.scans.time[-1]
    mine, theirs = np.argsort(mean[:, 0]), np.argsort(place[:, 0])
    np.testing.assert_allclose(mean[mine], place[theirs], atol=10.0)


def test_scans_after_the_last_detection_are_not_scored():
    data = table(np.arange(0.0, 100.0, 8.0))
    made = reading.parse(SMALL + "[scans]\nperiod = 9\n")
    result = tracking.track(data, made)
    scores = scoring.score(result, data, "ship")
    assert result.scans.time[-1] > data.time[-1]
    assert scores.time[-1] <= data.time[-1]
    assert len(scores.time) == len(result.scans.time) - 1


@pytest.mark.parametrize("noise", [0.5, 5.0])
def test_noise_and_speed_are_guessed_from_the_data(noise):
    data = table(np.arange(0.0, 3200.0, 8.0), noise)
    seen = guess.motion(tracking.group(data, settings.Settings()))
    assert seen is not None
    assert seen.noise_std == pytest.approx(noise, rel=0.1)
    assert seen.speed == pytest.approx(np.hypot(6, 1), rel=0.1)


def test_ages_change_no_guess():
    data = table(np.arange(0.0, 3200.0, 8.0))
    made = reading.parse("[scans]\nperiod = 8\n")
    plain = guess.motion(tracking.group(data, settings.Settings()))
    timed = guess.motion(tracking.group(data, made))
    np.testing.assert_allclose(timed, plain, rtol=0.05)


def test_guesses_leave_alone_what_is_set():
    data = table(np.arange(0.0, 100.0, 8.0))
    text = "[sensor]\nnoise_std = 7\n[targets]\nbirth_rate = 0\n[score]\ncutoff = 3\n"
    made = reading.parse(text)
    full = guess.complete(made, tracking.group(data, made))
    assert (full.sensor.noise_std, full.targets.birth_rate) == (7.0, 0.0)
    assert (full.score.cutoff, full.targets.lifetime) == (3.0, 80.0)
    steady, turning = full.modes["steady"], full.modes["turning"]
    assert steady.noise_density < turning.noise_density


def test_the_template_changes_nothing_and_names_everything():
    assert reading.parse(reading.text("template")) == settings.Settings()._replace(
        modes=reading.parse(reading.text("template")).modes
    )
    lines = reading.text("template").splitlines()
    named = {line.lstrip("# ").split(" =")[0] for line in lines if " = " in line}
    for section in settings.Settings()[:4] + settings.Settings()[5:]:
        assert set(section._fields) <= named
    assert set(settings.Mode._fields) <= named


def test_the_template_still_holds_where_its_comments_are_removed():
    lines = reading.text("template").splitlines()
    bare = [x.removeprefix("# ") if " = " in x and x[0] == "#" else x for x in lines]
    made = reading.parse("\n".join(bare))
    assert made.scans.period == 60.0
    assert made.tracker.max_tracks == 400
    assert None not in [x for section in made[1:4] for x in section]


def test_settings_come_back_from_their_dictionary():
    made = reading.harbour()
    told = settings.as_dict(made)
    assert told["modes"]["moored"]["rest"] is True
    assert told["scans"]["period"] == made.scans.period
    json.dumps(told, allow_nan=False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[scans]\nperiod = five", r"f.toml is not TOML .*line 2.*units"),
        ('[scans]\nperiod = "5 s"', r"period in \[scans\] is '5 s'; give a number"),
        ("[scans]\nperiods = 5", r"no setting in \[scans\] 'periods'.*period"),
        ("[scan]\nperiod = 5", r"no section 'scan'; choose of file, scans"),
        ("scans = 5", r"scans is no section; write \[scans\]"),
        ("[scans]\nperiod = -5", r"is -5.0; give a finite number above 0"),
        ("[scans]\nperiod = nan", r"is nan; give a finite number"),
        ("[scans]\nmax_detections = 2.5", r"is 2.5; give a whole number"),
        ("[tracker]\nmax_tracks = 0", r"is 0; give 1 or more"),
        ("[tracker]\nreport_threshold = 1", r"is 1.0; give a probability"),
        ("[modes.a]\ndetect_prob = 2", r"in \[modes.a\] is 2.0; give a probability"),
        ("[modes.a]\nrest = 1", r"is 1; give true or false"),
        ("[modes.a]\nbirth_share = 0", r"no mode has a birth_share above 0"),
        ("[modes]\nrest = true", r"'rest' without a mode.*\[modes.NAME\]"),
        ("[modes]", r"\[modes\] is empty"),
        ("[file]\nsort = 'yes'", r"sort in \[file\] is 'yes'; give true or false"),
        ("[file]\ntime = 3", r"time in \[file\] is 3; give text"),
    ],
)
def test_wrong_settings_are_named_in_one_sentence(text, message):
    with pytest.raises(DataError, match=message):
        reading.parse(text, "f.toml")


def test_one_detection_and_one_scan_are_refused():
    data = table([0.0, 8.0])
    first = [x[:1] for x in data[:2]]
    with pytest.raises(DataError, match="only one detection"):
        tracking.track(files.Table(*first, {}, None, None))
    with pytest.raises(DataError, match="in one scan"):
        tracking.track(data, reading.parse("[scans]\nperiod = 60"))


def test_too_few_detections_to_guess_from_ask_for_settings():
    with pytest.raises(DataError, match=r"noise_std in \[sensor\] and speed_std"):
        tracking.track(table([0.0, 8.0]))


def test_a_column_that_is_blank_or_missing_is_refused(recording):
    data, result = recording
    blank = data._replace(other={"ship": np.full(len(data.time), "", object)})
    with pytest.raises(DataError, match="'ship' is blank"):
        scoring.score(result, blank, "ship")
    with pytest.raises(DataError, match="no further column 'boat'"):
        scoring.score(result, data, "boat")


def test_the_picture_has_a_map_a_corner_and_its_times(recording):
    data, result = recording
    figure = picture.chart(result, data, data.other["ship"], "two ships")
    whole, zoom, over = figure.axes
    assert (whole.get_xlabel(), over.get_xlabel()) == ("x (m)", "minutes")
    tracks = picture.paths(result)
    assert (
        sum(len(path.time) for path in tracks.values()) == result.estimates.exists.sum()
    )
    width = np.diff(zoom.get_xlim())[0]
    assert width == pytest.approx(np.ptp(data.xy, axis=0).max() / picture.ZOOM)


def test_the_corner_is_where_most_moves():
    time = np.arange(12.0)
    resting = np.random.default_rng(0).normal(0.0, 1.0, (12, 2))
    moving = np.array([[5000.0, 9000.0]]) + 10 * time[:, None]
    tracks = {1: picture.Path(time, resting), 2: picture.Path(time, moving)}
    corner = picture.busiest(tracks, side=200.0)
    middle = moving.mean(0)
    assert ((corner < middle) & (middle < corner + 200.0)).all()


def test_a_target_at_rest_stays_and_forgets_its_velocity():
    rest = Rest(jnp.array([0.5, 2.0]), jnp.array([0.1, 0.3]))
    state, interval = jnp.array([4.0, 7.0, -5.0, 8.0]), jnp.array(10.0)
    np.testing.assert_array_equal(rest.move(state, interval), [4.0, 0.0, -5.0, 0.0])
    np.testing.assert_array_equal(rest.transition(interval), np.diag([1.0, 0, 1, 0]))
    np.testing.assert_allclose(
        rest.noise(interval), np.diag([5.0, 0.01, 20.0, 0.09]), rtol=1e-12
    )
    assert (rest.dim, rest.position_index, rest.velocity_index) == (4, (0, 2), (1, 3))


@pytest.mark.slow
def test_the_harbour_is_tracked():
    data = files.read_detections(files.harbour_path())
    result = tracking.track(data, reading.harbour())
    scores = scoring.score(result, data, "MMSI")
    assert scores.identity.idf1 > 0.45


def test_settings_reach_the_tracker_of_hypotheses():
    chosen = settings.Algorithm(
        name="mht",
        max_tracks=7,
        gate_prob=0.9,
        report_threshold=0.4,
        num_scans=3,
        max_leaves=5,
        leaf_threshold=1e-4,
    )
    made = tracking.algorithm(chosen, imm.imm()).step.args[0]
    assert (made.num_scans, made.max_leaves, made.report_threshold) == (3, 5, 0.4)
    assert (made.thinning.max_tracks, made.thinning.prune_threshold) == (7, 1e-4)
    assert made.gating.prob == 0.9


def test_settings_reach_the_tracker_of_trajectories():
    chosen = settings.Algorithm(
        name="tpmbm", max_tracks=7, gate_prob=0.9, num_scans=3, max_leaves=5, lag=2
    )
    made = tracking.algorithm(chosen, imm.imm()).step.args[0]
    assert (made.num_scans, made.max_leaves, made.delay) == (3, 5, 5)
    assert (made.thinning.max_tracks, made.gating.prob) == (7, 0.9)
    assert made.bernoulli


def test_settings_reach_the_tracker_of_mixtures():
    chosen = settings.Algorithm(
        name="pmbm",
        max_tracks=7,
        gate_prob=0.9,
        report_threshold=0.4,
        max_hypotheses=9,
        max_leaves=5,
        leaf_threshold=1e-4,
        prune_threshold=1e-2,
    )
    made = tracking.algorithm(chosen, imm.imm()).step.args[0]
    assert (made.max_hypotheses, made.max_leaves, made.report_threshold) == (9, 5, 0.4)
    limits = made.thinning
    assert (limits.max_tracks, limits.prune_threshold) == (7, 1e-4)
    assert (limits.exist_threshold, made.gating.prob) == (1e-2, 0.9)


def test_settings_reach_the_tracker_of_labels():
    chosen = settings.Algorithm(
        name="lmb",
        max_tracks=7,
        max_births=3,
        gate_prob=0.9,
        prune_threshold=1e-2,
        report_threshold=0.4,
    )
    made = tracking.algorithm(chosen, imm.imm()).step.args[0]
    assert (made.max_tracks, made.max_births, made.report_threshold) == (7, 3, 0.4)
    assert (made.exist_threshold, made.gating.prob) == (1e-2, 0.9)


FOLLOWERS = {"cbmember", "lmb", "mht", "pmbm", "tpmbm"}


@pytest.mark.parametrize("name", sorted({*settings.ALGORITHMS} - FOLLOWERS))
def test_settings_reach_the_tracker_that_they_name(name):
    chosen = settings.Algorithm(
        name=name,
        max_tracks=7,
        max_births=3,
        gate_prob=0.9,
        start_threshold=0.3,
        confirm_hits=2,
        confirm_scans=4,
        drop_misses=6,
        drop_scans=8,
        confirm_prob=0.7,
        drop_prob=0.01,
    )
    made = tracking.algorithm(chosen, imm.imm()).step.args[0]
    assert (made.max_tracks, made.max_births, made.start_threshold) == (7, 3, 0.3)
    assert made.gating.prob == 0.9
    if made.weighs:
        assert made.rule == management.Existence(0.7, 0.01)
    else:
        assert made.rule == management.MofN(2, 4, 6, 8)


def test_a_tracker_that_there_is_not():
    with pytest.raises(DataError, match="tracker is 'jpdaa'"):
        tracking.algorithm(settings.Algorithm(name="jpdaa"), imm.imm())
