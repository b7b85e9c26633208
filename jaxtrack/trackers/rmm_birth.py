"""New tracks from detections that no track has, by a linear programme.

A new track has an unassigned detection in the first scan of the window, and its leaves
are the unassigned ones of the later scans. Its score is the log of how much likelier it
is that there is such a target than that all is clutter; against its leaves stands a
start that is not worth it.

    >>> from jaxtrack.trackers import rmm_birth
    >>> rmm_birth.New._fields
    ('belief', 'log_first', 'leaves', 'share', 'begins', 'dropped')

Reference: Liu, Shen, Wang and Meng, "Randomized multimodel multiple hypothesis
tracking", 2021, supplement, appendix C.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.targets import imm
from jaxtrack.trackers import rmm_association, rmm_leaves, undetected
from jaxtrack.trackers.rmm_leaves import Leaves, Rules, Window
from jaxtrack.trackers.undetected import Params, Undetected
from jaxtrack.types import Array, Gaussian, Scan


class Starts(NamedTuple):
    """When a track is begun: settings, all of them static.

    Attributes:
        max_new: Tracks begun in a scan, J.
        max_contested: As in `rmm_association.share`.
        unassigned_prob: A detection may begin a track if it is no track's with more
            probability than this (P_th^unas).
        init_prob: And if the shares of its leaves add up to more than this (P_th^init).
        worth: A track is begun where its target exists with more probability.
    """

    max_new: int
    max_contested: int
    unassigned_prob: float
    init_prob: float
    worth: float


class New(NamedTuple):
    """J tracks, some of which begin.

    Attributes:
        belief: With the first detection: mean [J, D], cov [J, D, D].
        log_first: Log-odds of existence by that detection alone, [J].
        leaves: Over the later scans, [J, ...].
        share: Of leaves, [J, L].
        begins: [J] (bool).
        dropped: Expected number of targets for which J had no room.
    """

    belief: Gaussian
    log_first: Array
    leaves: Leaves
    share: Array
    begins: Array
    dropped: Array


def find(
    starts: Starts,
    rules: Rules,
    params: Params,
    hidden: Undetected,
    hits: Array,
    window: Window,
    key: Array,
) -> tuple[New, Undetected, Array]:
    """Finds the tracks that begin in the first scan of a window.

    Args:
        starts: Settings.
        rules: How leaves grow.
        params: The tracker's `Params`.
        hidden: Targets not detected before it.
        hits: How likely tracks have each detection, summed over tracks, [S, K].
        window: S scans.
        key: Random key.

    Returns:
        The tracks, the targets not detected since, and how many the first scan is
        expected to detect for the first time.
    """
    target, keys = imm.imm(), jax.random.split(key)
    first = jax.tree.map(lambda x: x[0], window)
    seen = rmm_leaves.through(params, first.through)
    scan = Scan(first.detections, first.valid, first.interval)
    later = undetected.predict(target, seen, hidden, first.interval, keys[0])
    firsts = undetected.see(target, seen, later, scan, keys[1])
    belief = jax.vmap(target.moments)(firsts.belief)
    new = _begin(starts, rules, params, belief, firsts.log_score, hits, window)
    before = _longer(hidden, len(firsts.missed.log_weight))
    missed = jax.tree.map(
        lambda x, y: jnp.where(first.looked, x, y), firsts.missed, before
    )
    return new, missed, jnp.where(first.looked, firsts.found, 0.0)


def _longer(hidden: Undetected, size: int) -> Undetected:
    """Adds empty slots at the end."""
    short = size - len(hidden.log_weight)
    if not short:
        return hidden
    last = jax.tree.map(lambda x: jnp.concatenate([x, x[:1].repeat(short, 0)]), hidden)
    here = jnp.arange(size) < len(hidden.log_weight)
    return last._replace(log_weight=jnp.where(here, last.log_weight, -jnp.inf))


def _begin(
    starts: Starts,
    rules: Rules,
    params: Params,
    belief: Gaussian,
    log_first: Array,
    hits: Array,
    window: Window,
) -> New:
    """Chooses the tracks that begin, of one possible with each detection, [K]."""
    free = window.valid & (1 - hits > starts.unassigned_prob)
    log_first = jnp.where(free[0], log_first, -jnp.inf)
    later = jax.tree.map(lambda x: x[1:], window._replace(valid=free))
    size = min(starts.max_new, len(log_first))
    rough = log_first + _promise(rules, params, belief, later)
    rank, first = jax.lax.top_k(rough, size)
    belief = jax.tree.map(lambda x: x[first], belief)
    log_first = jnp.where(rank > -jnp.inf, log_first[first], -jnp.inf)
    leaves = _leaves(rules, params, belief, later)
    there = (log_first > -jnp.inf)[:, None]
    score = jnp.where(there, log_first[:, None] + leaves.log_score, -jnp.inf)
    worth = jnp.log(starts.worth) - jnp.log1p(-starts.worth)
    nothing = jnp.where(there, worth, -jnp.inf).astype(score.dtype)
    both = jnp.concatenate([score, nothing], axis=1)
    past = jnp.pad(leaves.past, ((0, 0), (0, 1), (0, 0)), constant_values=-1)
    num = free.shape[1]
    found = rmm_association.share(both, past, num, starts.max_contested)
    share = found.leaf[:, :-1]
    taken = jnp.zeros(len(rough), bool).at[first].set(True)
    over = jnp.where(taken | (rough <= worth), 0.0, jax.nn.sigmoid(rough))
    return New(
        belief,
        log_first,
        leaves,
        share,
        begins=share.sum(1) > starts.init_prob,
        dropped=over.sum(),
    )


def _promise(rules: Rules, params: Params, belief: Gaussian, later: Window) -> Array:
    """Returns the best score of each new track in the next scan, [K]."""
    if not later.interval.size:
        return jnp.zeros(len(belief.mean), belief.mean.dtype)
    one = jax.tree.map(lambda x: x[:1], later)
    few = rules._replace(max_leaves=2)
    grow = jax.vmap(lambda x: rmm_leaves.grow(few, params, x, one))
    return grow(belief).log_score.max(1)


def _leaves(rules: Rules, params: Params, belief: Gaussian, later: Window) -> Leaves:
    """Grows the leaves of J new tracks; a window without later scans has one each."""
    grow = jax.vmap(lambda x: rmm_leaves.grow(rules, params, x, later))
    return grow(belief)
