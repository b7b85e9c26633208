"""Tests of `assign.multiscan.beam` against enumeration of all selections.

Sums of scores of order ten may be zero, so bounds on them are absolute.
"""

import functools

import jax
import numpy as np
import pytest
from reference import multiscan as reference

from jaxtrack.assign.multiscan import beam, problem

INF = np.inf
SHAPE = 4, 4, 2, 5  # trees, leaves, scans, detections
SLOPED = 3  # a width that is differentiated
K = SHAPE[-1]


@functools.cache
def drawn(rounded=False, count=80):
    """Random problems, and all their selections."""
    rng = np.random.default_rng(5)
    pairs = [reference.draw(rng, *SHAPE, rounded=rounded) for _ in range(count)]
    listed = [dict(reference.selections(*pair)) for pair in pairs]
    whole = problem.Problem(*(np.array(x) for x in zip(*pairs, strict=True)))
    return whole, listed


@functools.cache
def many(width):
    """(problem) -> slopes of the sums in all scores, and everything that is told."""

    def told(log_score, detection):
        found = beam.beam(problem.Problem(log_score, detection), K, width)
        every = beam.together(found)
        return every.log_score, (found, every, beam.leaf_prob(found, SHAPE[1]))

    if width == SLOPED:
        return jax.jit(jax.vmap(jax.jacrev(told, has_aux=True)))
    return jax.jit(jax.vmap(told))


def clusters(log_score, detection):
    """The first tree of each tree's cluster, by loops until nothing changes."""
    wanted = [
        {
            (s, k)
            for leaf in np.flatnonzero(np.isfinite(row))
            for s, k in enumerate(detection[n, leaf])
            if k >= 0
        }
        for n, row in enumerate(log_score)
    ]
    labels = list(range(len(wanted)))
    for _ in labels:
        for n, one in enumerate(wanted):
            for m, other in enumerate(wanted):
                if one & other:
                    labels[n] = labels[m] = min(labels[n], labels[m])
    return labels


def test_labels_are_those_of_trees_that_share_detections():
    whole, _ = drawn()
    found = jax.jit(jax.vmap(lambda x: problem.label(x, K)))(whole)
    for k, labels in enumerate(np.asarray(found).tolist()):
        assert labels == clusters(whole.log_score[k], whole.detection[k])


@pytest.mark.parametrize("rounded", [False, True], ids=["distinct", "tied"])
def test_wide_enough_it_is_enumeration(rounded):
    whole, listed = drawn(rounded)
    lists, found, prob = jax.tree.map(np.asarray, many(256)(*whole)[1])
    assert (lists.log_lost == -INF).all()
    for k, known in enumerate(listed):
        expected = np.sort(list(known.values()))[::-1]
        there = found.log_score[k] > -INF
        assert there.sum() == min(len(expected), 256)
        np.testing.assert_allclose(
            found.log_score[k][there], expected[:256], atol=1e-12
        )
        leaves = [tuple(x) for x in found.leaf[k][there].tolist()]
        assert len(set(leaves)) == len(leaves)
        totals = [known[x] for x in leaves]
        np.testing.assert_allclose(totals, expected[:256], atol=1e-12)
        exact = np.zeros(SHAPE[:2])
        weight = np.exp(np.array(list(known.values())))
        for leaf, one in zip(known, weight, strict=True):
            for n, chosen in enumerate(leaf):
                if chosen >= 0:
                    exact[n, chosen] += one / weight.sum()
        if len(known):
            np.testing.assert_allclose(prob[k], exact, atol=1e-12)


@pytest.mark.parametrize("width", [1, 3, 10])
def test_what_is_left_out_is_not_above_its_bound(width):
    whole, listed = drawn()
    _, found, _ = jax.tree.map(np.asarray, many(width)(*whole)[1])
    surely = 0
    for k, known in enumerate(listed):
        there = found.log_score[k] > -INF
        leaves = {tuple(x) for x in found.leaf[k][there].tolist()}
        for leaf in leaves:
            assert leaf in known
        rest = [total for leaf, total in known.items() if leaf not in leaves]
        assert max(rest, default=-INF) <= found.log_lost[k] + 1e-9
        expected = np.sort(list(known.values()))[::-1][:width]
        sure = found.log_score[k] > found.log_lost[k] + 1e-9
        surely += sure.sum()
        assert sure[: sure.sum()].all()
        np.testing.assert_allclose(
            found.log_score[k][sure], expected[: sure.sum()], atol=1e-12
        )
        assert (np.diff(found.log_score[k][there]) <= 1e-12).all()
    assert surely > 20


def test_every_cluster_has_its_own_list():
    whole, _ = drawn()
    lists, _, _ = jax.tree.map(np.asarray, many(10)(*whole)[1])
    for k, labels in enumerate(lists.label):
        for first in set(labels.tolist()):
            mine = labels == first
            score, detection = whole.log_score[k][mine], whole.detection[k][mine]
            known = dict(reference.selections(score, detection))
            there = lists.log_score[k][:, first] > -INF
            for leaf, total in zip(
                lists.leaf[k][there][:, mine].tolist(),
                lists.log_score[k][there][:, mine],
                strict=True,
            ):
                np.testing.assert_allclose(total, known[tuple(leaf)], atol=1e-12)


def test_gradient_is_that_of_the_chosen_scores():
    """In every problem; what is not there has none."""
    whole, _ = drawn()
    slope, (_, found, _) = jax.tree.map(np.asarray, many(SLOPED)(*whole))
    there = found.log_score > -INF
    assert there.sum() > 100
    leaf = np.where(there[..., None], found.leaf, -1)
    expected = leaf[..., None] == np.arange(SHAPE[1])
    np.testing.assert_array_equal(slope, expected)


def test_no_width_is_refused():
    whole, _ = drawn()
    with pytest.raises(ValueError, match="width is 0; give at least 1"):
        beam.beam(jax.tree.map(lambda x: x[0], whole), K, 0)
