"""Which tracks to believe: three rules to confirm a tentative track and to drop one.

A `Record` remembers what each track has done; a rule reads it.

- `MofN`: confirmed by M detections in N scans, dropped by so many misses.
- `ScoreTest`: Wald's sequential test of the track against clutter, on the sum of its
  log-likelihood ratios; a confirmed track goes when its score falls far from its peak.
- `Existence`: by the probability that it exists. The trackers that weigh tracks by it
  are the integrated ones (IPDA, JIPDA).

    >>> import jax.numpy as jnp
    >>> from jaxtrack.trackers import management
    >>> rule = management.MofN(confirm_hits=2, confirm_scans=3)
    >>> record = management.begin(jnp.array([0.1]), num_hits=1)
    >>> record = management.record(record, jnp.array([0.9]), jnp.array([3.0]))
    >>> print(rule.confirms(record, jnp.array([0.8])))
    [ True]

References: Blackman and Popoli, "Design and Analysis of Modern Tracking Systems", 1999,
section 6.2; Wald, "Sequential Analysis", 1947; Musicki and Evans 2004.
"""

import math
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.types import Array, Gaussian


class Record(NamedTuple):
    """What N tracks have done.

    Attributes:
        hits: The last 32 scans as bits, the newest lowest; set where it was likelier
            detected than not, and the scan speaks for it, [N].
        age: Scans since it was begun, that one counted, [N] (int).
        score: Sum of its log-likelihood ratios against clutter, [N].
        peak: The largest score so far, [N].
        confirmed: [N] (bool).
    """

    hits: Array
    age: Array
    score: Array
    peak: Array
    confirmed: Array


class Rule(Protocol):
    """How tracks are confirmed and dropped; see `MofN`."""

    def confirms(self, record: Record, existence_prob: Array) -> Array:
        """Returns which tracks are confirmed from now on, [N] (bool)."""
        ...

    def drops(self, record: Record, existence_prob: Array) -> Array:
        """Returns which tracks go, [N] (bool)."""
        ...


class MofN(NamedTuple):
    """Counts detections, and counts the first, which began the track.

    Attributes:
        confirm_hits: M detections ...
        confirm_scans: ... in the last N scans confirm a track; one that cannot have
            them in its first N scans goes.
        drop_misses: A confirmed track goes after so many misses ...
        drop_scans: ... in so many scans.
    """

    confirm_hits: int = 3
    confirm_scans: int = 5
    drop_misses: int = 5
    drop_scans: int = 5

    def confirms(self, record: Record, existence_prob: Array) -> Array:
        """Returns which tracks are confirmed from now on, [N] (bool)."""
        del existence_prob
        return _count(record.hits, self.confirm_scans) >= self.confirm_hits

    def drops(self, record: Record, existence_prob: Array) -> Array:
        """Returns which tracks go, [N] (bool)."""
        del existence_prob
        left = jnp.maximum(self.confirm_scans - record.age, 0)
        hopeless = _count(record.hits, self.confirm_scans) + left < self.confirm_hits
        seen = jnp.minimum(record.age, self.drop_scans)
        misses = seen - _count(record.hits, self.drop_scans)
        return jnp.where(record.confirmed, misses >= self.drop_misses, hopeless)


class ScoreTest(NamedTuple):
    """Tests a track against clutter, scan by scan, until one of the two is likely.

    Attributes:
        false_confirm_prob: Chance to confirm a track of clutter.
        false_drop_prob: Chance to drop a track of a target.
        drop_fall: A confirmed track goes when its score is so much below its peak.
    """

    false_confirm_prob: float = 1e-4
    false_drop_prob: float = 1e-2
    drop_fall: float = 9.0

    def confirms(self, record: Record, existence_prob: Array) -> Array:
        """Returns which tracks are confirmed from now on, [N] (bool)."""
        del existence_prob
        limit = math.log((1 - self.false_drop_prob) / self.false_confirm_prob)
        return record.score >= limit

    def drops(self, record: Record, existence_prob: Array) -> Array:
        """Returns which tracks go, [N] (bool)."""
        del existence_prob
        limit = math.log(self.false_drop_prob / (1 - self.false_confirm_prob))
        fallen = record.score <= record.peak - self.drop_fall
        return jnp.where(record.confirmed, fallen, record.score <= limit)


class Existence(NamedTuple):
    """Asks how probable it is that the track exists.

    Attributes:
        confirm_prob: Above this a track is confirmed.
        drop_prob: Below this it goes.
    """

    confirm_prob: float = 0.9
    drop_prob: float = 1e-3

    def confirms(self, record: Record, existence_prob: Array) -> Array:
        """Returns which tracks are confirmed from now on, [N] (bool)."""
        del record
        return existence_prob > self.confirm_prob

    def drops(self, record: Record, existence_prob: Array) -> Array:
        """Returns which tracks go, [N] (bool)."""
        del record
        return existence_prob < self.drop_prob


def check(rule: Rule) -> None:
    """Raises a ValueError for a rule that makes no sense."""
    if isinstance(rule, MofN):
        _check_counts("confirm", rule.confirm_hits, rule.confirm_scans)
        _check_counts("drop", rule.drop_misses, rule.drop_scans)
    if isinstance(rule, ScoreTest):
        confirm, drop = rule.false_confirm_prob, rule.false_drop_prob
        for name, value in rule._asdict().items():
            if not (value > 0 and (value < 1 or name == "drop_fall")):
                remedy = "a fall above 0" if name == "drop_fall" else "0 < p < 1"
                raise ValueError(f"{name} is {value}; give {remedy}")
        if not confirm + drop < 1:
            raise ValueError(
                f"false_confirm_prob and false_drop_prob are {confirm} and {drop}; "
                "give two that add up to less than 1"
            )
    if isinstance(rule, Existence) and not 0 <= rule.drop_prob < rule.confirm_prob < 1:
        raise ValueError(
            f"drop_prob is {rule.drop_prob} and confirm_prob is {rule.confirm_prob}; "
            "give 0 <= drop_prob < confirm_prob < 1"
        )


def _check_counts(name: str, count: int, scans: int) -> None:
    whole = isinstance(count, int) and isinstance(scans, int)
    if not (whole and 1 <= count <= scans <= 32):
        raise ValueError(
            f"{name} takes {count} of {scans} scans; give 1 <= M <= N <= 32"
        )


def begin(existence_prob: Array, num_hits: int) -> Record:
    """Makes the records of newborn tracks and of empty slots.

    Args:
        existence_prob: 0 marks an empty slot, [N].
        num_hits: Detections that began a track, which count.
    """
    started = existence_prob > 0
    zero = jnp.zeros_like(existence_prob)
    return Record(
        hits=jnp.where(started, jnp.uint32((1 << num_hits) - 1), jnp.uint32(0)),
        age=(started * num_hits).astype(int),
        score=zero,
        peak=zero,
        confirmed=jnp.zeros_like(started),
    )


def record(record: Record, detected_prob: Array, log_ratio: Array) -> Record:
    """Adds a scan to the records.

    Args:
        record: Of N tracks.
        detected_prob: Probability that one of the detections is the track's, [N].
        log_ratio: Log-likelihood ratio of the track against clutter, [N].
    """
    # A track with a wide gate always finds some clutter; that is no hit unless the
    # scan is better explained with the track than without.
    hit = ((detected_prob > 0.5) & (log_ratio > 0)).astype(jnp.uint32)
    score = record.score + log_ratio.astype(record.score.dtype)
    return Record(
        hits=(record.hits << 1) | hit,
        age=record.age + 1,
        score=score,
        peak=jnp.maximum(record.peak, score),
        confirmed=record.confirmed,
    )


def duplicates(belief: Gaussian, rank: Array, threshold: float) -> Array:
    """Finds the tracks that follow a target which a track of higher rank follows.

    Args:
        belief: Mean [N, D] and covariance [N, D, D] of N tracks.
        rank: Which of two stays; 0 for an empty slot, [N].
        threshold: Squared Mahalanobis distance, by the sum of the two covariances.

    Returns:
        [N] (bool).
    """
    slot = jnp.arange(rank.size)
    tied = (rank[:, None] == rank[None]) & (slot[:, None] > slot[None])
    behind = ((rank[:, None] < rank[None]) | tied) & (rank[:, None] > 0)

    def square(one: Gaussian, other: Gaussian) -> Array:
        lower = linalg.cholesky(one.cov + other.cov)
        white = linalg.solve_lower(lower, one.mean - other.mean)
        return (white * white).sum()

    distance = jax.vmap(jax.vmap(square, (None, 0)), (0, None))(belief, belief)
    return (behind & (distance <= threshold)).any(1)


def _count(hits: Array, num_scans: int) -> Array:
    """Returns how many of the newest bits are set, [N] (int)."""
    window = jnp.uint32((1 << num_scans) - 1)
    return jax.lax.population_count(hits & window).astype(int)
