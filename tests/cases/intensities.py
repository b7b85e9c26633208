"""Random intensities and scans, as the library takes them and as the plain filters do.

One axis, two modes where the target has any. A scene is (params, components, number,
scan), and all the library's answers to many scenes come of one compiled call.
"""

import functools
import math
from typing import Any, NamedTuple

import jax
import numpy as np
from reference import kalman, sets
from reference import phd as book

from jaxtrack.models import birth, clutter, motion, probability, sensor, switching
from jaxtrack.targets import components as several
from jaxtrack.targets import imm, mixture, single
from jaxtrack.trackers import cphd, intensity, phd
from jaxtrack.types import Gaussian, Mixture, Scan

COMPONENTS, DETECTIONS, NUMBERS = 4, 4, 6
LOW, HIGH, STD, PARTS = -10.0, 10.0, 0.6, 2
TARGETS = {
    "single": single.single(),
    "imm": imm.imm(),
    "mixture": mixture.mixture(PARTS, prune_threshold=0.0, merge_threshold=0.0),
}
MODES = {"single": 1, "imm": 2, "mixture": 2}


class Scene(NamedTuple):
    params: Any
    components: intensity.Components
    log_number: Any
    scan: Scan


def params_of(name, detect, rate):
    """Nothing moves here: a scan is nothing but its update."""
    still = motion.ConstantVelocity(np.array([1.0]))
    place, sure = sensor.Position(np.array([STD])), probability.Constant(np.array(1.0))
    if name == "single":
        seen = probability.Constant(np.array(detect[0]))
        target = single.Params(still, place, sure, seen)
    else:
        seen = probability.PerMode(np.array(detect))
        chain = switching.MarkovSwitching(np.eye(2))
        target = imm.Params((still, still), chain, place, sure, seen)
    modes = MODES[name]
    nowhere = birth.PoissonBirth(
        np.zeros(1), np.zeros((1, 2)), np.eye(2)[None], np.full((1, modes), 1 / modes)
    )
    box = clutter.UniformClutter(np.array(rate), np.array([LOW]), np.array([HIGH]))
    return intensity.Params(target, nowhere, box)


def beliefs(rng, name):
    """The beliefs of all components, one of whose modes may be empty."""
    shape = {
        "single": (COMPONENTS,),
        "imm": (COMPONENTS, 2),
        "mixture": (COMPONENTS, 2, PARTS),
    }[name]
    mean = rng.uniform(-4, 4, (*shape, 2))
    root = rng.normal(size=(*shape, 2, 2))
    cov = root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(2)
    if name == "single":
        return Gaussian(mean, cov)
    share = rng.dirichlet(np.ones(shape[1:]).ravel(), COMPONENTS).reshape(shape)
    log_share = np.log(share)
    if name == "imm":
        return Mixture(log_share, mean, cov)
    return several.Belief(log_share, mean, cov, np.zeros(COMPONENTS))


def scene(rng, name, detect, rate, count):
    """The last component is an empty slot; `count` detections, not the first slots."""
    log_weight = np.log(rng.uniform(0.05, 1.5, COMPONENTS))
    log_weight[-1] = -np.inf
    log_number = np.log(rng.dirichlet(np.ones(NUMBERS)))
    log_number[1] = -np.inf
    valid = np.zeros(DETECTIONS, bool)
    valid[rng.permutation(DETECTIONS)[:count]] = True
    detections = rng.uniform(-5, 5, (DETECTIONS, 1))
    return Scene(
        params_of(name, detect, rate),
        intensity.Components(log_weight, beliefs(rng, name), np.arange(COMPONENTS)),
        log_number,
        Scan(detections, valid, np.array(1.0)),
    )


def scenes(name, seed=0):
    """Every number of detections, with detection rare, usual, sure and impossible."""
    rng = np.random.default_rng(seed)
    made = []
    for detect in ((0.9, 0.6), (0.3, 0.95), (1.0, 1.0), (0.0, 0.0)):
        for count in range(DETECTIONS + 1):
            made.append(scene(rng, name, detect, rng.uniform(0.5, 5), count))
    return made


@functools.cache
def update(name, which):
    """(scene) -> update, number, corrected [N, K] of a "phd" or a "cphd" filter."""
    target = TARGETS[name]

    def one(scene):
        if which == "phd":
            found, number = phd.update(target, *scene[:2], scene.scan), scene.log_number
        else:
            found, number = cphd.update(target, *scene)
        correct = jax.vmap(target.correct, (None, None, 0))
        correct = jax.vmap(correct, (None, 0, None))
        hits = correct(scene.params.target, found.views, scene.scan.detections)
        return found._replace(views=None), number, hits

    return jax.jit(jax.vmap(one))


def answers(name, which, given):
    """What the library says of each of many scenes, as NumPy."""
    batch = jax.tree.map(lambda *x: np.stack(x), *given)
    found = jax.tree.map(np.asarray, update(name, which)(batch))
    return [jax.tree.map(lambda x, i=i: x[i], found) for i in range(len(given))]


def pairs(name, scene):
    """A component for each part of each belief, and whose part each of them is."""
    belief, weight = scene.components.belief, np.exp(scene.components.log_weight)
    flat, owner = [], []
    for n in range(COMPONENTS):
        if name == "single":
            flat.append((weight[n], belief.mean[n], belief.cov[n], 0))
            owner.append((n,))
            continue
        share = np.exp(belief.log_weight[n])
        for part in np.ndindex(share.shape):
            m, P = belief.mean[n][part], belief.cov[n][part]
            flat.append((weight[n] * share[part], m, P, part[0]))
            owner.append((n, *part))
    return flat, owner


def plain(name, scene):
    """What the plain filters take: model, clutter, components, p, detections."""
    modes = MODES[name]
    detect = np.broadcast_to(scene.params.target.detect.value, modes)
    still = [np.eye(2)] * modes
    sensor_of = np.array([[1.0, 0.0]]), np.array([[STD**2]])
    model = book.Model(still, still, *sensor_of, np.eye(modes), np.ones(modes), detect)
    box = book.Clutter(float(scene.params.clutter.rate), lambda z: 1 / (HIGH - LOW))
    detections = list(scene.scan.detections[scene.scan.valid])
    return model, box, pairs(name, scene)[0], np.exp(scene.log_number), detections


def check_weights(name, scene, found, missed, hits):
    """Weights of the library are those of the plain filter, part by part summed up."""
    owner = pairs(name, scene)[1]
    expected = np.zeros((COMPONENTS, 1 + len(hits)))
    left, seen = book.weights(missed, hits)
    for part, weight in zip(owner, np.column_stack([left, seen]), strict=True):
        expected[part[0]] += weight
    valid = scene.scan.valid
    weights = np.column_stack([found.log_missed, found.log_hit[:, valid]])
    # An absolute bound, too: what is impossible is exactly zero here, and zero but for
    # the rounding of sums of about one in the plain filter.
    np.testing.assert_allclose(np.exp(weights), expected, rtol=1e-10, atol=1e-14)
    assert np.isneginf(found.log_hit[:, ~valid]).all()


def check_beliefs(name, scene, found, corrected, missed, hits):
    """So are the beliefs: moments, and shares of the parts."""
    owner = pairs(name, scene)[1]
    rows = [(found.missed, missed, None)]
    valid = np.flatnonzero(scene.scan.valid)
    rows += [(corrected, hit, k) for k, hit in zip(valid, hits, strict=True)]
    for beliefs_found, plain_parts, k in rows:
        totals = np.zeros(COMPONENTS)
        for part, (w, *_) in zip(owner, plain_parts, strict=True):
            totals[part[0]] += w
        for part, (w, m, P, _) in zip(owner, plain_parts, strict=True):
            if not totals[part[0]] > 0:
                continue
            place = part if k is None else (part[0], k, *part[1:])
            np.testing.assert_allclose(beliefs_found.mean[place], m, rtol=1e-9)
            np.testing.assert_allclose(beliefs_found.cov[place], P, rtol=1e-9)
            if len(part) > 1:
                share = np.exp(beliefs_found.log_weight[place])
                np.testing.assert_allclose(share, w / totals[part[0]], rtol=1e-9)


def by_enumeration(scene, p):
    """Bayes' rule for the components of a "single" scene, cut off at len(p) - 1."""
    model, clutter, flat, _, detections = plain("single", scene)
    flat = [part for part in flat if part[0] > 0]
    weight = np.array([w for w, *_ in flat])
    g = np.zeros((len(flat), len(detections)))
    for i, (_, m, P, _) in enumerate(flat):
        for k, z in enumerate(detections):
            g[i, k] = math.exp(kalman.update(m, P, model.H, 0, model.R, z)[2])
    false = np.full(len(detections), clutter.rate * clutter.density(None))
    detect = np.full(len(flat), model.detect[0])
    return sets.update(p, weight / weight.sum(), detect, g, false, clutter.rate)
