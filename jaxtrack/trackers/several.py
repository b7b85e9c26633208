"""Several sensors: what the trackers with more than one have in common.

Each sensor has a measurement model, a probability of detection (and with it a field of
view) and clutter of its own; detections may differ in size. Of the target's `Params`,
`sensor` and `detect` are replaced by each sensor's. A sensor that did not look detects
nothing and has no clutter, so that its scan teaches nothing: sensors that rotate or
report at different times share one sequence of scans.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import models
    >>> from jaxtrack.trackers import several
    >>> asleep = several.Awake(models.probability.Constant(0.9), jnp.array(False))
    >>> print(asleep.prob(0, jnp.zeros(4), 1.0))
    0.0

`several_phd` and `several_cbmember` are trackers of such scans, in two forms:

* "iterated": the targets move and are born once, then each sensor updates in turn, in
  the order given, and what comes of it is reduced each time. The result depends on the
  order: each update assumes anew that targets are Poisson or independent.
* "product": what each sensor says about the targets is worked out from the prediction,
  as if it were alone, and then multiplied: of a PHD or CPHD filter for each group of
  components that share detections, of a CBMeMBer filter for each track. Only the
  reduction knows an order.

How far off they are, against Bayes' rule by enumeration: two sensors, up to two targets
near each other, two detections each, P_D 0.6 to 0.98, 60 random scenes
(`tests/test_several.py`). Root mean square errors of the expected number and of the
log-evidence; and, for 40 scenes, how much the number changes with the order.

                iterated                       product
                number   evidence   order      number   evidence
    PHD          0.16      0.22      0.27       0.07      0.14
    CPHD         0.04      0.09      0.06       0.05      0.12
    CBMeMBer     0.11      0.21      0.17       0.11      0.14    (balance="claims")

For one target at most CPHD is exact in both forms, and CBMeMBer in the product form.

There both sensors see everything. Where their fields of view differ, see
`scenarios.two_sensors` and docs/two_sensors.md.
"""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, likeliest
from jaxtrack.trackers import intensity
from jaxtrack.trackers.intensity import Birth
from jaxtrack.types import Array, PyTree, Scan, Scans, Tracker

Form = Literal["iterated", "product"]


class Sensor(NamedTuple):
    """One of several.

    Attributes:
        sensor: Of `models.sensor` or `models.converted`.
        detect: Probability of detection, of `models.probability`.
        clutter: Of `models.clutter`.
    """

    sensor: Any
    detect: Any
    clutter: Any


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        target: The `Params` of the target; its sensor and detection are not used.
        birth: As in `cbmember.Params`. Of `DetectionBirth` the sensors that looked and
            can locate have equal shares.
        sensors: S of them, in the order in which they update.
    """

    target: Any
    birth: Birth
    sensors: tuple[Sensor, ...]


class Awake(NamedTuple):
    """Detects as the model says if the sensor looked, and not at all if it did not.

    Attributes:
        detect: Of `models.probability`.
        looked: Whether it did (bool).
    """

    detect: Any
    looked: Array

    def prob(self, mode: Array, state: Array, interval: Array) -> Array:
        """Returns the probability of detection, a scalar."""
        return jnp.where(self.looked, self.detect.prob(mode, state, interval), 0.0)


def check(form: str) -> None:
    """Raises a ValueError for a form that does not exist."""
    if form not in ("iterated", "product"):
        raise ValueError(
            f'form is {form!r}; give "iterated" (sensor after sensor) or "product" '
            "(all from the prediction)"
        )


def split(params: Params, scans: Scans) -> list[tuple[intensity.Params, Scan]]:
    """Returns for each sensor the parameters and the scan of a tracker with only it."""
    pairs = []
    for k, (own, scan) in enumerate(zip(params.sensors, scans.each, strict=True)):
        looked = scans.looked[k]
        target = params.target._replace(
            sensor=own.sensor, detect=Awake(own.detect, looked)
        )
        clutter = own.clutter._replace(rate=jnp.where(looked, own.clutter.rate, 0.0))
        seen = scan._replace(valid=scan.valid & looked)
        pairs.append((intensity.Params(target, params.birth, clutter), seen))
    return pairs


def propose(
    birth: DetectionBirth,
    each: Sequence[tuple[intensity.Params, Scan]],
    scans: Scans,
    unexplained_prob: Sequence[Array],
    max_births: int,
) -> tuple[MultiBernoulliBirth, Array]:
    """Proposes births where sensors that can locate left detections unexplained.

    Args:
        birth: How likely, and how fast.
        each: Of `split`.
        scans: Of S sensors.
        unexplained_prob: Probability that no known target caused it, [K] for each.
        max_births: Places kept, the likeliest.

    Returns:
        `max_births` places, and the expected number of births that found no room.

    Raises:
        ValueError: None of the sensors can locate.
    """
    located = [
        k for k, (own, _) in enumerate(each) if hasattr(own.target.sensor, "locate")
    ]
    if not located:
        raise ValueError(
            "no sensor can locate a target from its detection; give births at known "
            "places, MultiBernoulliBirth or PoissonBirth"
        )
    num = jnp.maximum(scans.looked[jnp.array(located)].sum(), 1)
    shared = birth._replace(rate=birth.rate / num)
    places = []
    for k in located:
        own, scan = each[k]
        model, motion = own.target.sensor, own.target.layout
        seen = scan.detections, scan.valid, unexplained_prob[k]
        interval = scans.each[0].interval
        places.append(shared.propose(model, motion, *seen, interval))
    every = jax.tree.map(lambda *x: jnp.concatenate(x), *places)
    return likeliest(every, max_births)


def select(tracker: Tracker, order: tuple[int, ...]) -> Tracker:
    """Makes a tracker that is shown some of the sensors only, or in another order.

    Args:
        tracker: One of scans of several sensors.
        order: Which sensors, from 0; its parameters list them in this order.
    """

    def step(params: PyTree, state: PyTree, scans: Scans) -> tuple[PyTree, PyTree]:
        each = tuple(scans.each[k] for k in order)
        first = each[0]._replace(interval=scans.each[0].interval)
        looked = scans.looked[jnp.array(order)]
        return tracker.step(params, state, Scans((first, *each[1:]), looked))

    return Tracker(tracker.init, step)
