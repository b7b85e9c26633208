"""Four targets that meet in the middle, of which one dies there (Williams 2015).

All are within a metre of each other half way through, with noise of a metre, and come
and go as constant velocity takes them from there, backwards and forwards. One dies as
they meet. Births have a small rate all over the region, and three targets are expected
at first. The truth is one draw, the same in all runs.

The PMBM filters differ in their estimators, see `trackers.estimators`. With multi-
Bernoulli births, as `mbm`, `tmbm` and their kin need them, the three expected at first
are four that are there with probability 3/4 each. These are alike, so that all is said
by 24 hypotheses that differ in who is who, and fewer others find room.

    >>> from jaxtrack.scenarios import williams_crossing
    >>> made = williams_crossing.make()
    >>> made.world.truth.exists.sum(0).tolist(), made.cutoff
    ([40, 81, 81, 81], 10.0)

References: Williams, "Marginal multi-Bernoulli filters: RFS derivation of MHT, JIPDA,
and association-based MeMBer", IEEE Trans. Aerospace and Electronic Systems 51(3), 2015,
section VI; with the parameters of Garcia-Fernandez, Williams, Granstrom and Svensson,
"Poisson multi-Bernoulli mixture filter: direct derivation and implementation", the same
54(4), 2018, section VII.
"""

import jax.numpy as jnp
import numpy as np

from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.scenarios.world import Scenario, Truth, World, slots_for
from jaxtrack.targets import single
from jaxtrack.trackers import (
    glmb,
    hypothesis_mht,
    lmb,
    mbm,
    mht,
    pmb,
    pmbm,
    tmbm,
    tpmbm,
    undetected,
)
from jaxtrack.types import Tracker

WIDTH, SCANS, TARGETS = 300.0, 81, 4
NOISE_DENSITY = 0.02  # m^2/s^3
SENSOR_STD, SURVIVE = 1.0, 0.99
MIDDLE_VAR = 0.1  # of positions and velocities as they meet
BIRTH_RATE, EXPECTED = 0.005, 3.0  # in a scan, and before the first
BIRTH_MEAN = np.array([100.0, 0.0, 100.0, 0.0])
BIRTH_STD = np.array([150.0, 1.0, 150.0, 1.0])
SEED = 9
# Their births.
BERNOULLI = "mbm", "mbm01", "tmbm", "tmbm01", "glmb", "glmb-exact"
DRIVEN = "lmb", "lmb-gibbs"


def make(
    clutter_rate: float = 10.0, detect_prob: float = 0.9, max_hypotheses: float = 200
) -> Scenario:
    """Makes the scenario; the filters are told the true clutter and detection.

    Args:
        clutter_rate: Expected false detections a scan.
        detect_prob: Of the sensor and of the filters.
        max_hypotheses: Of the filters that follow any.

    Raises:
        ValueError: Not a whole number of hypotheses.
    """
    size = int(max_hypotheses)
    if size != max_hypotheses:
        raise ValueError(
            f"max_hypotheses is {max_hypotheses}; give a whole number, 1 or more"
        )
    clutter = UniformClutter(
        jnp.asarray(clutter_rate, float), jnp.zeros(2), WIDTH * jnp.ones(2)
    )
    motion, sensor = (
        ConstantVelocity(NOISE_DENSITY * jnp.ones(2)),
        Position(jnp.ones(2)),
    )
    detect = Constant(jnp.asarray(detect_prob, float))
    survive = Constant(jnp.asarray(SURVIVE, float))
    target = single.Params(motion, sensor, survive, detect)
    poisson, given = _params(target, clutter)
    return Scenario(
        name="williams-crossing",
        summary="four targets that meet in the middle, of which one dies there",
        world=World(truth(), motion, sensor, detect, clutter),
        trackers={
            name: (tracker, given.get(name, poisson))
            for name, tracker in _trackers(size).items()
        },
        max_detections=slots_for(TARGETS, clutter_rate),
        cutoff=10.0,
        order=2.0,
        published={},
    )


def _params(
    target: single.Params, clutter: UniformClutter
) -> tuple[undetected.Params, dict[str, undetected.Params]]:
    """Returns parameters with a Poisson number of births, and others' by name."""
    poisson = undetected.Params(
        target, _places(BIRTH_RATE), clutter, undetected=_places(EXPECTED)
    )
    start = _places(np.full(TARGETS, EXPECTED / TARGETS))
    bernoullis = undetected.Params(
        target,
        MultiBernoulliBirth(*_places(BIRTH_RATE)),
        clutter,
        start=MultiBernoulliBirth(*start),
    )
    driven = bernoullis._replace(birth=_driven(), start=None)
    given: dict[str, undetected.Params] = {
        **dict.fromkeys(BERNOULLI, bernoullis),
        **dict.fromkeys(DRIVEN, driven),
    }
    return poisson, given


def _places(rate: float | np.ndarray) -> PoissonBirth:
    """Returns births all over the region, at one rate each."""
    each = np.atleast_1d(np.asarray(rate, float))
    num = each.size
    return PoissonBirth(
        rate=jnp.asarray(each),
        mean=jnp.asarray(np.tile(BIRTH_MEAN, (num, 1))),
        cov=jnp.asarray(np.tile(np.diag(BIRTH_STD**2), (num, 1, 1))),
        mode_prob=jnp.ones((num, 1)),
    )


def _driven() -> DetectionBirth:
    """Returns births at the same rate wherever something is unexplained."""
    return DetectionBirth(
        rate=jnp.asarray(BIRTH_RATE),
        max_existence_prob=jnp.asarray(1.0),
        velocity_std=jnp.asarray(BIRTH_STD[1::2]),
        extra_std=jnp.zeros(0),
        mode_prob=jnp.ones(1),
    )


def _trackers(size: int) -> dict[str, Tracker]:
    target = single.single()
    room = {"max_hypotheses": size, "max_tracks": 24, "max_leaves": 32}
    filters = {**room, "max_contested": 12, "report_threshold": 0.4}
    few = {**room, "prune_threshold": 1e-8}  # a birth is far less likely than clutter
    return {
        "pmbm": pmbm.pmbm(target, **filters),
        "pmbm-number": pmbm.pmbm(target, estimator="number", **filters),
        "pmbm-certain": pmbm.pmbm(target, estimator="certain", **filters),
        "mbm": mbm.mbm(target, **few, report_threshold=0.4),
        "mbm01": mbm.mbm01(target, **few),
        "glmb": glmb.glmb(target, **few),
        "glmb-exact": glmb.glmb(target, method="k-best", **few),
        "lmb": lmb.lmb(target, max_tracks=24),
        "lmb-gibbs": lmb.lmb(target, method="gibbs", max_events=size, max_tracks=24),
        "pmb": pmb.pmb(target, max_tracks=24, report_threshold=0.4),
        "tpmbm": tpmbm.tpmbm(target, max_tracks=24, report_threshold=0.4),
        "tmbm": tmbm.tmbm(target, max_tracks=24, report_threshold=0.4),
        "tmbm01": tmbm.tmbm(
            target, max_tracks=24, max_leaves=20, report_threshold=0.4, certain=True
        ),
        "mht": mht.mht(target, max_tracks=24),
        "hypothesis-mht": hypothesis_mht.hypothesis_mht(target, **room),
    }


def truth() -> Truth:
    """Returns the four, [T, 4, 4], a scan every second."""
    rng, half = np.random.default_rng(SEED), SCANS // 2
    step = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
    noise = NOISE_DENSITY * np.kron(np.eye(2), [[1 / 3, 1 / 2], [1 / 2, 1.0]])
    lower = np.linalg.cholesky(noise)
    middle = np.array([WIDTH / 2, 0.0, WIDTH / 2, 0.0])
    state = np.zeros((SCANS, TARGETS, 4))
    state[half] = middle + np.sqrt(MIDDLE_VAR) * rng.normal(size=(TARGETS, 4))
    for k in range(half):
        ahead, back = rng.normal(size=(2, TARGETS, 4)) @ lower.T
        state[half + k + 1] = state[half + k] @ step.T + ahead
        before = state[half - k] + back
        state[half - k - 1] = np.linalg.solve(step, before.T).T
    time = np.arange(SCANS, dtype=float)
    exists = np.ones((SCANS, TARGETS), bool)
    exists[half:, 0] = False
    return Truth(jnp.asarray(state), jnp.asarray(exists), jnp.asarray(time))
