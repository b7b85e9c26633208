"""Which models and detections a target may have had over some scans, and how likely.

From a Gaussian belief before a window of S scans grow leaves, each a sequence of
detections, one a scan or none. Every sequence of models, M^S of them, has its own
Kalman filter along the leaf. Nothing but the target itself couples the models of its
scans, so that an assignment puts all of a leaf on its best sequence: its score is that
of the best one, and where several are level, as in scans without a detection, they
share it equally.

    >>> from jaxtrack.trackers import rmm_leaves
    >>> rmm_leaves.Leaves._fields
    ('log_score', 'log_first', 'mode_prob', 'past')

Reference: Liu, Shen, Wang and Meng, "Randomized multimodel multiple hypothesis
tracking", 2021, supplement, equation A11.
"""

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import gate, kalman, linearize
from jaxtrack.linalg import safe_log
from jaxtrack.targets import views
from jaxtrack.trackers.association import LEAST_LOG_WEIGHT
from jaxtrack.types import Array, Gaussian

LEVEL = 32  # units in the last place by which two scores may differ and be level


class Look(NamedTuple):
    """Through what a scan was seen: values of the `Params` of that scan.

    Attributes:
        sensor: Of `models.sensor` or `models.converted`.
        detect: Of `models.probability`.
        clutter: Of `models.clutter`.
    """

    sensor: Any
    detect: Any
    clutter: Any


class Window(NamedTuple):
    """S scans, the oldest first.

    Attributes:
        detections: [S, K, Z].
        valid: Which of them are there, [S, K] (bool).
        interval: Seconds since the scan before, [S].
        looked: Whether the sensor looked at all, [S] (bool).
        through: Its sensor, detection and clutter, each value [S, ...].
    """

    detections: Array
    valid: Array
    interval: Array
    looked: Array
    through: Look


class Leaves(NamedTuple):
    """L sequences of detections of one target; in the first there is none.

    Attributes:
        log_score: Log-likelihood ratio against all its detections being false, with the
            best models; -inf marks an empty leaf, [L].
        log_first: What the first scan of the window contributes to that, [L].
        mode_prob: Of the model in each scan, [L, S, M].
        past: The detection in each scan, -1 for none, [L, S] (int).
    """

    log_score: Array
    log_first: Array
    mode_prob: Array
    past: Array


class Rules(NamedTuple):
    """How leaves grow: settings, all of them static.

    Attributes:
        method: Of `linearize`; idle where the models are linear.
        gate_prob: P_G of the gate of each sequence of models; 1 for none.
        max_leaves: L.
    """

    method: linearize.Method
    gate_prob: float
    max_leaves: int


class _Growth(NamedTuple):
    """Leaves on their way: L leaves, of Q sequences of models each.

    Attributes:
        belief: mean [L, Q, D], cov [L, Q, D, D].
        log_score: [L, Q].
        log_first: [L, Q].
        past: [L, scans so far].
    """

    belief: Gaussian
    log_score: Array
    log_first: Array
    past: Array


def grow(rules: Rules, params: Any, belief: Gaussian, window: Window) -> Leaves:
    """Grows the leaves of one target.

    Args:
        rules: Settings.
        params: The tracker's `Params`: target and clutter; each scan of the window has
            its own sensor.
        belief: Before the first scan: mean [D], cov [D, D].
        window: S scans.
    """
    num_modes, num_scans = len(params.target.motions), len(window.interval)
    zero = jnp.zeros((1, 1), belief.mean.dtype)
    bank = jax.tree.map(lambda x: x[None, None], belief)
    growth = _Growth(bank, zero, zero, jnp.zeros((1, 0), jnp.int32))
    for n in range(num_scans):
        scan = jax.tree.map(lambda x, n=n: x[n], window)
        growth = _extend(rules, params, growth, scan, n + 1 == num_scans)
    score = growth.log_score  # [L, M^S]
    share = _shared_by_the_best(score)
    sequences = list(itertools.product(range(num_modes), repeat=num_scans))
    digits = np.array(sequences, int).reshape(len(sequences), num_scans)
    chosen = digits[:, :, None] == np.arange(num_modes)  # [M^S, S, M]
    return Leaves(
        log_score=score.max(1),
        log_first=(share * growth.log_first).sum(1),
        mode_prob=jnp.einsum("lq,qsm->lsm", share, jnp.asarray(chosen, share.dtype)),
        past=growth.past,
    )


def look_of(params: Any) -> Look:
    """Returns through what the tracker's `Params` see a scan."""
    return Look(params.target.sensor, params.target.detect, params.clutter)


def through(params: Any, look: Look) -> Any:
    """Returns the tracker's `Params` as they were when a scan was seen."""
    target = params.target._replace(sensor=look.sensor, detect=look.detect)
    return params._replace(target=target, clutter=look.clutter)


def survival(target: Any, mean: Array, interval: Array, looked: Array) -> Array:
    """Returns the log-probability to survive under each model, [M].

    Args:
        target: The target's `Params`.
        mean: [D].
        interval: Seconds.
        looked: Whether there is such a scan.
    """
    modes = jnp.arange(len(target.motions))
    prob = jax.vmap(target.survive.prob, (0, None, None))(modes, mean, interval)
    return jnp.where(looked, safe_log(prob), 0.0).astype(mean.dtype)


def _extend(
    rules: Rules, params: Any, growth: _Growth, scan: Window, last: bool
) -> _Growth:
    """Takes leaves through a scan: moves, scores, keeps the best and corrects them."""
    params, num_modes = through(params, scan.through), len(params.target.motions)
    target = params.target
    each = jax.vmap(jax.vmap(lambda prior: _move(rules, target, prior, scan)))
    moved, log_survive = each(growth.belief)  # [L, Q, M]
    moved, log_survive = jax.tree.map(_joined, (moved, log_survive))
    mode = jnp.arange(log_survive.shape[1]) % num_modes  # of each sequence
    look = jax.vmap(jax.vmap(lambda m, x: _look(rules, params, m, x, scan)), (None, 0))
    view, ratio = look(mode, moved)  # [L, Q M], [L, Q M, K + 1]
    now = log_survive[:, :, None] + ratio
    before = jnp.repeat(growth.log_score, num_modes, axis=1)
    score = before[:, :, None] + now
    columns = score.shape[2]
    parent, column, rank = _best(score.max(1), rules.max_leaves)
    there = rank[:, None] > -jnp.inf
    score = jnp.where(there, score[parent, :, column], -jnp.inf)
    share = now[parent, :, column] if growth.past.shape[1] == 0 else None
    first = jnp.repeat(growth.log_first, num_modes, axis=1)[parent]
    seen = jnp.where(column == columns - 1, -1, column).astype(growth.past.dtype)
    belief = jax.tree.map(lambda x: x[parent], moved)
    if not last:
        views_of = jax.tree.map(lambda x: x[parent], view)
        belief = jax.vmap(lambda v, x, k: _correct(rules, params, v, x, k, scan))(
            views_of, belief, seen
        )
    return _Growth(
        belief,
        score,
        jnp.where(there, first if share is None else share, 0.0),
        jnp.concatenate([growth.past[parent], seen[:, None]], 1),
    )


def _best(score: Array, size: int) -> tuple[Array, Array, Array]:
    """Returns the best pairs of a leaf and a detection, and how they rank.

    The leaf without any detection stays first, so that every target has one.

    Args:
        score: Of all pairs, the last column that of no detection, [L, K + 1].
        size: How many at most.
    """
    last = score.shape[1] - 1
    rank = score.at[0, last].set(jnp.inf)
    # The best pairs are in the columns with the best entries.
    some = jax.lax.top_k(rank.max(0), min(size, last + 1))[1]
    few = rank[:, some]
    rank, at = jax.lax.top_k(few.reshape(-1), min(size, few.size))
    parent, place = jnp.divmod(at, len(some))
    return parent, some[place], rank


def _move(
    rules: Rules, target: Any, prior: Gaussian, scan: Window
) -> tuple[Gaussian, Array]:
    """Moves a belief by each of the models: [M], with log-probabilities to survive."""
    moved = [
        kalman.predict(
            prior, linearize.motion_affine(motion, prior, scan.interval, rules.method)
        )
        for motion in target.motions
    ]
    log_survive = survival(target, prior.mean, scan.interval, scan.looked)
    return jax.tree.map(lambda *x: jnp.stack(x), *moved), log_survive


def _look(
    rules: Rules, params: Any, mode: Array, prior: Gaussian, scan: Window
) -> tuple[views.View, Array]:
    """Returns a view, and the log-likelihood ratios of detections and of none."""
    target, method = params.target, rules.method
    view = views.look(method, target, prior)
    detect = target.detect.prob(mode, prior.mean, 0.0)
    clutter = jax.vmap(params.clutter.log_density)(scan.detections)
    density = views.score(method, target, view, scan.detections)
    ratio = safe_log(detect) + density - jnp.maximum(clutter, LEAST_LOG_WEIGHT)
    square, _ = views.distance(method, target, view, scan.detections)
    limit = gate.threshold(rules.gate_prob, target.sensor.num_outputs)
    inside = scan.valid & scan.looked & (square <= limit)
    log_miss = jnp.maximum(safe_log(1 - detect), LEAST_LOG_WEIGHT)
    missed = jnp.where(scan.looked, log_miss, 0.0).astype(ratio.dtype)
    ratio = jnp.where(inside, ratio, -jnp.inf)
    return view, jnp.concatenate([ratio, missed[None]])


def _correct(
    rules: Rules, params: Any, view: Any, missed: Gaussian, seen: Array, scan: Window
) -> Gaussian:
    """Conditions the filters of all sequences of models on a detection, if any, [Q]."""
    detection = scan.detections[jnp.maximum(seen, 0)]
    hit, _ = jax.vmap(
        lambda v: views.correct(rules.method, params.target, v, detection)
    )(view)
    return jax.tree.map(lambda x, y: jnp.where(seen >= 0, x, y), hit, missed)


def _joined(x: Array) -> Array:
    """Returns [L, Q, M, ...] as [L, Q M, ...]."""
    return x.reshape(x.shape[0], -1, *x.shape[3:])


def _shared_by_the_best(score: Array) -> Array:
    """Returns the shares of sequences of models [L, Q]: those of the best are equal."""
    top = score.max(1, keepdims=True)
    top = jnp.where(top > -jnp.inf, top, 0.0)
    slack = LEVEL * jnp.finfo(score.dtype).eps * jnp.maximum(jnp.abs(top), 1.0)
    level = jax.lax.stop_gradient(score >= top - slack)
    count = level.sum(1, keepdims=True)
    uniform = 1 / score.shape[1]
    return jnp.where(count > 0, level / jnp.maximum(count, 1), uniform)
