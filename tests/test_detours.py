"""Tests of `assign.detours` against solving each problem anew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import assign as reference

from jaxtrack.assign import best, detours

INF = np.inf


def draw(shape, count, rounded):
    rng = np.random.default_rng(sum(shape) + rounded)
    drawn = [reference.scores(rng, *shape, gate) for gate in rng.random(count)]
    log_score = np.array(drawn).reshape(count, shape[0], shape[1] + 1)
    log_score[1::2, :, -1][rng.random((len(log_score[1::2]), shape[0])) < 0.2] = -INF
    log_score = np.round(log_score / 3) if rounded else log_score
    return jnp.asarray(log_score)


def event_of(log_score):
    found = best.best(log_score)
    return detours.Event(found.column, -found.detection_price), found


def barred_at_random(shape):
    return jnp.asarray(np.random.default_rng(5).random(shape) < 0.2)


@jax.jit
@jax.vmap
def both(log_score, barred):
    """The detours, and the best of each problem in which they are spelled out."""
    event, found = event_of(log_score)
    gone = detours.detours(-log_score, event, barred, jnp.inf)
    num_tracks, num_columns = log_score.shape
    track = jnp.arange(num_tracks)
    taken = event.column[:, None] == jnp.arange(num_columns)[None]

    def anew(leaver):
        out = (track < leaver)[:, None] & ~taken
        out = out | ((track == leaver)[:, None] & (taken | barred))
        return best.best(jnp.where(out, -INF, log_score))

    return gone, jax.vmap(anew)(track), found


@pytest.mark.parametrize("rounded", [False, True], ids=["distinct", "tied"])
@pytest.mark.parametrize("shape", [(1, 3), (4, 3), (6, 9)])
def test_a_detour_is_the_best_without_a_column_and_proves_it(shape, rounded):
    log_score = draw(shape, 80, rounded)
    gone, anew, found = both(log_score, barred_at_random(log_score.shape))
    fits = np.asarray(found.feasible)
    known = np.asarray(gone.loss < INF)[fits]
    np.testing.assert_array_equal(known, np.asarray(anew.feasible)[fits])
    assert known.any()
    assert shape[0] == 1 or not known.all()
    loss = np.asarray(found.log_score[:, None] - anew.log_score)[fits]
    # Differences of sums of scores of order ten.
    np.testing.assert_allclose(gone.loss[fits][known], loss[known], atol=1e-11)

    scores = np.asarray(log_score)[fits]
    for one, columns, there in zip(scores, gone.column[fits], known, strict=True):
        for column in columns[there]:
            detected = column[column < one.shape[1] - 1]
            assert len(set(detected.tolist())) == len(detected)
    chosen = np.take_along_axis(scores[:, None], gone.column[fits][..., None], 3)
    total = np.where(known, chosen[..., 0].sum(-1), 0.0)
    expected = np.where(known, np.asarray(anew.log_score)[fits], 0.0)
    np.testing.assert_allclose(total, expected, atol=1e-11)  # of sums of order ten


def test_detours_of_a_detour_start_from_its_prices():
    log_score = draw((6, 9), 40, rounded=False)

    @jax.jit
    @jax.vmap
    def second(log_score):
        event, _ = event_of(log_score)
        nothing = jnp.zeros(log_score.shape, bool)
        gone = detours.detours(-log_score, event, nothing, jnp.inf)
        leaver = jnp.argmin(gone.loss)
        track = jnp.arange(len(log_score))
        own = event.column[:, None] == jnp.arange(log_score.shape[1])[None]
        out = (track < leaver)[:, None] & ~own
        out = out | ((track == leaver)[:, None] & own)
        cut = jnp.where(out, -INF, log_score)
        moved = detours.Event(gone.column[leaver], gone.price[leaver])
        again = detours.detours(-cut, moved, (track < leaver)[:, None], jnp.inf)
        anew = detours.detours(-cut, event_of(cut)[0], (track < leaver)[:, None], INF)
        return again.loss, anew.loss, gone.loss.min() < INF

    again, anew, there = second(log_score)
    assert there.sum() > 30
    assert (again[there] < INF).any()
    # Losses are differences of sums of order ten.
    np.testing.assert_allclose(again[there], anew[there], atol=1e-11)


def test_losses_that_are_too_large_are_left_out():
    log_score = draw((6, 9), 1, rounded=False)[0]

    @jax.jit
    def losses(most):
        event, _ = event_of(log_score)
        nothing = jnp.zeros(log_score.shape, bool)
        return detours.detours(-log_score, event, nothing, most).loss

    every = losses(np.inf)
    most = np.median(every)
    some = losses(most)
    np.testing.assert_array_equal(some, np.where(every <= most, every, INF))
