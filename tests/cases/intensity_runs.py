"""Three scans in a row, with survival, motion, switching and birth.

As the library runs them, and as the plain filters do, which reduce nothing.
"""

import numpy as np
from cases import lines
from reference import cphd as cphd_book
from reference import phd as book

from jaxtrack import entries
from jaxtrack.models import birth, clutter, motion, probability, sensor, switching
from jaxtrack.targets import imm, mixture, single
from jaxtrack.trackers import intensity

TARGETS = {
    "single": single.single(),
    "mixture": mixture.mixture(8, prune_threshold=0.0, merge_threshold=0.0),
}
SCANS = [[-1.0, 2.2], [], [0.3, -6.0]]
# Where motions differ no two components ever have equal means, which would merge.
MOTIONS = (
    motion.ConstantVelocity(np.array([0.2])),
    motion.OrnsteinUhlenbeck(np.array([6.0]), np.array([2.0])),
)
STD, RATE, SPAN = 0.7, 1.4, 20.0
CHAIN = np.array([[0.8, 0.2], [0.3, 0.7]])
SURVIVE, DETECT = np.array([0.95, 0.8]), np.array([0.9, 0.7])
BORN = np.array([0.3, 0.2])
PLACES = np.array([[-2.0, 0.5], [1.0, -1.0]])
SPREAD = np.array([np.diag([4.0, 1.0]), np.diag([1.0, 2.0])])
MODE_PROB = np.array([[0.6, 0.4], [0.1, 0.9]])
MAX_TARGETS = 25


def params(name):
    place = sensor.Position(np.array([STD]))
    if name == "single":
        survive, detect = (probability.Constant(x[0]) for x in (SURVIVE, DETECT))
        target, mode_prob = (
            single.Params(MOTIONS[0], place, survive, detect),
            np.ones((2, 1)),
        )
    else:
        survive, detect = (probability.PerMode(x) for x in (SURVIVE, DETECT))
        chain = switching.MarkovSwitching(CHAIN)
        target = imm.Params(MOTIONS, chain, place, survive, detect)
        mode_prob = MODE_PROB
    places = birth.PoissonBirth(BORN, PLACES, SPREAD, mode_prob)
    box = clutter.UniformClutter(
        np.array(RATE), np.array([-SPAN / 2]), np.array([SPAN / 2])
    )
    return intensity.Params(target, places, box)


def run(tracker, name):
    """The estimates of three scans, a second apart, as NumPy."""
    scans = lines.scans_of(SCANS, 3, 1.0)
    return lines.compiled(tracker)(params(name), scans)


def model(name):
    modes = 1 if name == "single" else 2
    second, moves = np.array(1.0), MOTIONS[:modes]
    F = [np.asarray(entries.dense(move.transition(second))) for move in moves]
    Q = [np.asarray(entries.dense(move.noise(second))) for move in moves]
    sensor_of = np.array([[1.0, 0.0]]), np.array([[STD**2]])
    chain = np.ones((1, 1)) if modes == 1 else CHAIN
    return book.Model(F, Q, *sensor_of, chain, SURVIVE[:modes], DETECT[:modes])


def births(name):
    mode_prob = np.ones((2, 1)) if name == "single" else MODE_PROB
    return [
        (BORN[b] * mode_prob[b, n], PLACES[b], SPREAD[b], n)
        for b in range(2)
        for n in range(mode_prob.shape[1])
    ]


CLUTTER = book.Clutter(RATE, lambda z: 1 / SPAN)


def plain_phd(name):
    """After each scan: all components, and the log-evidence."""
    components, rows = [], []
    for scan in SCANS:
        components = book.predict(model(name), components, births(name))
        detections = [np.array([z]) for z in scan]
        missed, hits, log_evidence = book.update(
            model(name), CLUTTER, components, detections
        )
        components = missed + [c for hit in hits for c in hit]
        rows.append((components, log_evidence))
    return rows


def plain_cphd(name):
    """After each scan: all components, the probabilities, and the log-evidence."""
    components, rows = [], []
    p = [1.0] + [0.0] * MAX_TARGETS
    born = [cphd_book.poisson(BORN.sum(), n) for n in range(MAX_TARGETS + 1)]
    for scan in SCANS:
        survivors = book.predict(model(name), components, [])
        before = sum(w for w, *_ in components)
        alive = sum(w for w, *_ in survivors) / before if before else 1.0
        p = cphd_book.predict_cardinality(p, alive, born)
        components = survivors + births(name)
        detections = [np.array([z]) for z in scan]
        missed, hits, p, log_evidence = cphd_book.update(
            model(name), CLUTTER, components, p, detections
        )
        components = missed + [c for hit in hits for c in hit]
        rows.append((components, p, log_evidence))
    return rows
