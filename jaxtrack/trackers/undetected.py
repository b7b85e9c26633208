"""Targets that are there and were never detected: a Poisson intensity of them.

Trackers that follow hypotheses start a track where a target is detected for the first
time. How likely that is, and with what belief, comes from here: from births at known
places, of which those missed so far stay and move on; or, with `DetectionBirth`, from
the detection alone. Then `rate` is the expected number of targets a second that are
detected for the first time, and they are so wherever clutter falls (Reid's density of
new targets, which has the probability of detection in it). Its `max_existence_prob` is
for trackers that propose births a scan ahead.

    >>> from jaxtrack.trackers import undetected
    >>> undetected.Params._fields
    ('target', 'birth', 'clutter', 'undetected', 'start')

References: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic
Control 24(6), 1979; Chong, Mori and Reid, "Forty years of multiple hypothesis
tracking", Journal of Advances in Information Fusion 14(2), 2019, equations 9 to 12.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import mixture
from jaxtrack.linalg import safe_log
from jaxtrack.models.birth import DetectionBirth, MultiBernoulliBirth, PoissonBirth
from jaxtrack.trackers import bernoulli, birth_times
from jaxtrack.trackers.association import LEAST_LOG_WEIGHT
from jaxtrack.types import Array, Gaussian, PyTree, Scan, Target


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        target: The `Params` of the target.
        birth: `models.birth.PoissonBirth` (known places, in every scan after the
            prediction) or `DetectionBirth` (anywhere, at the first detection); for
            `mbm` and `mbm01` `MultiBernoulliBirth`, and nobody undetected.
        clutter: Of `models.clutter`.
        undetected: Targets expected to be there before the first scan, not detected
            yet, or None. With a `DetectionBirth` it must be None.
        start: Targets that may be known before the first scan, or None.
    """

    target: Any
    birth: PoissonBirth | DetectionBirth | MultiBernoulliBirth
    clutter: Any
    undetected: PoissonBirth | None = None
    start: MultiBernoulliBirth | None = None


class Undetected(NamedTuple):
    """U components of the intensity.

    Attributes:
        log_weight: Of the expected number of targets; -inf marks an empty slot, [U].
        belief: [U, ...].
        born: How likely each was born 0, 1, ..., A - 1 or more scans ago, [U, A], or
            None; see `birth_times`.
    """

    log_weight: Array
    belief: PyTree
    born: Array | None = None

    @property
    def expected(self) -> Array:
        """Returns the expected number of undetected targets, a scalar."""
        return jnp.exp(self.log_weight).sum()


class Firsts(NamedTuple):
    """First detections, one possible with each detection of a scan.

    Attributes:
        log_score: Log-density of a target detected here for the first time, against
            that of clutter; -inf where there is no detection, [K].
        belief: About that target, [K, ...].
        missed: What stays undetected.
        found: Expected number of targets that the scan detects for the first time.
        birth_prob: How likely each was born so many scans ago, [K, A], or None.
    """

    log_score: Array
    belief: PyTree
    missed: Undetected
    found: Array
    birth_prob: Array | None = None


def check(params: Params) -> None:
    """Raises a ValueError where the ways to be born contradict each other."""
    if not isinstance(params.birth, (PoissonBirth, DetectionBirth)):
        raise ValueError(
            f"birth is a {type(params.birth).__name__}; give a PoissonBirth or a "
            "DetectionBirth"
        )
    if isinstance(params.birth, DetectionBirth) and params.undetected is not None:
        raise ValueError(
            "undetected is given and birth is a DetectionBirth, which says where new "
            "targets are detected; give a PoissonBirth, or None as undetected"
        )


def begin(
    target: Target, params: Params, size: int, key: Array, num_birth_times: int = 0
) -> Undetected:
    """Makes the intensity before the first scan, in U slots.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        size: U.
        key: Random key.
        num_birth_times: A, times of birth told apart; 0 for none.

    Raises:
        ValueError: Ways to be born contradict each other, or there is no room.
    """
    check(params)
    birth = params.birth
    driven = isinstance(birth, DetectionBirth)
    mode_prob = birth.mode_prob if driven else birth.mode_prob[0]
    empty = bernoulli.nobody(target, params.target, mode_prob, size, key)
    born = birth_times.newborn(size, num_birth_times)
    nobody = Undetected(safe_log(empty.existence_prob), empty.belief, born)
    if params.undetected is None:
        return nobody
    known = _born(target, params, params.undetected, key, born)
    if (room := size - known.log_weight.size) < 0:
        raise ValueError(
            f"undetected has {known.log_weight.size} places and there is room for "
            f"{size}; make room for them"
        )
    rest = jax.tree.map(lambda x: x[:room], nobody)
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y]), known, rest)


def predict(
    target: Target, params: Params, undetected: Undetected, interval: Array, key: Array
) -> Undetected:
    """Lets targets survive and move, and adds those born: U + B components.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        undetected: U components.
        interval: Seconds.
        key: Random key.
    """
    belief, log_survive = jax.vmap(target.predict, (None, 0, None))(
        params.target, undetected.belief, interval
    )
    born = birth_times.older(undetected.born)
    survived = Undetected(undetected.log_weight + log_survive, belief, born)
    if isinstance(params.birth, DetectionBirth):
        return survived
    new = _born(target, params, params.birth, key, born)
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y]), survived, new)


def see(
    target: Target, params: Params, undetected: Undetected, scan: Scan, key: Array
) -> Firsts:
    """Finds what may be detected for the first time, and what stays undetected.

    Args:
        target: How one target is filtered.
        params: The tracker's `Params`.
        undetected: U components, predicted.
        scan: K detections.
        key: Random key.
    """
    clutter = jax.vmap(params.clutter.log_density)(scan.detections)
    log_clutter = jnp.maximum(clutter, LEAST_LOG_WEIGHT)
    if isinstance(params.birth, DetectionBirth):
        return _driven(target, params, params.birth, undetected, scan, log_clutter, key)
    weight = undetected.log_weight
    missed, log_miss = jax.vmap(target.miss, (None, 0))(
        params.target, undetected.belief
    )
    log_miss = jnp.maximum(log_miss, LEAST_LOG_WEIGHT)
    views = jax.vmap(target.look, (None, 0))(params.target, undetected.belief)
    score = jax.vmap(target.score, (None, 0, None))(
        params.target, views, scan.detections
    )
    log_weight = weight[:, None] + score  # [U, K]
    belief = jax.vmap(target.absorb, (None, 1, None, 0))(
        params.target, log_weight, views, scan.detections
    )
    log_score = mixture.total(log_weight) - log_clutter
    return Firsts(
        log_score=jnp.where(scan.valid, log_score, -jnp.inf),
        belief=belief,
        missed=Undetected(weight + log_miss, missed, undetected.born),
        found=(jnp.exp(weight) * -jnp.expm1(log_miss)).sum(),
        birth_prob=birth_times.detected(log_weight, undetected.born),
    )


def add(undetected: Undetected, prob: Array, belief: PyTree) -> Undetected:
    """Adds targets that were detected once but are hardly there: recycles them.

    Args:
        undetected: U components.
        prob: How likely each is there, 0 for none, [N].
        belief: About them, [N, ...].

    Returns:
        U + N components (Williams, "Hybrid Poisson and multi-Bernoulli filters", 2012).
    """
    weak = Undetected(safe_log(prob), belief)
    return jax.tree.map(lambda x, y: jnp.concatenate([x, y]), undetected, weak)


def reduce(undetected: Undetected, size: int) -> tuple[Undetected, Array]:
    """Keeps the heaviest components; returns the expected number in the others, too."""
    if undetected.log_weight.size <= size:
        return undetected, jnp.zeros_like(undetected.expected)
    kept = jax.lax.top_k(undetected.log_weight, size)[1]
    some = jax.tree.map(lambda x: x[kept], undetected)
    return some, jnp.maximum(undetected.expected - some.expected, 0.0)


def _born(
    target: Target,
    params: Params,
    birth: PoissonBirth | MultiBernoulliBirth,
    key: Array,
    others: Array | None,
) -> Undetected:
    """Returns the components of births at B places, told when as `others` are."""
    places = MultiBernoulliBirth(*birth)
    born = bernoulli.begin(target, params.target, places, jnp.array(0), key)
    log_weight = safe_log(born.existence_prob)
    times = birth_times.newborn(log_weight.size, birth_times.number(others))
    return Undetected(log_weight, born.belief, times)


def _driven(
    target: Target,
    params: Params,
    birth: DetectionBirth,
    undetected: Undetected,
    scan: Scan,
    log_clutter: Array,
    key: Array,
) -> Firsts:
    """Returns targets that may be detected for the first time anywhere."""
    new, valid = birth.rate * scan.interval, scan.valid
    everywhere = jnp.ones_like(log_clutter)
    layout, sensor = params.target.layout, params.target.sensor
    places = birth.propose(
        sensor, layout, scan.detections, valid, everywhere, scan.interval
    )
    keys = jax.random.split(key, valid.size)
    belief = jax.vmap(target.begin, (None, 0, 0, 0))(
        params.target, Gaussian(places.mean, places.cov), places.mode_prob, keys
    )
    # Spread over the sensor's space as the clutter is, whatever its rate.
    clutter = params.clutter._replace(rate=jnp.ones_like(new))
    log_place = jax.vmap(clutter.log_density)(scan.detections)
    log_score = safe_log(new) + log_place - log_clutter
    num = birth_times.number(undetected.born)
    return Firsts(
        log_score=jnp.where(valid, log_score, -jnp.inf),
        belief=belief,
        missed=undetected,
        found=new,
        birth_prob=birth_times.newborn(valid.size, num),
    )
