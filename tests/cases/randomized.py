"""Two models in the plane, in JAX and in plain NumPy, for the tests of RMM-MHT."""

import numpy as np

from jaxtrack.models import birth, clutter, motion, probability, sensor, switching
from jaxtrack.targets import imm
from jaxtrack.trackers import undetected

DENSITIES = 0.3, 6.0
NOISE = 1.1, 0.8
SURVIVE, DETECT = (0.98, 0.9), (0.9, 0.8)
RATE, SIDE = 2.0, 60.0


def params(start=None, clutter_rate=RATE):
    target = imm.Params(
        motions=tuple(motion.ConstantVelocity(q * np.ones(2)) for q in DENSITIES),
        switching=switching.MarkovSwitching(np.array([[0.9, 0.1], [0.3, 0.7]])),
        sensor=sensor.Position(np.array(NOISE)),
        survive=probability.PerMode(np.array(SURVIVE)),
        detect=probability.PerMode(np.array(DETECT)),
    )
    births = birth.DetectionBirth(
        rate=np.array(0.05),
        max_existence_prob=np.array(1.0),
        velocity_std=np.full(2, 3.0),
        extra_std=np.zeros(0),
        mode_prob=np.array([0.5, 0.5]),
    )
    box = np.full(2, SIDE / 2)
    false = clutter.UniformClutter(np.array(clutter_rate), -box, box)
    return undetected.Params(target, births, false, start=start)


def matrices(interval):
    """Transition and noises in plain NumPy."""
    F = np.kron(np.eye(2), [[1, interval], [0, 1]])
    unit = [[interval**3 / 3, interval**2 / 2], [interval**2 / 2, interval]]
    return [(F, q * np.kron(np.eye(2), unit)) for q in DENSITIES]


H = np.eye(4)[[0, 2]]
R = np.diag(np.square(NOISE))
