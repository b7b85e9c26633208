"""Truth drawn from what a tracker assumes: births, deaths, motion, mode switching.

What a tracker is told is then all there is to know, so that its evidence can be trusted
and what is learned from such scans can be held against the truth.

    >>> import jax, jax.numpy as jnp
    >>> from jaxtrack import models
    >>> from jaxtrack.scenarios import drawn
    >>> from jaxtrack.targets import single
    >>> target = single.Params(
    ...     motion=models.motion.ConstantVelocity(jnp.ones(1)),
    ...     sensor=models.sensor.Position(jnp.ones(1)),
    ...     survive=models.probability.Constant(jnp.array(1.0)),
    ...     detect=models.probability.Constant(jnp.array(0.9)))
    >>> birth = models.birth.MultiBernoulliBirth(
    ...     existence_prob=jnp.ones(1), mean=jnp.zeros((1, 2)),
    ...     cov=jnp.eye(2)[None], mode_prob=jnp.ones((1, 1)))
    >>> truth = drawn.draw(jax.random.key(0), target, birth, jnp.ones(4))
    >>> print(truth.exists.sum(1))  # one more in each scan, none of whom dies
    [1 2 3 4]
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.entries import dense
from jaxtrack.models.birth import MultiBernoulliBirth, PoissonBirth
from jaxtrack.scenarios.world import Truth
from jaxtrack.types import Array

Birth = MultiBernoulliBirth | PoissonBirth


class Living(NamedTuple):
    """N possible targets: state [N, D], mode [N] (int), exists [N] (bool)."""

    state: Array
    mode: Array
    exists: Array


def draw(
    key: Array,
    target: Any,
    birth: Birth,
    intervals: Array,
    start: Birth | None = None,
    room: int = 1,
) -> Truth:
    """Draws the targets of one run.

    Every possible target has a slot: first those of `start`, who are there one interval
    before the first scan, then the births of each scan.

    Args:
        key: Random key.
        target: `Params` of a target: motion or motions and switching, and survive, of
            which each motion has noise in all components.
        birth: Who may be born in a scan, there when it is taken; covariances are
            positive definite.
        intervals: Seconds before each scan, [T].
        start: Who may be there before the first scan.
        room: Born at one place in one scan at most, where their number is Poisson. What
            is beyond is missing: with a rate of 0.1 in one scan of 200 if it is 1, in
            one of 6,000 if it is 2.

    Returns:
        States [T, N, D] with N = T B room, and those of `start`.
    """
    keys, num_scans = jax.random.split(key, 3), len(intervals)
    first = [] if start is None else [_begin(keys[0], start, room)]
    born = jax.vmap(lambda key: _begin(key, birth, room))(
        jax.random.split(keys[1], num_scans)
    )
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), born)
    everyone = jax.tree.map(lambda *x: jnp.concatenate(x), *first, flat)
    since = jnp.repeat(jnp.arange(num_scans), born.exists.shape[1])
    since = jnp.concatenate([jnp.full(len(everyone.mode) - since.size, -1), since])

    def step(now: Living, given: tuple) -> tuple[Living, Living]:
        scan, interval, key = given
        each = jax.random.split(key, len(since))
        moved = jax.vmap(lambda key, x: _move(key, target, x, interval))(each, now)
        here, later = since < scan, since > scan
        new = jax.tree.map(
            lambda x, y: jnp.where(here.reshape(-1, *[1] * (x.ndim - 1)), x, y),
            moved,
            everyone,
        )
        return new, new._replace(exists=new.exists & ~later)

    scans = jnp.arange(num_scans), intervals, jax.random.split(keys[2], num_scans)
    _, path = jax.lax.scan(step, everyone, scans)
    return Truth(path.state, path.exists, jnp.cumsum(intervals))


def _begin(key: Array, birth: Birth, room: int) -> Living:
    """Draws who begins, of B places."""
    keys = jax.random.split(key, 3)
    places, dim = birth.mean.shape
    if isinstance(birth, PoissonBirth):
        number = jax.random.poisson(keys[0], birth.rate, (places,))
    else:
        uniform = jax.random.uniform(keys[0], (places,), birth.mean.dtype)
        number, room = (uniform < birth.existence_prob).astype(int), 1
    white = jax.random.normal(keys[1], (places, room, dim), birth.mean.dtype)
    lower = jnp.linalg.cholesky(birth.cov)
    state = birth.mean[:, None] + jnp.einsum("bij,brj->bri", lower, white)
    odds = linalg.safe_log(birth.mode_prob)[:, None]
    mode = jax.random.categorical(keys[2], odds, axis=-1, shape=(places, room))
    exists = jnp.arange(room)[None] < number[:, None]
    return Living(state.reshape(-1, dim), mode.ravel(), exists.ravel())


def _move(key: Array, target: Any, one: Living, interval: Array) -> Living:
    """Lets a target live, switch and move, or die; scalars but for the state."""
    keys = jax.random.split(key, 3)
    prob = target.survive.prob(one.mode, one.state, interval)
    exists = one.exists & (jax.random.uniform(keys[0]) < prob)
    motions = getattr(target, "motions", None) or (target.motion,)
    mode = one.mode
    if len(motions) > 1:
        odds = target.switching.log_transition(interval)[mode]
        mode = jax.random.categorical(keys[1], odds)
    white = jax.random.normal(keys[2], one.state.shape, one.state.dtype)

    def go(motion: Any) -> Array:
        noise = dense(linalg.cholesky(motion.noise(interval)))
        return motion.move(one.state, interval) + noise @ white

    return Living(jnp.stack([go(motion) for motion in motions])[mode], mode, exists)
