"""k-means against plain loops, and PHD filters that extract by it."""

import functools

import jax
import numpy as np
import pytest
from cases.trackers import line_births, line_clutter, random_scans, two_mode_params

from jaxtrack.targets import imm, particles, single
from jaxtrack.trackers import clustering, cphd, intensity, phd
from jaxtrack.types import Gaussian


def plain_kmeans(weight, place, count, steps):
    """Seeds where most weight is farthest, then Lloyd's iteration."""
    mean = weight @ place / weight.sum()
    nearest = ((place - mean) ** 2).sum(1)
    centres = []
    for _ in range(count):
        centres.append(place[np.argmax(weight * nearest)].copy())
        nearest = np.minimum(nearest, ((place - centres[-1]) ** 2).sum(1))
    for _ in range(steps + 1):
        cluster = [
            int(np.argmin([((x - c) ** 2).sum() for c in centres])) for x in place
        ]
        for c in range(count):
            mine = [i for i in range(len(place)) if cluster[i] == c and weight[i] > 0]
            if mine:
                centres[c] = weight[mine] @ place[mine] / weight[mine].sum()
    return np.where(weight > 0, cluster, -1)


@pytest.mark.parametrize("count", [1, 3, 5])
def test_kmeans_is_that_of_plain_loops(count):
    rng = np.random.default_rng(count)
    places = rng.normal(size=(20, 30, 2)) * 3
    weights = rng.uniform(size=(20, 30)) * (rng.random((20, 30)) < 0.8)
    run = jax.jit(jax.vmap(lambda w, x: clustering.kmeans(w, x, count, 5)))
    with np.errstate(divide="ignore"):
        found = run(np.log(weights), places)
    for weight, place, cluster in zip(weights, places, found, strict=True):
        expected = plain_kmeans(weight, place, count, clustering.NUM_STEPS)
        np.testing.assert_array_equal(cluster, expected)


def test_blobs_are_found_and_nothing_is_in_no_cluster():
    rng = np.random.default_rng(0)
    blob = np.repeat(np.arange(4), 25)
    centre = np.array([[0.0, 0.0], [50.0, 0.0], [0.0, 50.0], [50.0, 50.0]])
    place = centre[blob] + rng.normal(size=(100, 2))
    kmeans = jax.jit(clustering.kmeans, static_argnums=3)
    found = np.array(kmeans(np.zeros(100), place, 4, 6))
    assert len({(a, b) for a, b in zip(blob, found, strict=True)}) == 4
    assert (np.array(kmeans(np.zeros(100), place, 0, 6)) == -1).all()
    empty = kmeans(np.full(100, -np.inf), place, 4, 6)
    assert (np.array(empty) == -1).all()


def test_the_report_of_one_gaussian_a_target_is_each_component():
    """Far apart, each cluster is one component: its moments, weight and label."""
    mean = np.array([[0.0, 1.0], [100.0, -1.0], [-70.0, 2.0], [0.0, 0.0]])
    cov = np.tile(np.diag([4.0, 1.0]), (4, 1, 1))
    log_weight = np.log(np.array([0.9, 0.8, 0.7, 1e-12]))
    log_weight[3] = -np.inf
    some = intensity.Components(log_weight, Gaussian(mean, cov), np.arange(7, 11))
    rest = 2.0, -1.0, 0.0, 20
    report = functools.partial(clustering.report, single.single(), (0,))
    _, told, label = jax.jit(report)(some, 3, *rest)
    order = np.argsort(np.array(told.label)[np.array(told.exists)])
    there = np.flatnonzero(told.exists)[order]
    assert label == 20
    np.testing.assert_array_equal(told.label[there], [7, 8, 9])
    np.testing.assert_allclose(told.mean[there], mean[:3], rtol=1e-12)
    np.testing.assert_allclose(told.cov[there], cov[:3], rtol=1e-12)
    np.testing.assert_allclose(told.existence_prob[there], [0.9, 0.8, 0.7], rtol=1e-12)


@pytest.mark.parametrize(
    ("maker", "target"),
    [(phd.phd, particles.particles(300)), (cphd.cphd, imm.imm())],
    ids=["phd-particles", "cphd-imm"],
)
def test_clusters_are_where_the_components_are(maker, target):
    """Two targets far apart on a line: as many as are expected, near the components."""
    params = phd.Params(two_mode_params(), line_births(2), line_clutter())
    scans = random_scans("cbmember_imm", 0)
    partition = "detections"
    told = {}
    for extract in ("components", "clusters"):
        tracker = maker(target, max_components=8, partition=partition, extract=extract)

        def run(scans, tracker=tracker):
            state = tracker.init(params, jax.random.key(0))
            return jax.lax.scan(functools.partial(tracker.step, params), state, scans)[
                1
            ]

        told[extract] = jax.jit(run)(scans)
    one, other = told["components"], told["clusters"]
    assert other.exists.sum() >= 6
    for t in range(len(one.exists)):
        if one.exists[t].sum() == other.exists[t].sum() == 2:
            place, centre = (
                np.sort(np.array(x.mean[t, np.array(x.exists[t]), 0]))
                for x in (one, other)
            )
            # Metres: a cluster takes in what light components lie about (noise 1.2 m).
            np.testing.assert_allclose(centre, place, atol=3.0)
    assert (one.exists.sum(1) == other.exists.sum(1)).sum() >= 4
