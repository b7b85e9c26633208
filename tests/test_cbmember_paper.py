"""The CBMeMBer filter against the paper, written as loops, over a whole run."""

import functools

import numpy as np
from cases.lines import compiled, scans_of
from reference import cbmember as book
from reference import mixture as mixture_book

from jaxtrack.models import birth, clutter, motion, probability, sensor, switching
from jaxtrack.targets import imm, mixture
from jaxtrack.trackers import cbmember

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
    max_tracks=5,
    max_parents=2,
    max_updated=2,
    prune_threshold=1e-3,
    report_threshold=0.5,
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
    # Where nothing is dropped, what is left of a difference is rounding: 1e-12.
    np.testing.assert_allclose(estimates.dropped, dropped, rtol=1e-8, atol=1e-12)
    assert max(dropped) > 0.01
