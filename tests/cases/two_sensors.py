"""Targets on a line that two sensors see: one scan, every target a birth."""

import functools
import math
from typing import NamedTuple

import jax
import numpy as np
from cases.lines import scans_of
from reference import several as book

from jaxtrack.models import birth, clutter, motion, probability, sensor
from jaxtrack.targets import single
from jaxtrack.trackers import (
    cbmember,
    cphd,
    phd,
    several,
    several_cbmember,
    several_phd,
)
from jaxtrack.types import Scans

LOW, HIGH, NUM, SLOTS = -10.0, 10.0, 2, 2
MANY = 60
KEY = np.array(jax.random.key_data(jax.random.key(0)))
FORMS = "iterated", "product"
TARGET = single.single()
INTENSE = {"max_components": 30, "prune_threshold": 0.0, "merge_threshold": 1e-12}
TRACKS = {"max_tracks": 20, "max_parents": 4, "prune_threshold": 0.0}


class Scene(NamedTuple):
    """What is where: r, mean and variance [NUM]; detect, std, rate and z by sensor."""

    r: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    detect: tuple
    std: tuple
    rate: tuple
    z: tuple


def scene(rng, targets=NUM, count=2, detect=(0.6, 0.98), rate=(0.3, 3.0)):
    """Each sensor has `count` detections, most of them of targets."""
    mean = rng.uniform(-4, 4) + 2.0 * rng.normal(size=NUM)
    r = np.where(np.arange(NUM) < targets, rng.uniform(0.1, 0.95, NUM), 0.0)
    z = []
    for _ in range(2):
        near = mean[rng.integers(0, max(targets, 1), count)] + rng.normal(size=count)
        far = rng.uniform(LOW, HIGH, count)
        z.append(np.where(rng.random(count) < 0.7, near, far).clip(LOW, HIGH))
    pairs = (tuple(rng.uniform(*x, 2)) for x in (detect, (0.4, 0.9), rate))
    return Scene(r, mean, rng.uniform(0.2, 1.0, NUM), *pairs, tuple(z))


def sensors_of(scene):
    """As `reference.several.update` wants them."""
    box = HIGH - LOW
    values = zip(scene.detect, scene.std, scene.rate, scene.z, strict=True)
    return [(d, s**2, c / box, c, z) for d, s, c, z in values]


def clutter_of(rate):
    return clutter.UniformClutter(np.array(rate), np.array([LOW]), np.array([HIGH]))


def params_of(scene, which=(0, 1)):
    """With the sensors `which`, in this order."""
    own = [
        several.Sensor(
            sensor.Position(np.array([scene.std[k]])),
            probability.Constant(np.array(scene.detect[k])),
            clutter_of(scene.rate[k]),
        )
        for k in which
    ]
    target = single.Params(
        motion=motion.ConstantVelocity(np.array([1.0])),
        sensor=own[0].sensor,
        survive=probability.Constant(np.array(0.9)),
        detect=own[0].detect,
    )
    births = birth.MultiBernoulliBirth(
        existence_prob=np.array(scene.r),
        mean=np.stack([scene.mean, np.zeros(NUM)], 1),
        cov=np.stack([np.diag([v, 1.0]) for v in scene.variance]),
        mode_prob=np.ones((NUM, 1)),
    )
    return several.Params(target, births, tuple(own))


def alone(params):
    """For the tracker with the first sensor only."""
    return cbmember.Params(params.target, params.birth, params.sensors[0].clutter)


def poisson(params):
    """With as many births at a place as there are."""
    return params._replace(birth=birth.PoissonBirth(*params.birth))


def scans_at(scene, which=(0, 1), looked=(True, True)):
    """One scan of each of the sensors `which`, without a leading axis."""
    each = [scans_of([scene.z[k]], SLOTS, 1.0) for k in which]
    first = tuple(jax.tree.map(lambda x: x[0], one) for one in each)
    return Scans(first, np.array([looked[k] for k in which]))


@functools.cache
def maker(name, form=None):
    """A tracker with several sensors, or with one if there is no form."""
    own = {"form": form} if form else {}
    if name == "phd":
        return (several_phd.several_phd if form else phd.phd)(TARGET, **own, **INTENSE)
    if name == "cphd":
        make = several_phd.several_cphd if form else cphd.cphd
        return make(TARGET, **own, **INTENSE, max_targets=8)
    make = several_cbmember.several_cbmember if form else cbmember.cbmember
    return make(TARGET, **own, **TRACKS, balance="claims")


@functools.cache
def program(name, form=None):
    """(params, scan) -> estimate and slopes of its evidence, for many scenes."""
    tracker = maker(name, form)

    def evidence(params, scan):
        state = tracker.init(params, jax.random.wrap_key_data(KEY))
        estimate = tracker.step(params, state, scan)[1]
        return estimate.log_evidence, estimate

    slope = jax.value_and_grad(evidence, has_aux=True)
    many = jax.jit(jax.vmap(slope if form else lambda *x: (evidence(*x), None)))

    def by_blocks(params, scans):
        """Always as many at once, so that it is compiled once."""
        num = len(scans.each[0].valid if form else scans.valid)
        found = []
        for first in range(0, num, MANY):
            index = np.minimum(np.arange(first, first + MANY), num - 1)
            block = jax.tree.map(lambda x, i=index: x[i], (params, scans))
            found.append(jax.tree.map(np.asarray, many(*block)))
        return jax.tree.map(lambda *x: np.concatenate(x)[:num], *found)

    return by_blocks


def stacked(many):
    return jax.tree.map(lambda *x: np.stack(x), *many)


def given(name, scenes, which=(0, 1), looked=(True, True)):
    """Parameters and scans of many scenes, stacked."""
    params = [params_of(one, which) for one in scenes]
    if name == "phd":
        params = [poisson(one) for one in params]
    return stacked(params), stacked([scans_at(one, which, looked) for one in scenes])


def answers(name, form, scenes, which=(0, 1), looked=(True, True)):
    """Estimates of many scenes, NumPy."""
    params, scans = given(name, scenes, which, looked)
    if form is None:
        params, scans = alone(params), scans.each[0]
    (_, found), _ = program(name, form)(params, scans)
    return jax.tree.map(np.array, found)


def exactly(name, scenes):
    """Log-evidence and expected number by enumeration, each [R]."""
    found = []
    for one in scenes:
        sensors = sensors_of(one)
        places = zip(one.mean, one.variance, strict=True)
        tables = [book.table(m, v, sensors) for m, v in places]
        total, share = one.r.sum(), one.r / one.r.sum()
        if name == "phd":  # cut off at four
            numbers = range(5)
            p = [total**n * math.exp(-total) / math.factorial(n) for n in numbers]
        else:
            p = [np.prod(1 - one.r), 0.0, np.prod(one.r)]
            p[1] = 1 - p[0] - p[2]
        prior = book.identical(p, share, tables)
        if name == "cbmember":
            prior = book.independent(one.r, tables)
        found.append(book.update(prior, sensors))
    number = np.arange(10)
    return np.array([(np.log(e), p @ number) for e, p in found]).T
