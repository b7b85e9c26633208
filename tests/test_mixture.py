"""Tests of jaxtrack.mixture: moments, pruning, merging, capping."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import mixture as book

from jaxtrack import mixture
from jaxtrack.types import Mixture

NUM, DIM = 8, 2
collapse = jax.jit(mixture.collapse)
prune, merge = jax.jit(mixture.prune), jax.jit(mixture.merge)
cap = jax.jit(mixture.cap, static_argnums=1)
reduce = jax.jit(mixture.reduce, static_argnums=1)
EMPTY = jnp.full(NUM, -jnp.inf, float)  # not weakly typed, so that nothing retraces


def random_mixture(seed, total=2.5, spread=1.5):
    """Eight components that weigh 2.5 together, of which the sixth slot is empty."""
    rng = np.random.default_rng(seed)
    weight = rng.dirichlet(np.ones(NUM)) * total
    weight[5] = 0
    root = rng.normal(size=(NUM, DIM, DIM))
    with np.errstate(divide="ignore"):
        log_weight = np.log(weight * total / weight.sum())
    return Mixture(
        log_weight=jnp.asarray(log_weight),
        mean=jnp.asarray(rng.normal(size=(NUM, DIM)) * spread),
        cov=jnp.asarray(root @ root.transpose(0, 2, 1) + 0.3 * np.eye(DIM)),
    )


def components_of(mix):
    """The filled slots as (w, m, P), heaviest first."""
    slots = zip(np.exp(mix.log_weight), mix.mean, mix.cov, strict=True)
    filled = [(w, np.array(m), np.array(P)) for w, m, P in slots if w > 0]
    return sorted(filled, key=lambda c: -c[0])


def assert_same(mix, expected):
    found = components_of(mix)
    expected = sorted(expected, key=lambda c: -c[0])
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        for x, y in zip(one, other, strict=True):
            np.testing.assert_allclose(x, y, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_collapse_has_the_moments_of_the_mixture(seed):
    mix = random_mixture(seed)
    mean, cov = book.moment_match(components_of(mix))
    belief = collapse(mix)
    np.testing.assert_allclose(belief.mean, mean, rtol=1e-12)
    np.testing.assert_allclose(belief.cov, cov, rtol=1e-12)


def test_moments_of_samples_are_those_of_the_collapse():
    """Against sampling, so that the reference is not the same formula again."""
    rng = np.random.default_rng(0)
    mix = random_mixture(1)
    weight = np.exp(mix.log_weight)
    chosen = rng.choice(NUM, size=200_000, p=weight / weight.sum())
    lower = np.linalg.cholesky(mix.cov)
    noise = rng.normal(size=(chosen.size, DIM))
    points = np.array(mix.mean)[chosen] + np.einsum("nij,nj->ni", lower[chosen], noise)
    belief = collapse(mix)
    np.testing.assert_allclose(points.mean(0), belief.mean, atol=0.02)
    np.testing.assert_allclose(np.cov(points.T), belief.cov, atol=0.05)


@pytest.mark.parametrize("threshold", [0.0, 0.05, 0.15])
@pytest.mark.parametrize("seed", range(4))
def test_prune_follows_the_book(seed, threshold):
    mix = random_mixture(seed)
    assert_same(prune(mix, threshold), book.prune(components_of(mix), threshold))


@pytest.mark.parametrize("threshold", [0.0, 0.5, 4.0, jnp.inf])
@pytest.mark.parametrize("seed", range(4))
def test_merge_follows_the_book(seed, threshold):
    mix = random_mixture(seed)
    assert_same(merge(mix, threshold), book.merge(components_of(mix), threshold))


@pytest.mark.parametrize("size", [1, 3, NUM + 4])
@pytest.mark.parametrize("seed", range(2))
def test_cap_follows_the_book(seed, size):
    mix = random_mixture(seed)
    capped, lost = cap(mix, size)
    expected, share = book.cap(components_of(mix), size)
    assert capped.mean.shape == (size, DIM)
    assert_same(capped, expected)
    np.testing.assert_allclose(lost, share, rtol=1e-9, atol=1e-15)
    order = np.array(capped.log_weight)
    assert (order[:-1] >= order[1:]).all()


@pytest.mark.parametrize("size", [2, 4, NUM + 2])
@pytest.mark.parametrize("seed", range(4))
def test_reduce_keeps_the_clusters_with_the_heaviest_leaders(seed, size):
    mix = random_mixture(seed)
    expected, share = book.reduce(components_of(mix), size, 0.04, 1.5)
    reduced, lost = reduce(mix, size, 0.04, 1.5)
    assert_same(reduced, expected)
    np.testing.assert_allclose(lost, share, rtol=1e-9, atol=1e-14)
    # In the order of their leaders, which is the order in which the book makes them.
    found = np.exp(reduced.log_weight)[: len(expected)]
    np.testing.assert_allclose(found, [w for w, _, _ in expected], rtol=1e-10)


def test_pruning_merging_and_capping_keep_the_weight():
    mix = random_mixture(0)
    results = (
        prune(mix, 0.1),
        merge(mix, 2.0),
        cap(mix, 2)[0],
        reduce(mix, 2, 0.1, 2.0)[0],
    )
    for result in results:
        np.testing.assert_allclose(jnp.exp(result.log_weight).sum(), 2.5, rtol=1e-12)


def test_merge_keeps_the_moments():
    mix = random_mixture(2)
    chex.assert_trees_all_close(collapse(merge(mix, 3.0)), collapse(mix), rtol=1e-10)


def test_merge_measures_with_the_covariance_of_the_one_that_joins():
    """A wide one joins a narrow leader from afar; a narrow one does not join a wide."""
    means = jnp.array([[0.0, 0.0], [4.0, 0.0]])
    covs = jnp.stack([jnp.eye(2), 9 * jnp.eye(2)])
    for heavy, clusters in ((0, 1), (1, 2)):
        weight = jnp.where(jnp.arange(2) == heavy, 0.8, 0.2)
        merged = merge(Mixture(jnp.log(weight), means, covs), 4.0)
        assert (merged.log_weight > -jnp.inf).sum() == clusters


@pytest.mark.parametrize(
    ("leader", "gap", "joins"),
    [(1.0, 1.5, True), (1.0, 2.5, False), (0.0, 0.0, True), (0.0, 1e-3, False)],
)
def test_a_point_is_measured_with_the_covariance_of_the_leader(leader, gap, joins):
    """The smaller component has no covariance along the second axis."""
    mean = jnp.array([[0.0, 0.0], [0.0, gap]])
    cov = jnp.stack([leader * jnp.eye(2), jnp.diag(jnp.array([1.0, 0.0]))])
    mix = Mixture(jnp.log(jnp.array([0.6, 0.4])), mean, cov)
    clusters = jax.jit(mixture.clusters, static_argnums=(2, 3))
    assert clusters(mix, 4.0, 2, True)[1] == 1 - joins
    assert clusters(mix, 4.0, 2, False)[1] == 1


def test_clusters_are_numbered_by_their_leaders_and_empty_slots_have_none():
    mix = random_mixture(0)
    clusters = jax.jit(mixture.clusters, static_argnums=2)
    all_in_one = clusters(mix, jnp.inf, NUM)
    assert all_in_one[5] == -1
    assert (jnp.delete(all_in_one, 5) == 0).all()
    heaviest_first = np.argsort(-np.array(mix.log_weight))
    alone = np.array(clusters(mix, 0.0, 3))[heaviest_first]
    np.testing.assert_array_equal(alone, [0, 1, 2, -1, -1, -1, -1, -1])


def test_empty_slots_may_hold_anything_finite():
    mix = random_mixture(3)
    other = mix._replace(
        mean=mix.mean.at[5].set(1e3), cov=mix.cov.at[5].set(jnp.eye(2))
    )
    chex.assert_trees_all_close(collapse(other), collapse(mix), rtol=1e-12)
    chex.assert_trees_all_close(
        reduce(other, 4, 0.04, 1.5), reduce(mix, 4, 0.04, 1.5), rtol=1e-12
    )


def test_an_empty_mixture_stays_empty_and_finite():
    mix = random_mixture(0)._replace(log_weight=EMPTY)
    first = jax.tree.map(lambda x: x[0], mix[1:])
    chex.assert_trees_all_close(tuple(collapse(mix)), first, rtol=1e-12)
    for result, lost in (cap(mix, 3), reduce(mix, 4, 0.04, 1.5)):
        assert (result.log_weight == -jnp.inf).all()
        chex.assert_tree_all_finite((result.mean, result.cov))
        assert lost == 0
    for result in (prune(mix, 0.05), merge(mix, 4.0)):
        assert (result.log_weight == -jnp.inf).all()
        chex.assert_tree_all_finite((result.mean, result.cov))


def test_normalise_and_total_take_any_scale():
    log_weight = jnp.array([-1000.0, -jnp.inf, -1001.0])
    odds = np.array([1.0, 0.0, np.exp(-1.0)])
    np.testing.assert_allclose(mixture.normalise(log_weight), odds / odds.sum())
    np.testing.assert_allclose(mixture.total(log_weight), -1000 + np.log(odds.sum()))
    assert mixture.total(EMPTY) == -jnp.inf
    np.testing.assert_array_equal(mixture.normalise(EMPTY[:3]), [1.0, 0.0, 0.0])


@jax.jit
@jax.value_and_grad
def loss(mix):
    """Something of every function that a tracker differentiates through."""
    reduced, lost = mixture.reduce(mix, 3, 0.04, 1.5)
    belief = mixture.collapse(reduced)
    weight = jnp.exp(reduced.log_weight)
    kept = jnp.exp(
        mixture.total(mixture.cap(mixture.prune(mix, 0.05), 3)[0].log_weight)
    )
    return (
        (weight * weight).sum()
        + belief.mean.sum()
        + (belief.cov**2).sum()
        + kept
        + lost
    )


def test_gradients_through_the_reduction_are_right():
    mix = random_mixture(1)
    rng = np.random.default_rng(0)
    slope = loss(mix)[1]
    for name in Mixture._fields:
        leaf = getattr(mix, name)
        step = jnp.asarray(rng.normal(size=leaf.shape)) * 1e-6
        ahead, behind = (
            loss(
                mix._replace(
                    **{name: jnp.where(leaf > -jnp.inf, leaf + s * step, leaf)}
                )
            )
            for s in (1, -1)
        )
        filled = jnp.where(leaf > -jnp.inf, step, 0.0)
        expected = (getattr(slope, name) * filled).sum()
        np.testing.assert_allclose(ahead[0] - behind[0], 2 * expected, rtol=1e-5)


@pytest.mark.parametrize("case", ["some empty", "all empty"])
def test_gradients_are_finite_with_empty_slots(case):
    mix = random_mixture(0)
    if case == "all empty":
        mix = mix._replace(log_weight=EMPTY)
    chex.assert_tree_all_finite(loss(mix)[1])


def test_reduce_batches_over_runs():
    mixes = [random_mixture(seed) for seed in range(4)]
    batch = jax.tree.map(lambda *x: jnp.stack(x), *mixes)
    together = jax.jit(jax.vmap(lambda mix: mixture.reduce(mix, 4, 0.04, 1.5)))(batch)
    for r, mix in enumerate(mixes):
        alone = reduce(mix, 4, 0.04, 1.5)
        chex.assert_trees_all_close(
            jax.tree.map(lambda x, r=r: x[r], together), alone, rtol=1e-10, atol=1e-12
        )


def test_float32_is_near_float64():
    mix = random_mixture(2)
    single = jax.tree.map(lambda x: x.astype(jnp.float32), mix)
    reduced = reduce(single, 4, 0.04, 1.5)
    assert {x.dtype for x in jax.tree.leaves(reduced)} == {jnp.dtype("float32")}
    chex.assert_trees_all_close(
        reduced,
        jax.tree.map(lambda x: x.astype(jnp.float32), reduce(mix, 4, 0.04, 1.5)),
        rtol=1e-4,
        atol=1e-5,
    )
