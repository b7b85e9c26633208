"""The target of a likely set of modes against the tables of the paper, and the IMM."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import slopes
from reference import likely_modes as book
from reference import mixture as mixture_book

from jaxtrack.models import probability, sensor, switching, turn
from jaxtrack.scenarios.world import turn_matrix
from jaxtrack.targets import blending, imm, likely_modes, likely_set
from jaxtrack.types import Gaussian

pytestmark = pytest.mark.usefixtures("whole_matrices")

RATES = np.array([-0.2, -0.1, 0.0, 0.1, 0.2])  # a chain of turns
NUM, SCANS, STEP = len(RATES), 14, 1.5
PRIOR = Gaussian(np.array([0.0, 30.0, 0.0, 5.0]), np.diag([50.0, 9.0, 50.0, 9.0]))
CENTRE, ALL = np.array([0.0, 0, 1, 0, 0]), np.array([0.1, 0.2, 0.4, 0.2, 0.1])
# t1, t2 and the modes at the start; the last two keep all active.
KINDS = [
    (0.1, 0.5, CENTRE),
    (0.02, 0.9, CENTRE),
    (0.3, 0.2, ALL),
    (0.15, 0.97, ALL),
    (0.0, 0.5, ALL),
    (0.0, 1.0, ALL),
]
BLENDS = {"mixture": blending.by_mixture, "residual": blending.by_residual}


def chain(stay, num=NUM):
    """Stays with some probability, else goes to a neighbour, or two up from mode 1."""
    up, down = np.eye(num, k=1), np.eye(num, k=-1)
    leave = 0.6 * up + 0.4 * down
    leave[1, 3:4] = 0.3  # and not back
    leave = leave / leave.sum(1, keepdims=True)
    return stay * np.eye(num) + (1 - stay) * leave


def params_of(t1, t2, values=None):
    values = values or {}
    rates, noise = values.get("rates", RATES), values.get("noise", np.full(NUM, 2.0))
    return likely_modes.Params(
        motions=tuple(map(turn.CoordinatedTurn, rates, noise)),
        switching=switching.MarkovSwitching(chain(0.85, len(rates))),
        sensor=sensor.Position(values.get("std", np.array([12.0, 8.0]))),
        survive=probability.Constant(values.get("survive", np.array(0.97))),
        detect=probability.Constant(values.get("detect", np.array(0.9))),
        unlikely_prob=t1,
        principal_prob=t2,
    )


@functools.cache
def data():
    """Three detections a scan near a target that turns, and given associations."""
    rng = np.random.default_rng(3)
    state, rows = PRIOR.mean, []
    for scan in range(SCANS):
        rate = (0.0, 0.1, 0.2, -0.1)[4 * scan // SCANS]
        state = turn_matrix(rate, STEP) @ state
        rows.append(state[[0, 2]] + rng.normal(size=(3, 2)) * [12.0, 8.0])
    beta = rng.dirichlet([6.0, 0.5, 0.3, 0.3], size=SCANS)
    beta[::3] = [1.0, 0.0, 0.0, 0.0]  # sometimes it is certain
    return np.array(rows), beta


def one_scan(target, params, belief, z, log_beta):
    """Lives through a scan: the belief after it, and what is told."""
    belief, log_survive = target.predict(params, belief, jnp.asarray(STEP))
    missed, log_miss = target.miss(params, belief)
    view = target.look(params, belief)
    score = target.score(params, view, z)
    square, log_det = target.distance(params, view, z)
    certain = target.correct(params, view, z[0])
    belief = target.blend(params, view, missed, log_beta, z)
    belief = target.adapt(params, belief, 1.0)
    chances = log_survive, log_miss, score, square, log_det
    chances += target.modes(certain), target.moments(certain).mean
    told = target.moments(belief), target.modes(belief), chances
    return belief, (told, getattr(belief, "log_next", None))


def live(target, params, rows, mode_prob, detections, beta):
    """Lives through all scans, in every row at once: what is told, [scan, row, ...].

    `params` makes those of a row, `mode_prob` is [row, M], and `detections` are
    [scan, K, 2], or [scan, row, K, 2] where each row has its own.
    """
    own = 0 if detections.ndim == 4 else None
    begin = jax.vmap(lambda row, modes: target.begin(params(row), PRIOR, modes, None))
    step = jax.vmap(
        lambda row, *args: one_scan(target, params(row), *args), (0, 0, own, None)
    )
    first, seen = begin(rows, mode_prob), (detections, jnp.log(beta))
    return jax.lax.scan(lambda beliefs, x: step(rows, beliefs, *x), first, seen)[1]


@functools.cache
def lives(name):
    """All kinds of `KINDS` at once, [scan, kind, ...]."""
    target = likely_modes.likely_modes(min_modes=2, blend=BLENDS[name])
    t1, t2, mode_prob = map(np.array, zip(*KINDS, strict=True))
    run = functools.partial(live, target, lambda row: params_of(*row))
    return jax.tree.map(np.array, jax.jit(run)((t1, t2), mode_prob, *data()))


def book_model(t1, t2):
    motions = params_of(t1, t2).motions
    return book.Model(
        F=[np.array(m.transition(STEP)) for m in motions],
        Q=[np.array(m.noise(STEP)) for m in motions],
        H=np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]]),
        R=np.diag([144.0, 64.0]),
        p=chain(0.85),
        detect=0.9,
        t1=t1,
        t2=t2,
        K=2,
    )


def assert_seen(told, model, active, known, detections):
    """What the association is told is of the active modes alone."""
    _, log_miss, score, square, log_det, modes, mean = told
    total = book.explained(model, active, known, detections)
    mixed = book.mix(model, active, known)
    size = sum(mu for mu, _, _ in mixed.values())
    chances = np.exp(np.append(score, log_miss))
    np.testing.assert_allclose(chances, total / size, rtol=1e-8)
    pool = []
    for i, (mu, x, P) in mixed.items():
        if mu > 0:
            x, _, S, *_ = book.see(model, i, x, P, detections)
            pool.append((mu / size, model.H @ x, S))
    expected, S = mixture_book.moment_match(pool)
    gap = detections - expected
    want = np.einsum("kz,zy,ky->k", gap, np.linalg.inv(S), gap)
    np.testing.assert_allclose(square, want, rtol=1e-8)
    np.testing.assert_allclose(log_det, np.log(np.linalg.det(S)), rtol=1e-8)
    certain = book.fuse(
        book.vsimm(model, active, known, detections[:1], [1.0, 0.0], True, None)
    )
    mu = [certain[i][0] if i in certain else 0.0 for i in range(NUM)]
    np.testing.assert_allclose(modes, mu, rtol=1e-8)
    np.testing.assert_allclose(mean, book.moments(certain)[0], rtol=1e-9)


@pytest.mark.parametrize("name", BLENDS)
def test_a_run_is_that_of_the_tables(name):
    """Step by step: moments, probabilities and the set that follows."""
    (belief, modes, chances), log_next = lives(name)
    sizes = set()
    for kind, (t1, t2, mode_prob) in enumerate(KINDS):
        model = book_model(t1, t2)
        active = {i for i in range(NUM) if mode_prob[i] > 0}
        known = {i: (mode_prob[i], *PRIOR) for i in active}
        for scan, (z, beta) in enumerate(zip(*data(), strict=True)):
            told = [x[scan, kind] for x in chances]
            assert_seen(told, model, active, known, z)
            known, active = book.cycle(
                model, active, known, z, beta, name == "residual"
            )
            x, P = book.moments(known)
            np.testing.assert_allclose(belief.mean[scan, kind], x, rtol=1e-9)
            np.testing.assert_allclose(belief.cov[scan, kind], P, rtol=1e-7)
            mu = [known[i][0] if i in known else 0.0 for i in range(NUM)]
            np.testing.assert_allclose(modes[scan, kind], mu, rtol=1e-8)
            kept = set(np.flatnonzero(log_next[scan, kind] == 0))
            assert kept == active
            sizes.add((len(known), len(active)))
    assert len(sizes) > 6  # the scene has sets of many sizes


def test_with_all_modes_active_it_is_the_imm():
    """In whatever it tells over a whole run."""
    target = imm.imm()
    run = functools.partial(live, target, lambda _: imm.Params(*params_of(0, 0)[:5]))
    told, _ = jax.jit(run)(np.zeros(1), ALL[None], *data())
    for kind in (4, 5):
        mine = jax.tree.map(lambda x, kind=kind: x[:, [kind]], lives("mixture")[0])
        jax.tree.map(
            lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-9), mine, told
        )


@functools.cache
def slopes_of(temperature):
    """The slopes of a run in all values, by gradient and by differences; scales.

    Of three modes, the last of which nothing can enter at first.
    """
    target = likely_modes.likely_modes(temperature=temperature)
    detections, beta = data()[0][:6, :2], data()[1][:6, 1:]
    values = {
        "rates": RATES[1:4],
        "noise": np.linspace(1.0, 3.0, 3),
        "std": np.array([12.0, 8.0]),
        "survive": np.array(0.97),
        "detect": np.array(0.9),
        "t1": np.array(0.08),
        "t2": np.array(0.6),
        "detections": detections,
    }

    def params(row):
        return params_of(row["t1"], row["t2"], row)

    moved, scale = slopes.walks(values)
    rows = jax.tree.map(lambda x, y: np.concatenate([[x], y]), values, moved)
    start = np.tile(np.eye(3)[0], (len(rows["t1"]), 1))

    def losses(rows):
        z = jnp.moveaxis(rows["detections"], 0, 1)
        (belief, modes, chances), _ = live(target, params, rows, start, z, beta)
        value = (
            (belief.mean @ jnp.arange(1.0, 5.0)).sum(0) / 100
            + jnp.trace(belief.cov, axis1=2, axis2=3).sum(0) / 100
            + (modes @ jnp.arange(1.0, 4.0)).sum(0)
            + sum(x.sum((0, *range(2, x.ndim))) for x in chances) / 10
        )
        return value.sum(), value

    # Of each row the value and its own slopes, in one program.
    slope, value = jax.tree.map(np.array, jax.jit(jax.grad(losses, has_aux=True))(rows))
    slope = jax.tree.map(lambda x: x[0], slope)
    return values, slope, slopes.differences(value[1:]), scale


def test_hard_choices_leave_all_other_gradients_right():
    values, slope, found, scale = slopes_of(0.0)
    slopes.assert_right(values, slope, found, scale, rtol=1e-5, atol=1e-6)
    assert slope["t1"] == slope["t2"] == 0


def test_soft_choices_can_be_learned():
    values, slope, found, scale = slopes_of(0.4)
    slopes.assert_right(values, slope, found, scale, rtol=1e-5, atol=1e-6)
    assert abs(slope["t1"]) > 0.1
    assert abs(slope["t2"]) > 0.01


def test_sets_are_chosen_as_in_table_3():
    """For thousands of random probabilities, digraphs and thresholds, hard and cold."""
    rng = np.random.default_rng(0)
    size, num = 3000, 6
    active = rng.random((size, num)) < 0.6
    active[np.arange(size), rng.integers(num, size=size)] = True
    weight = np.where(active, rng.random((size, num)) ** 6, 0.0)
    mu = weight / weight.sum(1, keepdims=True)
    mu[rng.random(size) < 0.2] = np.eye(num)[2]  # some active modes are impossible
    active[:, 2] = True
    p = (rng.random((size, num, num)) < 0.3) | np.eye(num, dtype=bool)
    t1, t2 = rng.uniform(0, 0.3, size), rng.uniform(0.05, 0.9, size)
    with np.errstate(divide="ignore"):
        logs = np.log(mu), np.log(active.astype(float))
    cold = 1e-4
    steps = np.abs(logs[0] - np.log([t1, t2])[..., None]) / cold  # from a threshold
    clear = (steps > 50).all((0, 2))
    assert clear.mean() > 0.9
    for min_modes in (1, 3, num):
        adapt = functools.partial(likely_set.adapt, min_modes=min_modes)
        sets = jax.jit(
            jax.vmap(lambda *x, adapt=adapt: (adapt(*x), adapt(*x, temperature=cold)))
        )
        (now, later), soft = sets(*logs, p, t1, t2)
        for k in range(size):
            known = {i: mu[k, i] for i in range(num) if active[k, i]}
            new, following = book.adapt(p[k], known, t1[k], t2[k], min_modes)
            union = known | {i: 0.0 for i in new}
            assert set(np.flatnonzero(now[k] == 0)) == set(union)
            assert set(np.flatnonzero(later[k] == 0)) == following(union)
        # A low temperature makes hard choices: what is left of e^-50 is below this.
        for x, y in zip((now, later), soft, strict=True):
            np.testing.assert_allclose(np.exp(x[clear]), np.exp(y[clear]), atol=1e-12)


def test_modes_that_nobody_can_enter_are_impossible_and_finite():
    target, params = likely_modes.likely_modes(), params_of(0.1, 0.5)

    @jax.jit
    def one(prior):
        belief = target.begin(params, prior, CENTRE, None)
        belief, _ = target.predict(params, belief, STEP)
        seen = target.correct(params, target.look(params, belief), np.zeros(2))
        return belief, seen, target.miss(params, belief)[0]

    beliefs = one(PRIOR)
    for belief in beliefs:  # what is active sums to one, whatever else there is
        assert np.exp(belief.log_weight).sum() > 1.1
        active = np.exp(belief.log_weight + belief.log_active)
        np.testing.assert_allclose(active.sum(), 1.0)
    belief = beliefs[0]
    np.testing.assert_array_equal(np.exp(belief.log_weight[jnp.array([0, 4])]), 0.0)
    assert np.isfinite(belief.mean).all()
    assert np.isfinite(belief.cov).all()
    # Its neighbours are not active yet, but known: 0.4 and 0.6 of those who leave.
    np.testing.assert_allclose(
        np.exp(belief.log_weight[1:4]), np.array([0.06, 0.85, 0.09]) / 0.85
    )


def test_where_no_active_mode_can_be_entered_all_become_active():
    swap = switching.MarkovSwitching(np.array([[0.0, 1.0], [1.0, 0.0]]))
    base = params_of(0.9, 1.0)
    params = base._replace(motions=base.motions[:2], switching=swap)
    target = likely_modes.likely_modes()

    @jax.jit
    def one(mode_prob):
        belief = target.begin(params, PRIOR, mode_prob, None)
        belief, log_survive = target.predict(params, belief, STEP)
        return target.modes(belief), log_survive

    modes, log_survive = one(np.array([1.0, 0.0]))
    np.testing.assert_array_equal(modes, [0.0, 1.0])
    np.testing.assert_allclose(np.exp(log_survive), 0.97)


def test_collapse_joins_active_sets_and_keeps_the_moments_of_the_pool():
    """An empty slot's set does not join."""
    target = likely_modes.likely_modes()
    rng = np.random.default_rng(5)
    on = np.array([[1, 1, 0, 0], [0, 1, 1, 0], [1, 1, 1, 1]], bool)
    weight = rng.uniform(0.1, 1.0, (3, 4))
    weight = weight / np.where(on, weight, 0.0).sum(1, keepdims=True)
    root = rng.normal(size=(3, 4, 2, 2))
    mean, cov = rng.normal(size=(3, 4, 2)), root @ root.swapaxes(2, 3)
    with np.errstate(divide="ignore"):
        log_active = np.log(on.astype(float))
    many = likely_modes.Belief(np.log(weight), mean, cov, log_active, log_active)
    share = np.array([0.3, 0.7, 0.0])

    @jax.jit
    def joined(many):
        one = target.collapse(jnp.log(5 * share), many)
        return one, target.moments(one), target.modes(one)

    one, belief, modes = joined(many)
    np.testing.assert_array_equal(one.log_active == 0, [True, True, True, False])
    np.testing.assert_array_equal(one.log_next == 0, [True, True, True, False])
    flat = share[:, None] * np.where(on, weight, 0.0)
    np.testing.assert_allclose(modes, flat.sum(0))
    centre = np.einsum("nm,nmd->d", flat, mean)
    gap = mean - centre
    spread = np.einsum("nm,nmde->de", flat, cov + gap[..., None] * gap[..., None, :])
    np.testing.assert_allclose(belief.mean, centre)
    np.testing.assert_allclose(belief.cov, spread)
    # What none has active is known of all, so that it can still be activated.
    np.testing.assert_allclose(np.exp(one.log_weight[3]), share @ weight[:, 3])


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"min_modes": 0}, "min_modes is 0; give at least 1"),
        ({"temperature": -1.0}, "temperature is -1.0; give 0 or"),
        ({"temperature": float("nan")}, "temperature is nan; give 0 or"),
        ({"yardstick": "widest"}, "yardstick is 'widest'"),
    ],
)
def test_bad_settings_are_named(setting, words):
    with pytest.raises(ValueError, match=words):
        likely_modes.likely_modes(**setting)
