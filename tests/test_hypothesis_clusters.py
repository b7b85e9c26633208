"""Tests of `trackers.hypothesis_clusters`: small tables, by hand and by brute force."""

import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.trackers import cluster_search, hypothesis_clusters
from jaxtrack.trackers.verdict import Views

NONE = -np.inf
SPLIT = jax.jit(hypothesis_clusters.split, static_argnums=(1, 2, 3))
SEARCH = jax.jit(cluster_search.search, static_argnums=0)


def table(lists, labels):
    """Views of clusters, each a list of (probability, leaves)."""
    rows, num = max(len(x) for x in lists), len(labels)
    leaf, prob = np.full((rows, num), -1), np.zeros((rows, num))
    for lead, given in zip(sorted(set(labels)), lists, strict=True):
        for row, (share, leaves) in enumerate(given):
            mine = np.array(labels) == lead
            leaf[row, mine], prob[row, mine] = leaves, share
    with np.errstate(divide="ignore"):
        return Views(jnp.asarray(leaf), jnp.log(prob), jnp.array(labels, jnp.int32))


def listed(views, trees):
    """What each combination of leaves of some trees of one cluster weighs."""
    prob = np.exp(np.asarray(views.log_prob))[:, trees[0]]
    leaf = np.asarray(views.leaf)[:, trees]
    return {
        tuple(x.tolist()): p.item() for x, p in zip(leaf, prob, strict=True) if p > 0
    }


# Two trees that share a detection, one that is sure, and one that stands alone.
PAIR = [(0.5, (0, 1)), (0.3, (1, 0)), (0.2, (-1, 1))]
VIEWS = table(
    [[(p, (*x, 2)) for p, x in PAIR], [(0.6, (0,)), (0.4, (-1,))]], [0, 0, 0, 3]
)


def test_the_product_takes_the_heaviest_rows_of_all_lists():
    rng = np.random.default_rng(0)
    lists = -np.sort(-rng.normal(size=(30, 3, 7)), axis=2)
    lists[:, 1, 4:] = NONE
    log_weight, row = jax.jit(jax.vmap(hypothesis_clusters.product))(lists)
    for given, found, rows in zip(lists, log_weight, np.asarray(row), strict=True):
        every = itertools.product(*given)
        expected = sorted((sum(x) for x in every), reverse=True)[:7]
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        again = [sum(x[k] for x, k in zip(given, r, strict=True)) for r in rows]
        np.testing.assert_allclose(again, expected, rtol=1e-12)


def test_clusters_split_where_trees_tell_nothing_of_each_other():
    views, lost = SPLIT(VIEWS, 3, 0.0, 4)
    np.testing.assert_array_equal(views.label, [0, 0, 2, 3])
    assert lost == 0
    for trees, expected in {(0, 1): PAIR, (2,): [(1.0, (2,))]}.items():
        found = listed(views, list(trees))
        assert found.keys() == {x for _, x in expected}
        for share, leaves in expected:
            np.testing.assert_allclose(found[leaves], share, rtol=1e-12)
    assert (np.diff(np.exp(views.log_prob), axis=0) <= 0).all()


def test_what_is_split_for_want_of_room_keeps_its_marginals_and_says_so():
    views, lost = SPLIT(VIEWS, 3, 0.0, 1)
    np.testing.assert_array_equal(views.label, np.arange(4))
    first, second = listed(views, [0]), listed(views, [1])
    np.testing.assert_allclose([first[0,], first[1,], first[-1,]], [0.5, 0.3, 0.2])
    np.testing.assert_allclose([second[1,], second[0,]], [0.7, 0.3])
    # The second has its leaf 0 where the first has its leaf 1, and nowhere else.
    np.testing.assert_allclose(lost, 0.3 - 0.3 * 0.3, rtol=1e-12)


def test_joined_clusters_have_the_products_of_their_rows():
    wide = jax.tree.map(lambda x: jnp.pad(x, ((0, 4), (0, 0))), VIEWS[:2])
    log_prob = jnp.where(jnp.arange(7)[:, None] < 3, wide[1], NONE)
    views, _ = SPLIT(Views(wide[0], log_prob, VIEWS.label), 3, 0.0, 4)
    trees = jnp.array([0, 1, 3, 4, 4])
    joined, log_share = jax.jit(hypothesis_clusters.join)(views, trees)
    weight = np.exp(joined.log_weight)
    expected = {(*x, y): p * q for p, x in PAIR for q, y in [(0.6, 0), (0.4, -1)]}
    assert (joined.leaf[:, 3:] == -1).all()
    found = {
        tuple(x): p
        for x, p in zip(joined.leaf[:, :3].tolist(), weight, strict=True)
        if p > 0
    }
    assert found.keys() == expected.keys()
    for leaves, share in expected.items():
        np.testing.assert_allclose(found[leaves], share, rtol=1e-12)
    assert log_share == 0
    few = jax.tree.map(lambda x: x[:4], (views.leaf, views.log_prob))
    joined, log_share = jax.jit(hypothesis_clusters.join)(
        Views(*few, views.label), trees
    )
    kept = sorted(expected.values())[-4:]
    np.testing.assert_allclose(np.exp(log_share), sum(kept), rtol=1e-12)
    np.testing.assert_allclose(np.exp(joined.log_weight).sum(), 1, rtol=1e-12)


def events(views, log_score, log_first, lists, items):
    """All that can become of some clusters and detections: weights by codes."""
    last = log_score.shape[2] - 1
    found = {}
    for rows in itertools.product(*(listed(views, trees).items() for trees in lists)):
        leaves = [x for leaves, _ in rows for x in leaves]
        prior = math.prod(p for _, p in rows)
        trees = [x for trees in lists for x in trees]
        for columns in itertools.product([*items, last], repeat=len(trees)):
            taken = [k for k in columns if k < last]
            gone = [x < 0 and k < last for x, k in zip(leaves, columns, strict=True)]
            if len(set(taken)) < len(taken) or any(gone):
                continue
            steps = list(zip(trees, leaves, columns, strict=True))
            score = sum(log_score[n, x, k] for n, x, k in steps if x >= 0)
            codes = [x * (last + 1) + k if x >= 0 else -1 for _, x, k in steps]
            free = [k for k in items if k not in taken]
            for new in itertools.product([False, True], repeat=len(free)):
                begun = {k for k, there in zip(free, new, strict=True) if there}
                weight = prior * np.exp(score + sum(log_first[k] for k in begun))
                leaf = [0 if k in begun else -1 for k in items]
                found[*codes, *leaf] = weight
    return {x: p for x, p in found.items() if p > 0}


@pytest.mark.parametrize("pair_is_detected", [True, False])
def test_a_search_finds_all_events_of_each_cluster(pair_is_detected):
    """One detection is the pair's alone, one its or another's, and one nobody's."""
    rng = np.random.default_rng(3)
    log_score = rng.normal(size=(4, 3, 4))
    possible = np.zeros((4, 4), bool)
    possible[:, 3] = True
    possible[:2, :2] = pair_is_detected
    possible[2 + pair_is_detected, 1] = True
    log_score = np.where(possible[:, None], log_score, NONE)
    log_first = np.array([-0.5, 0.3, 0.2])
    wide = jax.tree.map(
        lambda x, fill: jnp.pad(x, ((0, 157), (0, 0)), constant_values=fill),
        (VIEWS.leaf, VIEWS.log_prob),
        (-1, NONE),
    )
    views, _ = SPLIT(Views(*wide, VIEWS.label), 3, 0.0, 4)
    room = cluster_search.Room(99, 2, 3, 2)
    found = SEARCH(room, views, jnp.asarray(log_score), jnp.asarray(log_first))
    groups = [([(2,)], []), ([(0, 1), (3,)], [0, 1]), ([], [2])]
    if not pair_is_detected:
        groups = [([(0, 1)], []), ([(2,)], [1]), ([(3,)], []), ([], [0]), ([], [2])]
    both = jax.tree.map(
        lambda x, y: jnp.concatenate([x, y], -1), found.views, found.begun
    )
    for lists, items in groups:
        given = [list(x) for x in lists]
        expected = events(views, log_score, log_first, given, items)
        columns = [n for x in given for n in x] + [4 + k for k in items]
        told = listed(both, columns)
        assert told.keys() == expected.keys()
        for codes, weight in expected.items():
            np.testing.assert_allclose(told[codes], weight, rtol=1e-12)
        total = np.log(sum(expected.values()))
        np.testing.assert_allclose(found.log_total[jnp.array(columns)], total)
    assert found.cut == 0


def components(linked):
    """Clusters of trees, plainly."""
    label = np.arange(len(linked))
    for _ in linked:
        for i, j in itertools.product(range(len(linked)), repeat=2):
            if (linked[i] & linked[j]).any():
                label[i] = label[j] = min(label[i], label[j])
    return label


def test_clusters_fit_and_only_those_too_large_are_cut():
    rng = np.random.default_rng(1)
    strength = rng.random((40, 9, 7)) ** 3 * (rng.random((40, 9, 7)) < 0.2)
    fit = jax.jit(
        jax.vmap(
            functools.partial(
                hypothesis_clusters.fit, least=0.0, max_trees=3, max_items=2
            )
        )
    )
    whole = set()
    for given, kept, label in zip(
        strength, *map(np.asarray, fit(strength)), strict=True
    ):
        np.testing.assert_array_equal(label, components(kept))
        assert not (kept & (given <= 0)).any()
        before = components(given > 0)
        for lead in set(before.tolist()):
            mine = before == lead
            items = (given[mine] > 0).any(0).sum()
            fits = mine.sum() <= 3 and items <= 2
            whole.add(fits)
            if fits:
                np.testing.assert_array_equal(kept[mine], given[mine] > 0)
            else:
                assert (kept[mine] != (given[mine] > 0)).any()
                gone = given[mine][(given[mine] > 0) & ~kept[mine]]
                assert gone.min() <= given[mine][kept[mine]].min(initial=1.0)
        for lead in set(label.tolist()):
            assert (label == lead).sum() <= 3
            assert kept[label == lead].any(0).sum() <= 2
    assert whole == {True, False}


def test_where_clusters_have_no_room_the_least_likely_detections_are_cut():
    """Two trees that share a detection, far from one with two of its own."""
    views = table([[(1.0, (0,))]] * 3, [0, 1, 2])
    odds = [[0.0, 9.0, 0.0, 1.0], [1e-3, 2.0, 0.0, 1.0], [0.0, 0.0, 4.0, 1.0]]
    with np.errstate(divide="ignore"):
        log_score = jnp.asarray(np.log(odds))[:, None]

    def planned(*room):
        return jax.jit(cluster_search.plan, static_argnums=0)(
            cluster_search.Room(1, *room), views, log_score
        )

    plan = planned(3, 2, 2)
    np.testing.assert_array_equal(plan.of_tree, [0, 0, 2])
    np.testing.assert_array_equal(plan.of_item, [0, 0, 2])
    assert plan.cut == 0
    plan = planned(3, 2, 1)
    np.testing.assert_array_equal(plan.of_item, [3, 0, 2])
    np.testing.assert_allclose(plan.cut, 1e-3 / 3.001, rtol=1e-12)
    plan = planned(1, 2, 2)  # the pair expects more detections
    np.testing.assert_array_equal(plan.of_item, [0, 0, 5])
    np.testing.assert_allclose(plan.cut, 0.8, rtol=1e-12)
    plan = planned(3, 1, 2)
    np.testing.assert_array_equal(plan.of_tree, [0, 1, 2])
    np.testing.assert_array_equal(plan.of_item, [3, 0, 2])
    np.testing.assert_allclose(plan.cut, 2.001 / 3.001, rtol=1e-12)
