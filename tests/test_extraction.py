"""What of an intensity is reported, under which label, and what is lost on the way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.trackers import single_params, two_mode_params

from jaxtrack.targets import mixture, single
from jaxtrack.trackers import cphd, extraction, intensity, phd, reduction
from jaxtrack.types import Gaussian, Scan

above, tell_apart = jax.jit(extraction.above), jax.jit(extraction.tell_apart)
heaviest = jax.jit(extraction.heaviest)

HIT = Scan(jnp.zeros((1, 1)), jnp.ones(1, bool), jnp.ones(()))


def components(*weights, label=None):
    with np.errstate(divide="ignore"):
        log_weight = jnp.array(np.log(weights))
    num = len(weights)
    label = jnp.arange(num) if label is None else jnp.array(label)
    place = Gaussian(10.0 * jnp.arange(num)[:, None], jnp.ones((num, 1, 1)))
    return intensity.Components(log_weight, place, label)


def test_a_component_is_reported_as_often_as_it_stands_for_targets():
    some = components(0.3, 1.6, 0.95, 0.0, 0.7)
    picked = above(some, 0.5)
    told = [(int(s), int(c)) for s, c in zip(picked.slot, picked.copy, strict=True)]
    reported = [x for x, e in zip(told, picked.exists, strict=True) if e]
    assert sorted(reported) == [(1, 0), (1, 1), (2, 0), (4, 0)]
    np.testing.assert_allclose(picked.share.sum(), 1.6 + 0.95 + 0.7 + 0.3)


def test_a_threshold_is_on_the_component_and_the_heaviest_go_first():
    some = components(1.0, 1.6, 0.95, 0.2)
    reported = above(some, 0.9)
    assert {int(x) for x in reported.slot[reported.exists]} == {0, 1, 2}
    first = heaviest(components(0.9, 1.6), 1)
    assert first.slot[first.exists].tolist() == [1]
    assert heaviest(some, 0).exists.sum() == 0


def test_a_further_target_of_one_component_takes_no_other_ones_slot():
    """Three slots: two that are reported, one that is not, and a second of the 1.6."""
    picked = above(components(1.6, 0.3, 0.6), 0.5)
    assert picked.slot.tolist() == [0, 2, 0]
    assert picked.exists.all()
    full = above(components(1.6, 1.0, 0.6), 0.5)
    assert sorted(full.slot[full.exists].tolist()) == [0, 1, 2]
    strict = above(components(1.6, 0.85, 0.8), 0.9)
    assert strict.slot[strict.exists].tolist() == [0, 0]


def test_more_than_three_targets_in_one_place_are_reported_as_three():
    picked = above(components(7.0, 0.0, 0.0, 0.0), 0.5)
    assert picked.exists.sum() == extraction.COPIES == 3


def test_labels_are_told_apart_for_good_but_for_copies():
    some = components(0.6, 0.9, 1.7, 0.8, 0.0, label=[4, 4, 6, 8, 9])
    picked = above(some, 0.5)
    renamed, shown, following = tell_apart(some, picked, jnp.array(20))
    reported = shown[picked.exists].tolist()
    assert len(set(reported)) == len(reported)
    assert renamed.label[1] == 4  # the heavier one is the heir
    assert renamed.label[0] >= 20
    assert renamed.label[2] == 6
    assert renamed.label[3] == 8
    assert following == 20 + 2  # one for the rival, one for the second of the 1.7


@pytest.mark.parametrize(
    ("threshold", "count"), [(None, 1), (0.5, 2), (0.35, 2), (0.25, 3), (0.0, 3)]
)
def test_how_many_are_reported_by_the_distribution_of_their_number(threshold, count):
    log_number = np.log(np.array([0.1, 0.35, 0.25, 0.3]))
    assert cphd.count_reported(log_number, threshold) == count


def test_parents_without_room_are_counted_and_the_heaviest_gives_its_name():
    target, params = single.single(), single_params()
    belief = Gaussian(np.array([[0.0, 0.0], [1.0, 0.0]]), np.stack([np.eye(2)] * 2))
    size = reduction.make(4, max_parents=1, partition="detections")
    log_hit, label = jnp.log(jnp.array([[0.2], [0.6]])), jnp.array([3, 5])

    @jax.jit
    def reduced(params, belief):
        views = jax.vmap(target.look, (None, 0))(params, belief)
        return reduction.by_detection(size, target, params, label, views, log_hit, HIT)

    some, unmade = reduced(params, belief)
    np.testing.assert_allclose(unmade, 0.2, rtol=1e-9)
    np.testing.assert_allclose(np.exp(some.log_weight), [0.8], rtol=1e-9)
    assert some.label.tolist() == [5]


def reduced(size, target):
    """What is kept of an update by one detection, what dropped, and what is lost."""

    @jax.jit
    def compiled(params, belief, log_missed, log_hit):
        views = jax.vmap(target.look, (None, 0))(params, belief)
        weights = log_missed, log_hit, jnp.ones(1), jnp.zeros(())
        update = intensity.Update(belief, views, *weights)
        label = jnp.arange(len(log_missed))
        kept, dropped = reduction.reduce(size, target, params, label, update, HIT)
        return kept, dropped, target.lost(jax.tree.map(lambda x: x[0], kept.belief))

    return compiled


@pytest.mark.parametrize("partition", ["pairs", "detections"])
def test_what_is_pruned_is_counted(partition):
    """Twenty components of less than the threshold: nobody is left, and all is said."""
    target, num = single.single(), 20
    belief = Gaussian(np.zeros((num, 2)), np.stack([np.eye(2)] * num))
    size = reduction.make(4, prune_threshold=0.1, partition=partition)
    low, no_hit = np.full(num, np.log(0.09)), np.full((num, 1), -np.inf)
    kept, dropped, _ = reduced(size, target)(single_params(), belief, low, no_hit)
    assert kept.expected == 0
    np.testing.assert_allclose(dropped, 1.8, rtol=1e-9)


def test_what_beliefs_lose_is_counted_once():
    target, params = mixture.mixture(1, merge_threshold=0.0), two_mode_params()
    prior = Gaussian(np.array([[-9.0, 0.0], [9.0, 0.0]]), np.stack([np.eye(2)] * 2))
    begin = jax.jit(jax.vmap(target.begin, (None, 0, None, None)))
    belief = begin(params, prior, np.array([0.5, 0.5]), jax.random.key(0))
    size = reduction.make(4, partition="detections")
    gone, log_hit = np.full(2, -np.inf), np.log(np.full((2, 1), 0.5))
    kept, dropped, lost = reduced(size, target)(params, belief, gone, log_hit)
    np.testing.assert_allclose(kept.expected, 1, rtol=1e-9)
    np.testing.assert_allclose(lost, 0.5, rtol=1e-6)
    np.testing.assert_allclose(dropped, lost, rtol=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"max_components": 0}, "max_components is 0; give at least 1"),
        ({"max_updated": 0}, "max_updated is 0; give at least 1"),
        ({"max_parents": 0}, "max_parents is 0; give at least 1"),
        ({"max_births": 0}, "max_births is 0; give at least 1"),
        ({"prune_threshold": 1.0}, "prune_threshold is 1.0; give an expected number"),
        ({"merge_threshold": -1.0}, "merge_threshold is -1.0; give a squared distance"),
        ({"report_threshold": 1.0}, "report_threshold is 1.0; give a"),
        ({"partition": "rows"}, "partition is 'rows'; give \"pairs\""),
        ({"extract": "peaks"}, "extract is 'peaks'; give \"components\""),
    ],
)
@pytest.mark.parametrize("maker", [phd.phd, cphd.cphd])
def test_settings_that_make_no_sense_are_refused(maker, settings, message):
    with pytest.raises(ValueError, match=message):
        maker(single.single(), **settings)


def test_a_number_of_targets_must_be_possible():
    with pytest.raises(ValueError, match="max_targets is 0; give at least 1"):
        cphd.cphd(single.single(), max_targets=0)
