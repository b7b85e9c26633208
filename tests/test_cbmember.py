"""Tests of the CBMeMBer filter: the paper as loops, brute-force Bayes, and labels."""

import functools

import jax
import numpy as np
import pytest
from reference import bruteforce
from reference import cbmember as book
from reference import kalman as kalman_book
from reference import mixture as mixture_book

from jaxtrack import engine
from jaxtrack.models import birth, clutter, motion, probability, sensor, switching
from jaxtrack.targets import imm, mixture, single
from jaxtrack.trackers import cbmember
from jaxtrack.types import Scan

KEY = np.array(jax.random.key_data(jax.random.key(0)))
QUICK = {"xla_backend_optimization_level": 0}  # compiling takes longer than running


def compiled(tracker, batch=False):
    """(params, scans) -> estimates, as NumPy."""

    def run(params, scans):
        return engine.run(tracker, params, scans, jax.random.wrap_key_data(KEY))

    run = jax.jit(jax.vmap(run) if batch else run, compiler_options=QUICK)
    return lambda *args: jax.tree.map(np.array, run(*args))


def scans_of(rows, slots, intervals):
    """Pads lists of detections, one list a scan."""
    detections = np.zeros((len(rows), slots, 1))
    valid = np.zeros((len(rows), slots), bool)
    for t, row in enumerate(rows):
        detections[t, : len(row), 0] = row
        valid[t, : len(row)] = True
    return Scan(detections, valid, np.broadcast_to(intervals, len(rows)) * 1.0)


# The paper as loops, over a whole run.

BIRTHS = birth.MultiBernoulliBirth(
    existence_prob=np.array([0.15, 0.08]),
    mean=np.array([[-20.0, 2.0], [15.0, -1.0]]),
    cov=np.array([[[9.0, 1.0], [1.0, 4.0]], [[16.0, -1.0], [-1.0, 5.0]]]),
    mode_prob=np.array([[0.7, 0.3], [0.4, 0.6]]),
)
MANEUVERING = imm.Params(
    motions=(
        motion.ConstantVelocity(np.array([0.2])),
        motion.OrnsteinUhlenbeck(np.array([20.0]), np.array([6.0])),
    ),
    switching=switching.MarkovSwitching(np.array([[0.85, 0.15], [0.35, 0.65]])),
    sensor=sensor.Position(np.array([1.2])),
    survive=probability.PerMode(np.array([0.98, 0.85])),
    detect=probability.PerMode(np.array([0.93, 0.7])),
)
NUM_SCANS, SLOTS = 10, 5
COMPONENTS = {"max_components": 2, "prune_threshold": 0.01, "merge_threshold": 1.0}
SIZES = book.Settings(
    max_tracks=5, max_parents=2, prune_threshold=1e-3, report_threshold=0.5
)


def busy_scans():
    """Two targets that start near the birth places, missed at times, and clutter."""
    rng = np.random.default_rng(4)
    times = np.arange(NUM_SCANS)
    rows = []
    for t in times:
        paths = np.array([-20 + 3.0 * t, 15 - 2.0 * t])
        seen = (paths + rng.normal(size=2))[rng.random(2) < 0.9]
        rows.append([*seen, *rng.uniform(-50, 50, rng.integers(0, 4))])
    rows[3] = [-11.0, -10.0, 9.5]  # two rivals for one track
    rows[6] = []
    return rows, rng.uniform(0.6, 1.4, NUM_SCANS)


@functools.cache
def both_runs():
    """The estimates of the library, and the tracks of the loops scan by scan."""
    rows, intervals = busy_scans()
    tracker = cbmember.cbmember(mixture.mixture(**COMPONENTS), **SIZES._asdict())
    params = cbmember.Params(
        MANEUVERING,
        BIRTHS,
        clutter.UniformClutter(np.array(1.5), np.array([-60.0]), np.array([60.0])),
    )
    estimates = compiled(tracker)(params, scans_of(rows, SLOTS, intervals))

    places = zip(*BIRTHS, strict=True)
    scene = book.Scene(births=list(places), clutter=1.5 / 120, rate=1.5)
    tracks, next_label, steps = [], 0, []
    for row, interval in zip(rows, intervals, strict=True):
        model = mixture_book.Model(
            F=[np.array(m.transition(interval)) for m in MANEUVERING.motions],
            Q=[np.array(m.noise(interval)) for m in MANEUVERING.motions],
            H=np.array([[1.0, 0.0]]),
            R=np.array([[1.44]]),
            p=MANEUVERING.switching.transition,
            survive=MANEUVERING.survive.value,
            detect=MANEUVERING.detect.value,
            **COMPONENTS,
        )
        detections = [np.array([z]) for z in row]
        tracks, next_label, log_evidence, dropped = book.step(
            model, scene, SIZES, tracks, detections, next_label
        )
        steps.append((tracks, log_evidence, dropped))
    return estimates, steps


def test_existence_follows_the_paper():
    estimates, steps = both_runs()
    for t, (tracks, _, _) in enumerate(steps):
        r = [r for r, _, _ in tracks]
        found = estimates.existence_prob[t]
        np.testing.assert_allclose(found[: len(r)], r, rtol=1e-9)
        assert (found[len(r) :] == 0).all()
    assert max(len(tracks) for tracks, _, _ in steps) == SIZES.max_tracks


def test_moments_and_modes_follow_the_paper():
    estimates, steps = both_runs()
    for t, (tracks, _, _) in enumerate(steps):
        for n, (_, belief, _) in enumerate(tracks):
            mean, cov = mixture_book.moments(belief)
            modes = mixture_book.mode_prob(belief)
            np.testing.assert_allclose(estimates.mean[t, n], mean, rtol=1e-9)
            np.testing.assert_allclose(estimates.cov[t, n], cov, rtol=1e-9)
            np.testing.assert_allclose(estimates.mode_prob[t, n], modes, rtol=1e-9)


def test_labels_follow_the_rule():
    estimates, steps = both_runs()
    for t, (tracks, _, _) in enumerate(steps):
        labels = [shown for _, _, (_, _, shown) in tracks]
        np.testing.assert_array_equal(estimates.label[t, : len(labels)], labels)
        reported = [r > 0.5 for r, _, _ in tracks]
        np.testing.assert_array_equal(estimates.exists[t, : len(labels)], reported)


def test_evidence_and_losses_follow_the_paper():
    estimates, steps = both_runs()
    log_evidence = [row[1] for row in steps]
    dropped = [row[2] for row in steps]
    np.testing.assert_allclose(estimates.log_evidence, log_evidence, rtol=1e-9)
    np.testing.assert_allclose(estimates.dropped, dropped, rtol=1e-8, atol=1e-12)
    assert max(dropped) > 0.01


# One scan of up to three targets and three detections, against enumeration.

NUM = 3
LOW, HIGH = -10.0, 10.0


def one_scan_params(r, mean, variance, detect, rate):
    """Every target is a birth, so that the scan is nothing but the update."""
    cov = np.stack([np.diag([v, 1.0]) for v in variance])
    return cbmember.Params(
        target=single.Params(
            motion=motion.ConstantVelocity(np.array([1.0])),
            sensor=sensor.Position(np.array([0.5])),
            survive=probability.Constant(np.array(0.9)),
            detect=probability.Constant(np.array(detect)),
        ),
        birth=birth.MultiBernoulliBirth(
            existence_prob=r,
            mean=np.stack([mean, np.zeros(NUM)], 1),
            cov=cov,
            mode_prob=np.ones((NUM, 1)),
        ),
        clutter=clutter.UniformClutter(
            np.array(rate), np.array([LOW]), np.array([HIGH])
        ),
    )


@functools.cache
def one_scan_run():
    tracker = cbmember.cbmember(
        single.single(), max_tracks=2 * NUM, max_parents=NUM, prune_threshold=0.0
    )
    return compiled(tracker, batch=True)


def random_scenes(num_targets, num_detections, count, detect, apart, seed=0):
    """Scenes in which each detection stems from a target or from clutter, at random."""
    rng = np.random.default_rng(seed)
    scenes = []
    for _ in range(count):
        r = np.zeros(NUM)
        r[:num_targets] = rng.uniform(0.05, 0.99, num_targets)
        start = rng.uniform(LOW + 1, HIGH - 1)
        mean = np.linspace(-7, 7, NUM) if apart else start + rng.normal(size=NUM)
        variance = rng.uniform(0.1, 1.0, NUM)
        from_target = mean[rng.integers(0, num_targets, num_detections)]
        near = from_target + rng.normal(size=num_detections)
        far = rng.uniform(LOW, HIGH, num_detections)
        z = np.where(rng.random(num_detections) < 0.7, near, far).clip(LOW, HIGH)
        if apart:  # one detection for each target
            z = rng.permutation(mean[:num_targets]) + rng.normal(size=num_targets)
            z = z.clip(LOW, HIGH)
        prob = rng.uniform(*detect)
        scenes.append((r, mean, variance, prob, rng.uniform(0.5, 5.0), z))
    return scenes


def compare(scenes):
    """The filter's estimates, and what enumeration says of each scene."""
    params = [one_scan_params(*scene[:-1]) for scene in scenes]
    scans = [scans_of([scene[-1]], NUM, 1.0) for scene in scenes]
    batch = jax.tree.map(lambda *x: np.stack(x), *params)
    estimates = one_scan_run()(batch, jax.tree.map(lambda *x: np.stack(x), *scans))
    truth = []
    for r, mean, variance, detect, rate, z in scenes:
        spread = variance[:, None] + 0.25
        g = np.exp(-((z[None] - mean[:, None]) ** 2) / spread / 2)
        g /= np.sqrt(2 * np.pi * spread)
        intensity = np.full(z.size, rate / (HIGH - LOW))
        detect = np.full(NUM, detect)
        truth.append(bruteforce.multi_bernoulli(r, detect, g, intensity, rate))
    return estimates, truth


def count_errors(scenes):
    """Expected number of targets, too many (positive) or too few."""
    estimates, truth = compare(scenes)
    exact = np.array([causes.sum() for _, causes in truth])
    return estimates.existence_prob.sum((1, 2)) - exact


def test_one_target_and_one_detection_are_exact():
    """In number and evidence, and in each track's density; not in their shares."""
    scenes = random_scenes(1, 1, 50, detect=(0.3, 0.99), apart=False)
    estimates, truth = compare(scenes)
    exact = [causes.sum() for _, causes in truth]
    found = estimates.existence_prob.sum((1, 2))
    np.testing.assert_allclose(found, exact, rtol=1e-10)
    evidence = [np.log(evidence) for evidence, _ in truth]
    np.testing.assert_allclose(estimates.log_evidence[:, 0], evidence, rtol=1e-10)
    for i, (_, mean, variance, _, _, z) in enumerate(scenes):
        hit = kalman_book.update(
            np.array([mean[0], 0]),
            np.diag([variance[0], 1.0]),
            np.array([[1.0, 0.0]]),
            0,
            np.array([[0.25]]),
            z,
        )[:2]
        missed = np.array([mean[0], 0]), np.diag([variance[0], 1.0])
        found = list(zip(estimates.mean[i, 0], estimates.cov[i, 0], strict=True))[:2]
        found.sort(key=lambda belief: belief[1][0, 0])  # the detected one is surer
        for belief, expected in zip(found, (hit, missed), strict=True):
            np.testing.assert_allclose(belief[0], expected[0], rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(belief[1], expected[1], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("num_targets", [1, 2, 3])
def test_no_detection_is_exact(num_targets):
    scenes = random_scenes(num_targets, 0, 20, detect=(0.3, 0.99), apart=False)
    estimates, truth = compare(scenes)
    found = np.sort(estimates.existence_prob[:, 0], axis=1)[:, ::-1][:, :NUM]
    exact = np.array([np.sort(causes.sum(1))[::-1] for _, causes in truth])
    np.testing.assert_allclose(found, exact, rtol=1e-10, atol=1e-14)
    evidence = [np.log(evidence) for evidence, _ in truth]
    np.testing.assert_allclose(estimates.log_evidence[:, 0], evidence, rtol=1e-10)


@pytest.mark.parametrize("num_targets", [2, 3])
def test_one_detection_has_exact_number_and_evidence(num_targets):
    """Nobody competes for a target, so the product form of the evidence is exact."""
    scenes = random_scenes(num_targets, 1, 50, detect=(0.3, 0.99), apart=False)
    estimates, truth = compare(scenes)
    evidence = [np.log(evidence) for evidence, _ in truth]
    np.testing.assert_allclose(estimates.log_evidence[:, 0], evidence, rtol=1e-10)
    np.testing.assert_allclose(count_errors(scenes), 0, atol=1e-10)


# Bounds on the root mean square and on the largest error of the expected number, a
# quarter above what was measured over 300 random scenes each with detection probability
# from 0.9 to 0.99. (targets, detections, whether targets stand apart): bounds. With
# more detections than targets nearby the filter counts too many.
MEASURED = {
    (1, 2, False): (0.43, 1.06),
    (1, 3, False): (0.90, 2.3),
    (2, 2, False): (0.25, 0.88),
    (2, 3, False): (0.59, 1.5),
    (3, 2, False): (0.15, 0.78),
    (3, 3, False): (0.37, 1.4),
    (2, 2, True): (0.001, 0.01),
    (3, 3, True): (0.001, 0.01),
}


@pytest.mark.parametrize("setting", MEASURED)
def test_expected_number_is_near_bayes(setting):
    num_targets, num_detections, apart = setting
    rms, worst = MEASURED[setting]
    scenes = random_scenes(num_targets, num_detections, 300, (0.9, 0.99), apart)
    errors = count_errors(scenes)
    assert np.sqrt((errors**2).mean()) < rms
    assert np.abs(errors).max() < worst


def test_rivals_for_a_label_get_labels_of_their_own():
    """Two detections of one target: both tracks are reported, the likelier is heir."""
    r, mean = np.array([0.4, 0.3, 0.0]), np.array([0.0, 8.0, -8.0])
    scene = r, mean, np.full(NUM, 0.5), 0.95, 0.1, np.array([0.9, 0.2, 7.9])
    estimates, _ = compare([scene])
    labels = estimates.label[0, 0][estimates.exists[0, 0]]
    places = estimates.mean[0, 0, :, 0][estimates.exists[0, 0]]
    by_place = dict(zip(labels, places.round(1), strict=True))
    assert len(by_place) == 3
    assert 0 < by_place[0] < 0.3  # the nearer one keeps label 0
    assert by_place[1] > 7
    assert 0.3 < by_place[3] < 1  # births took 0 to 2


# Whole scenes with one Gaussian a track.

STRAIGHT = single.Params(
    motion=motion.ConstantVelocity(np.array([0.05])),
    sensor=sensor.Position(np.array([0.5])),
    survive=probability.Constant(np.array(0.99)),
    detect=probability.Constant(np.array(0.97)),
)
CLUTTER = clutter.UniformClutter(np.array(0.5), np.array([-60.0]), np.array([60.0]))


def test_labels_stay_with_crossing_targets_and_a_newborn_gets_a_new_one():
    rng = np.random.default_rng(0)
    times = np.arange(16)
    paths = np.stack([-22.0 + 3 * times, 23.0 - 3 * times], 1)
    rows = [list(rng.permutation(row + 0.3 * rng.normal(size=2))) for row in paths]
    for t in range(10, 16):
        rows[t].append(-22.0 + 3 * (t - 10) + 0.3 * rng.normal())
    births = birth.MultiBernoulliBirth(
        existence_prob=np.full(2, 0.05),
        mean=np.array([[-22.0, 0.0], [23.0, 0.0]]),
        cov=np.tile(np.diag([1.0, 16.0]), (2, 1, 1)),
        mode_prob=np.ones((2, 1)),
    )
    tracker = cbmember.cbmember(single.single(), max_tracks=8, max_parents=4)
    params = cbmember.Params(STRAIGHT, births, CLUTTER)
    estimates = compiled(tracker)(params, scans_of(rows, 3, 1.0))
    newborn = -22.0 + 3 * (times - 10)
    followed = [], [], []
    for t in range(2, 16):
        for path, labels in zip((*paths[t], newborn[t]), followed, strict=True):
            near = np.abs(estimates.mean[t, :, 0] - path) < 1.5
            crossing = np.abs(paths[t, 0] - paths[t, 1]) < 4
            found = estimates.label[t][estimates.exists[t] & near]
            if labels is not followed[2] or t >= 12:
                labels.extend([] if crossing else found)
    first, second, third = (set(labels) for labels in followed)
    assert len(first) == len(second) == len(third) == 1
    assert len(first | second | third) == 3
    assert min(map(len, followed)) >= 4
    assert (estimates.exists[4:9].sum(1) == 2).all()
    assert (estimates.exists[13:].sum(1) == 3).all()


def test_an_unexplained_detection_starts_a_track():
    births = birth.DetectionBirth(
        rate=np.array(0.1),
        max_existence_prob=np.array(0.2),
        velocity_std=np.array([3.0]),
        extra_std=np.zeros(0),
        mode_prob=np.ones(1),
    )
    tracker = cbmember.cbmember(single.single(), max_tracks=6, max_births=2)
    params = cbmember.Params(STRAIGHT, births, CLUTTER)
    rows = [[], [-5.0], [-3.0], [-1.0, 30.0], [1.0], [3.0, -40.0]]
    estimates = compiled(tracker)(params, scans_of(rows, 3, 1.0))
    assert not estimates.exists[:2].any()
    for t in (3, 4, 5):
        assert estimates.exists[t].sum() == 1
        assert abs(estimates.mean[t, 0, 0] - (2 * t - 7)) < 1
        assert estimates.label[t, 0] == estimates.label[3, 0]
    # The first detection is born with rate * interval, all of it unexplained, and
    # meets its second detection with what the first taught.
    r = 0.1 * 0.99
    spread = 0.25 + 9 + 0.05 / 3 + 0.25
    g = np.exp(-(2.0**2) / spread / 2) / np.sqrt(2 * np.pi * spread)
    odds = r * 0.97 * g / (1 - r * 0.97)
    share = odds / (odds + 0.5 / 120)
    expected = share * (1 - r) / (1 - r * 0.97)
    np.testing.assert_allclose(estimates.existence_prob[2, 0], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"max_tracks": 0}, "max_tracks is 0; give at least 1"),
        ({"max_births": 0}, "max_births is 0"),
        ({"max_parents": 0}, "max_parents is 0"),
        ({"prune_threshold": 1.0}, "prune_threshold is 1.0"),
        ({"report_threshold": -0.1}, "report_threshold is -0.1"),
    ],
)
def test_bad_settings_are_named(setting, words):
    with pytest.raises(ValueError, match=words):
        cbmember.cbmember(single.single(), **setting)
