"""Tests of `trackers.mcmcda_batch` against the posterior of all hypotheses."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import small_scenes as scenes
from reference import lives, transitions

from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.sensor import Position
from jaxtrack.models.switching import MarkovSwitching
from jaxtrack.targets import imm
from jaxtrack.trackers import (
    enumeration,
    mcmcda_batch,
    mcmcda_moves,
    mcmcda_problem,
    mcmcda_scores,
    oracle,
    undetected,
)
from jaxtrack.types import Scan

SIZES, NUM, CHAINS, ROWS, MAX = (2, 1, 2), 10, 8, 5, 20


@functools.cache
def drawn():
    problems = scenes.stacked([scenes.draw(seed) for seed in range(NUM)])
    return problems, scenes.stacked([scenes.detections(k, SIZES) for k in range(NUM)])


def prepare(problem, places):
    scans = scenes.stacked(scenes.padded(places))
    params = scenes.params_of(problem)
    key = jax.random.key(0)
    return params, mcmcda_problem.prepare(scenes.target, params, scans, key)


@functools.cache
def exact(k):
    """Log-weights of all hypotheses of a problem, and of numbers of live targets."""
    model, places = scenes.model_of(scenes.draw(k)), scenes.detections(k, SIZES)
    weights, numbers = lives.posterior(places, model, MAX + 1)
    listed = enumeration.table(SIZES)
    named = [tuple(map(tuple, listed.track[row].tolist())) for row in listed.member]
    log_joint = np.log([weights[name] for name in named])
    track_prob = np.exp(log_joint - np.log(sum(weights.values()))) @ listed.member
    return log_joint, track_prob, numbers


def test_scores_of_tracks_add_up_to_the_posterior():
    listed = enumeration.table(SIZES)

    @jax.jit
    @jax.vmap
    def scored(problem, places):
        params, prepared = prepare(problem, places)

        def one(row):
            return mcmcda_scores.score(scenes.target, params.target, prepared, row)

        return jax.vmap(one)(jnp.asarray(listed.track)), prepared.log_constant.sum()

    tracks, log_constant = scored(*drawn())
    for k in range(NUM):
        log_joint = listed.member @ np.asarray(tracks.log_score[k]) + log_constant[k]
        np.testing.assert_allclose(log_joint, exact(k)[0], rtol=1e-10)
        model, places = scenes.model_of(scenes.draw(k)), scenes.detections(k, SIZES)
        for a, track in enumerate(listed.track):
            total, alive = lives.weigh(track, places, model)
            np.testing.assert_allclose(tracks.existence_prob[k, a], alive / total)
            mean = lives.likelihood(track, places, model)[1]
            # Means of order one, some of which are 0.
            np.testing.assert_allclose(
                tracks.belief.mean[k, a], mean, rtol=1e-9, atol=1e-13
            )


ROOM, SMALL, TRIES = 3, (1, 2, 1), 600


@functools.cache
def moves():
    """All hypotheses of a few detections, and where every kind of move leads them."""
    listed = enumeration.table(SMALL)
    kept = [row for row in listed.member if row.sum() <= ROOM]
    tables = np.full((len(kept), ROOM, len(SMALL)), -1)
    for table, row in zip(tables, kept, strict=True):
        table[: row.sum()] = listed.track[row]
    valid = np.arange(2)[None] < np.array(SMALL)[:, None]
    rng = np.random.default_rng(0)
    links = rng.uniform(-1, 1, (valid.size, *valid.shape))
    propose = functools.partial(mcmcda_moves.propose, valid=valid, links=links)
    keys = jax.random.split(jax.random.key(3), TRIES)
    each = jax.vmap(jax.vmap(propose, (0, None, None)), (None, None, 0))
    kinds = jnp.arange(len(mcmcda_moves.KINDS))
    every = jax.jit(lambda: jax.lax.map(lambda kind: each(keys, kind, tables), kinds))
    made = jax.tree.map(np.asarray, every())
    return tables, [
        [transitions.outcomes(made, kind, at) for at in range(len(tables))]
        for kind in range(len(mcmcda_moves.KINDS))
    ]


def test_moves_are_proposed_as_often_as_they_say():
    tables, made = moves()
    for kind, name in enumerate(mcmcda_moves.KINDS):
        for at in range(len(tables)):
            found = made[kind][at]
            if not any(outcome.possible for outcome in found):
                continue
            prob = np.exp([outcome.log_forward for outcome in found])
            # Every outcome was met, and so they sum to one.
            np.testing.assert_allclose(prob.sum(), 1, rtol=1e-12, err_msg=name)
            count = np.array([outcome.count for outcome in found])
            spread = np.sqrt(TRIES * prob * (1 - prob)) + 1e-9
            assert (abs(count - TRIES * prob) < 5 * spread).all(), name


@pytest.mark.parametrize("pair", [(0, 1), (2, 3), (4, 4), (5, 6), (7, 7)])
def test_each_pair_of_moves_is_in_detailed_balance(pair):
    tables, made = moves()
    rng = np.random.default_rng(1)
    target = rng.dirichlet(np.ones(len(tables)))
    matrix = sum(transitions.matrix(tables, made[kind], target) for kind in pair) / 2
    flow = target[:, None] * matrix
    assert (matrix - np.diag(np.diag(matrix))).max() > 0.01
    # Flows of order 1e-3.
    np.testing.assert_allclose(flow, flow.T, rtol=1e-10, atol=1e-16)
    np.testing.assert_allclose(target @ matrix, target, rtol=1e-12)


def test_all_moves_together_lead_everywhere():
    tables, made = moves()
    target = np.full(len(tables), 1 / len(tables))
    every = [transitions.matrix(tables, one, target) for one in made]
    size = np.sort(abs(np.linalg.eigvals(sum(every) / 8)))
    assert size[-2] < 0.99


def walk(problem, places, key, **sizes):
    params, prepared = prepare(problem, places)
    sizes = {"max_tracks": ROWS, "burn_in": 50, **sizes}
    return mcmcda_batch.sample(scenes.target, params, prepared, key, **sizes)


def share_of_tracks(table):
    """How often each listed track is in the tables [..., S, N, T]."""
    rows = enumeration.table(SIZES).track
    same = (table[..., None, :] == rows[None, None, None]).all(-1)
    return same.any(2).mean(1)


def assert_near(chains, exact, least):
    """Holds the mean of C chains [C, A] against numbers, by how the chains differ."""
    spread = chains.std(0, ddof=1) / np.sqrt(len(chains))
    score = (chains.mean(0) - exact) / np.maximum(spread, least)
    assert abs(score).max() < 6, score  # Student's t with C - 1 degrees of freedom
    assert abs(chains.mean(0) - exact).max() < 0.05


def check(samples, log_joint, track_prob, numbers):
    assert_near(share_of_tracks(np.asarray(samples.table)), track_prob, 2e-3)
    assert_near(np.asarray(samples.num_prob), numbers, 1e-3)
    found = track_prob @ (enumeration.table(SIZES).track >= 0)
    false = np.asarray(samples.false_prob).sum(2)
    assert_near(false, np.array(SIZES) - found, 2e-3)
    np.testing.assert_allclose(samples.best.log_weight, log_joint.max(), rtol=1e-10)
    assert samples.full.max() < 0.03


def test_chains_visit_what_is_likely_as_often_as_it_is():
    case = jax.tree.map(lambda x: x[3], drawn())
    run = functools.partial(walk, *case, num_samples=300)
    samples = jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(1), CHAINS))
    check(samples, *exact(3))
    assert (samples.accepted.mean(0) > 0.05).all()
    assert (samples.tried.sum(0) > 50).all()
    prob = share_of_tracks(np.asarray(samples.table))[0]
    rows = enumeration.table(SIZES).track
    for row, share in zip(samples.best.table[0], samples.best.prob[0], strict=True):
        same = (rows == np.asarray(row)[None]).all(1)
        assert abs(share - (prob[same][0] if same.any() else 0)) < 1e-12


@pytest.mark.slow
def test_chains_agree_with_the_posterior_of_many_problems():
    keys = jax.random.split(jax.random.key(1), CHAINS)
    each = jax.vmap(functools.partial(walk, num_samples=3000), (None, None, 0))
    samples = jax.jit(jax.vmap(each, (0, 0, None)))(*drawn(), keys)
    places = drawn()[1]
    key = jax.random.key(0)

    def judge(problem, places):
        params, scans = scenes.params_of(problem), scenes.scans_of(places)
        return oracle.posterior(scenes.target, params, scans, key, max_targets=MAX)

    found = jax.jit(jax.vmap(judge))(drawn()[0], places)
    for k in range(NUM):
        samples_k, truth = jax.tree.map(
            lambda x, k=k: np.asarray(x)[k], (samples, found)
        )
        log_joint = truth.log_prob + truth.log_evidence
        check(samples_k, log_joint, truth.track_prob, truth.num_prob)


def crowd(seed, num_targets=5, num_scans=8, size=14):
    """Targets that fly straight in a plane, clutter among them, and who is who."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-300, 300, (num_targets, 2))
    speed = rng.normal(0, 8, (num_targets, 2))
    detections, valid = np.zeros((num_scans, size, 2)), np.zeros((num_scans, size))
    table = np.full((12, num_scans), -1)
    for t in range(num_scans):
        place = place + speed
        slots = rng.permutation(size)
        number = num_targets + min(rng.poisson(5), size - num_targets)
        seen = rng.uniform(size=num_targets) < 0.9
        for n, slot in enumerate(slots[:number]):
            if n < num_targets and not seen[n]:
                continue
            false = rng.uniform(-400, 400, 2)
            hit = place[n] + rng.normal(0, 3, 2) if n < num_targets else false
            detections[t, slot], valid[t, slot] = hit, 1
            if n < num_targets:
                table[n, t] = slot
    return Scan(detections, valid > 0, np.ones(num_scans)), table


@pytest.mark.slow
def test_a_crowd_is_explained_no_worse_than_by_who_is_who():
    one = scenes.params_of(scenes.draw(0))
    target = imm.imm()
    motions = ConstantVelocity(jnp.full(2, 0.1)), ConstantVelocity(jnp.full(2, 5.0))
    start = scenes.PoissonBirth(
        jnp.array([5.0]),
        jnp.zeros((1, 4)),
        jnp.diag(jnp.array([300.0, 8.0, 300.0, 8.0]) ** 2)[None],
        jnp.full((1, 2), 0.5),
    )
    box = jnp.full(2, 400.0)
    params = undetected.Params(
        target=imm.Params(
            motions,
            MarkovSwitching(jnp.array([[0.95, 0.05], [0.1, 0.9]])),
            Position(jnp.full(2, 3.0)),
            one.target.survive._replace(value=jnp.array(0.99)),
            one.target.detect._replace(value=jnp.array(0.9)),
        ),
        birth=start._replace(rate=jnp.array([0.01])),
        clutter=UniformClutter(jnp.array(5.0), -box, box),
        undetected=start,
    )

    @jax.jit
    @jax.vmap
    def run(scans, table, key):
        problem = mcmcda_problem.prepare(target, params, scans, jax.random.key(0))
        known = functools.partial(mcmcda_scores.score, target, params.target, problem)
        exact = jax.vmap(known)(table).log_score.sum() + problem.log_constant.sum()
        found = mcmcda_batch.sample(
            target, params, problem, key, max_tracks=12, num_samples=1500
        )
        return found.best, exact

    cases, keys = [crowd(seed) for seed in range(2)], jax.random.key(5)
    # Four chains each: one alone may stay where it got to.
    cases = scenes.stacked([case for case in cases for _ in range(4)])
    best, exact = run(*cases, jax.random.split(keys, 8))
    found, exact = np.asarray(best.log_weight).reshape(2, 4), exact[::4]
    assert (found.max(1) > exact - 1e-6).all()
    assert (best.prob.max(1) > 0.5).all()


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="thin is 0; give at least 1"):
        mcmcda_batch.sample(None, None, None, None, thin=0)
    with pytest.raises(ValueError, match="burn_in is -1; give 0 or more"):
        mcmcda_batch.sample(None, None, None, None, burn_in=-1)
    with pytest.raises(ValueError, match=r"shares is \(1.0,\); give 5 numbers"):
        mcmcda_batch.sample(None, None, None, None, shares=(1.0,))
    params = scenes.params_of(scenes.draw(0))._replace(start=1)
    with pytest.raises(ValueError, match="start is given"):
        mcmcda_problem.prepare(None, params, None, None)
