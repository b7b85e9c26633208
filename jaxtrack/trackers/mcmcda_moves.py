"""Moves from one hypothesis to another, with the probability to propose them.

A hypothesis is a table: in each row the detections of a track, -1 for none in a scan,
and rows of nothing but -1 are empty. Which row a track stands in does not matter. The
moves come in pairs, each the other's way back:

    birth        a free detection and whatever free ones follow; death of a whole track
    extension    of a track by free detections; reduction to its first few
    split        of a track into an earlier and a later one; merge of two
    update       of a track from some detection on
    switch       of what two tracks have from some scan on

What follows a detection is drawn scan by scan with `Problem.links`, so that likely
continuations are proposed and any other one may be.

    >>> from jaxtrack.trackers import mcmcda_moves
    >>> mcmcda_moves.KINDS[:4]
    ('birth', 'death', 'extension', 'reduction')

Reference: Oh, Russell and Sastry, "Markov chain Monte Carlo data association for multi-
target tracking", IEEE Trans. Automatic Control 54(3), 2009, section V. There tracks
have two detections at least, and the next one is drawn evenly among those near.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.trackers import mcmcda_table
from jaxtrack.trackers.mcmcda_table import Proposal
from jaxtrack.types import Array

KINDS = (
    *("birth", "death", "extension", "reduction", "update"),
    *("split", "merge", "switch"),
)
BIRTH, DEATH, EXTENSION, REDUCTION, UPDATE, SPLIT, MERGE, SWITCH = range(8)


def propose(
    key: Array, kind: Array, table: Array, valid: Array, links: Array
) -> Proposal:
    """Draws a move of some kind.

    Args:
        key: Random key.
        kind: Index into `KINDS`.
        table: [N, T].
        valid: Which slots of the scans hold a detection, [T, K].
        links: Log-odds of a detection as the next one of a track, [T K, T, K].
    """
    family = jnp.where(kind < SPLIT, 0, jnp.where(kind < SWITCH, 1, 2))
    families = _redraw, _split_or_merge, _switch
    links = links.astype(float)  # all branches are to be of one type
    return jax.lax.switch(family, families, key, kind, table, valid, links)


class _Part(NamedTuple):
    """What a move leaves of a track, and what it draws anew.

    Attributes:
        kept: [T].
        old: What goes, [T].
        start: Flat index of the detection that the new ones follow.
        log_forward: Of the choices made so far.
        possible: Whether they can be made.
    """

    kept: Array
    old: Array
    start: Array
    log_forward: Array
    possible: Array


def _redraw(
    key: Array, kind: Array, table: Array, valid: Array, links: Array
) -> Proposal:
    """Keeps the first detections of a track and draws those that follow."""
    keys = jax.random.split(key)
    there = (table >= 0).any(1)
    num, opened = there.sum(), mcmcda_table.free(table, valid)
    birth = kind == BIRTH
    evenly = mcmcda_table.some(jnp.where(there, 0.0, -jnp.inf))
    picked = jax.random.categorical(keys[0], evenly)
    slot = jnp.where(birth, jnp.argmin(there), picked)
    part = _part(keys[0], kind, table[slot], opened, num)
    possible = part.possible & jnp.where(birth, ~there.all(), num > 0)
    opened = opened | mcmcda_table.marks(part.old, valid)
    noise = jax.random.gumbel(keys[1], (len(valid), valid.shape[1] + 1), links.dtype)
    both = jax.vmap(mcmcda_table.walk, (None, None, None, None, None, 0))
    forced = jnp.array([False, True])
    tails, log_probs = both(links, opened, part.start, noise, part.old, forced)
    draws = birth | (kind == EXTENSION) | (kind == UPDATE)
    row = jnp.where(draws & (tails[0] >= 0), tails[0], part.kept)
    size, before = (row >= 0).sum(), (table[slot] >= 0).sum()
    log = mcmcda_table.log_number
    log_backward = jnp.stack(
        [
            -log(num + 1),
            log_probs[1] - log(opened.sum()),
            -log(num) - log(size - 1),
            log_probs[1] - log(num),
            log_probs[1] - log(num) - log(size),
        ]
    )[jnp.minimum(kind, UPDATE)]
    return Proposal(
        table=table.at[slot].set(row),
        changed=jnp.stack([slot, slot]),
        log_forward=part.log_forward + jnp.where(draws, log_probs[0], 0.0),
        log_backward=log_backward,
        possible=possible & ((kind != EXTENSION) | (size > before)),
        choice=(part.kept >= 0).sum() + (len(valid) + 1) * slot,
    )


def _part(key: Array, kind: Array, row: Array, opened: Array, num: Array) -> _Part:
    """Chooses what to keep of a track: for a birth, its first detection."""
    num_slots, size = opened.shape[1], (row >= 0).sum()
    # A reduction keeps 1 to size - 1, an update 1 to size.
    choices = jnp.where(kind == REDUCTION, size - 1, size)
    keys = jax.random.split(jax.random.fold_in(key, 1))
    cut = 1 + jax.random.randint(keys[0], (), 0, jnp.maximum(choices, 1))
    cut = jnp.where(kind == EXTENSION, size, jnp.where(kind == DEATH, 0, cut))
    kept = jnp.where(jnp.cumsum(row >= 0) <= cut, row, -1)
    evenly = mcmcda_table.some(jnp.where(opened, 0.0, -jnp.inf))
    born = jax.random.categorical(keys[1], evenly.ravel())
    scans = jnp.arange(len(row))
    begun = jnp.where(scans == born // num_slots, born % num_slots, -1)
    kept = jnp.where(kind == BIRTH, begun, kept)
    first = jnp.argmax(row >= 0)
    last = jnp.where(kept >= 0, scans, -1).max()
    at = jnp.where(kind == DEATH, first, last)
    column = jnp.where(kind == DEATH, row[first], kept[at])
    log_cut = jnp.where(
        (kind == REDUCTION) | (kind == UPDATE), -mcmcda_table.log_number(choices), 0.0
    )
    log_choice = jnp.where(
        kind == BIRTH,
        -mcmcda_table.log_number(opened.sum()),
        log_cut - mcmcda_table.log_number(num),
    )
    return _Part(
        kept=kept,
        old=jnp.where(kept >= 0, -1, row),
        start=at * num_slots + jnp.maximum(column, 0),
        log_forward=log_choice,
        possible=jnp.where(kind == BIRTH, opened.any(), choices > 0),
    )


def _split_or_merge(
    key: Array, kind: Array, table: Array, valid: Array, links: Array
) -> Proposal:
    """Cuts a track in two, evenly anywhere, or joins two by how well they link."""
    there = (table >= 0).any(1)
    log_cuts = _log_cuts(table)
    cut = jax.random.categorical(key, mcmcda_table.some(log_cuts).ravel())
    whole, scan = jnp.divmod(cut, table.shape[1])
    late = jnp.arange(table.shape[1]) >= scan
    spare = jnp.argmin(there)
    row = table[whole]
    parted = table.at[whole].set(jnp.where(late, -1, row))
    parted = parted.at[spare].set(jnp.where(late, row, -1))

    log_pairs = _log_pairs(table, valid, links)
    pair = jax.random.categorical(key, mcmcda_table.some(log_pairs).ravel())
    early, later = jnp.divmod(pair, len(table))
    joined = table.at[early].set(jnp.maximum(table[early], table[later]))
    joined = joined.at[later].set(-1)

    splits = kind == SPLIT
    changed = jnp.where(splits, jnp.stack([whole, spare]), jnp.stack([early, later]))
    apart, one = jnp.where(splits, parted, table), jnp.where(splits, table, joined)
    log_join = _log_pairs(apart, valid, links)
    log_join = log_join[changed[0], changed[1]] - mixture.total(log_join.ravel())
    log_split = -mixture.total(_log_cuts(one).ravel())
    room = (log_cuts > -jnp.inf).any() & ~there.all()
    return Proposal(
        table=jnp.where(splits, parted, joined),
        changed=changed,
        log_forward=jnp.where(splits, log_split, log_join),
        log_backward=jnp.where(splits, log_join, log_split),
        possible=jnp.where(splits, room, (log_pairs > -jnp.inf).any()),
        choice=jnp.zeros((), changed.dtype),
    )


def _log_cuts(table: Array) -> Array:
    """Returns 0 where a track may be cut, before all its detections but the first."""
    rank = jnp.cumsum(table >= 0, axis=1)
    return jnp.where((table >= 0) & (rank > 1), 0.0, -jnp.inf)


def _log_pairs(table: Array, valid: Array, links: Array) -> Array:
    """Returns the log-weights of an earlier and a later track as one, [N, N]."""
    scans, num_slots = jnp.arange(table.shape[1])[None], valid.shape[1]
    there, tracks = (table >= 0).any(1), jnp.arange(len(table))
    last = jnp.where(table >= 0, scans, -1).max(1)
    first = jnp.argmax(table >= 0, axis=1)
    source = jnp.maximum(last * num_slots + table[tracks, last], 0)
    column = jnp.maximum(table[tracks, first], 0)
    weight = links[source[:, None], first[None], column[None]]
    joins = there[:, None] & there[None] & (last[:, None] < first[None])
    return jnp.where(joins, weight, -jnp.inf)


def _switch(
    key: Array, kind: Array, table: Array, valid: Array, links: Array
) -> Proposal:
    """Lets two tracks trade what they have from some scan on."""
    del kind, valid
    keys, (size, num_scans) = jax.random.split(key), table.shape
    there = (table >= 0).any(1)
    order = jnp.arange(size)
    pairs = there[:, None] & there[None] & (order[:, None] < order[None])
    log_pairs = jnp.where(pairs, 0.0, -jnp.inf)
    one, two = jnp.divmod(
        jax.random.categorical(keys[0], mcmcda_table.some(log_pairs).ravel()), size
    )
    scan = jax.random.randint(keys[1], (), 1, max(num_scans, 2))
    late = jnp.arange(num_scans) >= scan
    first = jnp.where(late, table[two], table[one])
    second = jnp.where(late, table[one], table[two])
    both = (first >= 0).any() & (second >= 0).any()
    log_prob = -mcmcda_table.log_number(pairs.sum()) - jnp.log(
        float(max(num_scans - 1, 1))
    )
    return Proposal(
        table=table.at[one].set(first).at[two].set(second),
        changed=jnp.stack([one, two]),
        log_forward=log_prob,
        log_backward=log_prob,
        possible=pairs.any() & both & (num_scans > 1),
        choice=scan,
    )
