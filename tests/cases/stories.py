"""A target's life told once for all tests: alone, as many variants, and with slopes.

Every story is one compiled program, and each is told once.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from cases import slopes
from cases.targets import NUM, base_inputs, case_of, grid, value

from jaxtrack.models import probability

KEY = np.array(jax.random.key_data(jax.random.key(0)))
BELIEFS = ("born", "middle", "late", "missed", "collapsed", "blended")


def story(target, inputs):
    """One life: born, two intervals, then missed, or detected in each of the places."""
    params = inputs.params
    born = target.begin(
        params, inputs.prior, inputs.mode_prob, jax.random.wrap_key_data(KEY)
    )

    def interval(belief, _):
        belief, log_survive = target.predict(params, belief, inputs.interval)
        return belief, (belief, log_survive)

    late, (moved, log_survive) = jax.lax.scan(interval, born, length=2)
    missed, log_miss = target.miss(params, late)
    view = target.look(params, late)
    corrected = jax.vmap(target.correct, (None, None, 0))(
        params, view, inputs.detections
    )
    few = jax.tree.map(lambda x: x[:NUM], corrected)
    uncertain = inputs.detections[:NUM]
    blended = target.blend(params, view, missed, blend_weight(inputs), uncertain)
    square, log_det = target.distance(params, view, uncertain)
    return {
        "born": born,
        "middle": jax.tree.map(lambda x: x[0], moved),
        "late": late,
        "missed": missed,
        "corrected": corrected,
        "collapsed": target.collapse(inputs.log_weight, few),
        "blended": target.adapt(params, blended, jnp.full_like(inputs.interval, 0.8)),
        "square": square,
        "log_det": log_det,
        "log_survive": log_survive,
        "log_miss": log_miss,
        "score": target.score(params, view, inputs.detections),
    }


def blend_weight(inputs):
    """The weights of four detections and of a miss; empty where all four are."""
    log_weight = inputs.log_weight
    return jnp.concatenate([log_weight, log_weight[:1] + 0.4])


def summary(target, told):
    """Moments, modes and losses of every belief of a story."""
    views = target.moments, target.modes, target.lost
    short = {name: tuple(view(told[name]) for view in views) for name in BELIEFS}
    short["corrected"] = tuple(jax.vmap(view)(told["corrected"]) for view in views)
    return short


def loss_of(target, inputs):
    """One number that everything in a story bears on, and the story."""
    told = story(target, inputs)
    belief = target.moments(told["collapsed"])
    scale = jnp.arange(1.0, belief.mean.size + 1)
    missed = target.moments(told["missed"])
    blended = target.moments(told["blended"])
    return (
        told["score"][:NUM].sum()
        + (told["square"] + told["log_det"]).sum() / 100
        + (blended.mean * scale).sum() / 100
        + (blended.cov * scale[None] * scale[:, None]).sum() / 100
        + told["log_miss"]
        + told["log_survive"].sum()
        + (belief.mean * scale).sum() / 100
        + (missed.mean * scale).sum() / 100
        + (belief.cov * scale[None] * scale[:, None]).sum() / 100
    ), told


class Telling(NamedTuple):
    """A story in NumPy: the loss, the beliefs and log-probabilities, and a summary."""

    loss: Any
    life: dict
    brief: dict


def tell(target, inputs):
    loss, told = loss_of(target, inputs)
    return Telling(loss, told, summary(target, told))


def variants(name):
    """Named variants of the inputs, to be told in one batch."""
    base = base_inputs(name)
    params = base.params
    weights = base.log_weight
    third = np.arange(NUM) == 2
    nobody = np.full(NUM, -np.inf)
    empty = np.where(third, nobody, weights)
    moved = base.detections + np.outer(third, case_of(name).reach * 0.1)
    immortal = params.survive
    if not isinstance(immortal, probability.Lifetime):
        immortal = jax.tree.map(np.ones_like, immortal)
    return {
        "base": base,
        "backwards": base._replace(detections=base.detections[::-1]),
        "heavier": base._replace(log_weight=weights + 7),
        "empty": base._replace(log_weight=empty),
        "empty, other": base._replace(log_weight=empty, detections=moved),
        "only third": base._replace(log_weight=np.where(third, -9.0, nobody)),
        "nobody": base._replace(log_weight=nobody),
        "at once": base._replace(
            params=params._replace(survive=immortal), interval=value(0.0)
        ),
    }


class Told(NamedTuple):
    """All variants of a case by name, and the slopes of the loss by differences."""

    variant: dict
    slopes: Any
    scale: Any
    num_traces: int


@functools.cache
def told(name):
    target, traces = case_of(name).target, []

    def counted(inputs):
        traces.append(name)
        return tell(target, inputs)

    named = variants(name)
    moved, scale = slopes.walks(named["base"])
    stacked = jax.tree.map(lambda *x: np.stack(x), *named.values())
    batch = jax.tree.map(lambda x, y: np.concatenate([x, y]), stacked, moved)
    compiled = jax.jit(jax.vmap(counted))
    compiled(batch)
    result = jax.tree.map(np.array, compiled(batch))
    pick = {
        key: jax.tree.map(lambda x, i=i: x[i], result) for i, key in enumerate(named)
    }
    found = slopes.differences(result.loss[len(named) :])
    return Told(pick, found, scale, len(traces))


class Alone(NamedTuple):
    """One story without a batch, and what a grid of detections would have taught.

    Attributes:
        telling: The story of `base_inputs`.
        slope: The gradient of its loss.
        empty_slope: The same where a slot is empty.
        only: Moments of the first corrected belief, collapsed on its own.
        score: Of the detections of the grid, [G].
        seen: Moments and modes after each of them, [G, ...].
        cell: The volume between detections of the grid.
    """

    telling: Telling
    slope: Any
    empty_slope: Any
    only: Any
    score: Any
    seen: Any
    cell: float


@functools.cache
def alone(name):
    target, base = case_of(name).target, base_inputs(name)
    points, cell = grid(name)

    @jax.jit
    def compiled(inputs):
        (loss, told), slope = jax.value_and_grad(
            lambda inputs: loss_of(target, inputs), has_aux=True
        )(inputs)
        one = jax.tree.map(lambda x: x[:1], told["corrected"])
        only = target.moments(target.collapse(inputs.log_weight[:1], one))
        return Telling(loss, told, summary(target, told)), slope, only

    wide = base._replace(detections=np.concatenate([base.detections, points]))
    empty = np.where(np.arange(NUM) == 2, -np.inf, base.log_weight)
    (loss, life, brief), slope, only = jax.tree.map(np.array, compiled(wide))
    empty_slope = jax.tree.map(np.array, compiled(wide._replace(log_weight=empty))[1])

    def cut(tree):
        return jax.tree.map(lambda x: x[:NUM], tree)

    score, seen = (
        life["score"][NUM:],
        jax.tree.map(lambda x: x[NUM:], brief["corrected"][:2]),
    )
    life = {**life, "score": cut(life["score"]), "corrected": cut(life["corrected"])}
    brief = {**brief, "corrected": cut(brief["corrected"])}
    slope = slope._replace(detections=slope.detections[:NUM])
    telling = Telling(loss, life, brief)
    return Alone(telling, slope, empty_slope, only, score, seen, cell)


@functools.cache
def in_float32(name):
    """The story in float32, where that is the default."""
    target = case_of(name).target
    inputs = jax.tree.map(lambda x: np.array(x, np.float32), base_inputs(name))
    with jax.enable_x64(False):
        told = jax.jit(functools.partial(tell, target))(inputs)
        return jax.tree.map(np.array, told)
