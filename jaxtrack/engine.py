"""Running a tracker over time, and over many simulated runs.

    estimates = run(tracker, params, scans, key)          # T scans
    dataset = monte_carlo(scenario, ["gm-mm-cbmember"])   # R runs, scored

One run looks like this:

    >>> import jax
    >>> from jaxtrack import engine
    >>> from jaxtrack.scenarios import yuan2013_linear
    >>> scenario = yuan2013_linear.make()
    >>> truth, scans = scenario.simulate(jax.random.key(0))
    >>> tracker, params = scenario.trackers["imm-mm-cbmember"]
    >>> estimates = engine.run(tracker, params, scans, jax.random.key(1))
    >>> estimates.mean.shape
    (50, 16, 4)
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.metrics.gospa import gospa
from jaxtrack.metrics.ospa import ospa
from jaxtrack.scenarios.world import Maker, Truth, World, observe
from jaxtrack.study import devices, parts, sweep, table
from jaxtrack.types import Array, PyTree, Scan, Tracker

if TYPE_CHECKING:
    import xarray


class Scores(NamedTuple):
    """How well one run went, each [T].

    Attributes:
        ospa: Metres; ospa_localisation and ospa_cardinality are its parts.
        gospa: Metres; gospa_localisation, gospa_missed and gospa_false are its parts to
            the power of the order.
        num_true: Targets that exist.
        num_reported: Tracks that were reported.
        num_expected: Sum of the existence probabilities.
        log_evidence: Log-density of the scan.
        dropped: Expected number of targets that capacities threw away.
    """

    ospa: Array
    ospa_localisation: Array
    ospa_cardinality: Array
    gospa: Array
    gospa_localisation: Array
    gospa_missed: Array
    gospa_false: Array
    num_true: Array
    num_reported: Array
    num_expected: Array
    log_evidence: Array
    dropped: Array


def run(tracker: Tracker, params: PyTree, scans: Scan, key: Array) -> PyTree:
    """Runs a tracker over T scans; every estimate comes back with a leading T.

    For R runs at once, `jax.vmap(functools.partial(run, tracker), (None, 0, 0))`.

    Args:
        tracker: A tracker; static under `jit`.
        params: Its `Params`.
        scans: Scans with a leading T.
        key: Random key; the trackers that need none ignore it.

    Returns:
        The tracker's `Estimate` with a leading T.
    """
    step = functools.partial(tracker.step, params)
    _, estimates = jax.lax.scan(step, tracker.init(params, key), scans)
    return estimates


def run_keys(seed: int, first: int, count: int) -> Array:
    """Returns the keys of runs first, first + 1, ...; run r has `fold_in(key, r)`.

    So a run's data are the same whatever the batch, the chunk or the machine.
    """
    fold = jax.vmap(jax.random.fold_in, (None, 0))
    return fold(jax.random.key(seed), jnp.arange(first, first + count))


def simulate_and_run(
    tracker: Tracker, params: PyTree, world: World, max_detections: int, key: Array
) -> tuple[Scan, Any]:
    """Draws one run's scans and tracks them.

    Args:
        tracker: A tracker; static under `jit`.
        params: Its `Params`.
        world: Truth and sensor.
        max_detections: Slots of a scan; static under `jit`.
        key: The run's key, see `run_keys`.

    Returns:
        The scans and the estimates, each with a leading T.
    """
    scan_key, tracker_key = jax.random.split(key)
    scans = observe(scan_key, *world, max_detections)
    return scans, run(tracker, params, scans, tracker_key)


def score(
    truth: Truth, motion: Any, estimates: Any, cutoff: Array, order: Array
) -> Scores:
    """Scores the estimates of one run scan by scan.

    Args:
        truth: T scans of N targets.
        motion: A motion model, asked only where positions stand.
        estimates: Any tracker's `Estimate` with a leading T.
        cutoff: Of OSPA and GOSPA, metres.
        order: Of OSPA and GOSPA.

    Returns:
        Scores, each [T].
    """
    index = jnp.array(motion.position_index)

    def one(state: Array, there: Array, mean: Array, exists: Array) -> tuple[Any, Any]:
        sets = state[:, index], there, mean[:, index], exists
        return ospa(*sets, cutoff, order), gospa(*sets, cutoff, order)

    near, general = jax.vmap(one)(
        truth.state, truth.exists, estimates.mean, estimates.exists
    )
    return Scores(
        *near,
        *general[:4],
        num_true=truth.exists.sum(1),
        num_reported=estimates.exists.sum(1),
        num_expected=estimates.existence_prob.sum(1),
        log_evidence=estimates.log_evidence,
        dropped=estimates.dropped,
    )


def watch_chunk(
    tracker: Tracker,
    max_detections: int,
    params: PyTree,
    world: World,
    cutoff: Array,
    order: Array,
    keys: Array,
) -> tuple[Scores, dict[str, Array]]:
    """Simulates, tracks and scores one run per key [R].

    Returns:
        Scores, each [R, T]; and by name what the first run saw and told, the fields of
        its scans and of its estimates, each [1, T, ...].
    """

    def one(key: Array) -> tuple[Scores, dict[str, Array]]:
        scans, estimates = simulate_and_run(tracker, params, world, max_detections, key)
        scores = score(world.truth, world.motion, estimates, cutoff, order)
        return scores, {**scans._asdict(), **estimates._asdict()}

    scores, seen = jax.vmap(one)(keys)
    return scores, jax.tree.map(lambda x: x[:1], seen)


@functools.partial(jax.jit, static_argnames=("tracker", "max_detections"))
def score_chunk(
    tracker: Tracker,
    max_detections: int,
    params: PyTree,
    world: World,
    cutoff: Array,
    order: Array,
    keys: Array,
) -> Scores:
    """Simulates, tracks and scores one run per key [R]; each score is [R, T]."""
    return watch_chunk(tracker, max_detections, params, world, cutoff, order, keys)[0]


def monte_carlo(
    scenario: str | Maker,
    trackers: Sequence[str],
    runs: int = 100,
    seed: int = 0,
    settings: Mapping[str, Sequence[float]] | None = None,
    chunk: int | None = None,
    directory: parts.Directory | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> "xarray.Dataset":
    """Runs trackers over many simulated runs, at every point of a sweep.

    Run r has the same data whatever the trackers, the chunk and the machine. A sweep of
    values compiles once per tracker: all points share the largest scan capacity.

    Args:
        scenario: Its name, or a function that makes it.
        trackers: Names of trackers of the scenario.
        runs: R.
        seed: From 0 up to 2^32.
        settings: Values to sweep over, by the names of the scenario's settings; of
            several settings every combination is run.
        chunk: Runs in a compiled call; by default 10, 25 or 50.
        directory: Where parts are kept; a study that is run again loads those it finds.
        progress: Called with the number of runs done and to be done, all told.

    Returns:
        The fields of `Scores` over setting, tracker, run and time; seconds and
        compile_seconds over setting and tracker.

    Raises:
        ValueError: A name or a value that makes no sense, or a directory that holds
            parts of another study.
    """
    plan = sweep.plan(scenario, trackers, runs, seed, settings, chunk)
    report = progress or (lambda done, total: None)
    total = len(plan.jobs) * runs
    report(0, total)
    done: list[list[parts.Part]] = []
    for job in plan.jobs:
        before = len(done) * runs
        done.append([])
        for some in plan.chunks:
            done[-1].append(_part(plan, job, some, directory))
            report(before + min(some.stop, runs), total)
    return table.dataset(plan, done)


def _part(
    plan: sweep.Plan, job: sweep.Job, runs: range, directory: parts.Directory | None
) -> parts.Part:
    """Loads a part, or computes and keeps it."""
    if directory is None:
        return _compute(plan, job, runs)
    path = parts.path_of(directory, job, runs.start)
    identity = {**plan.attributes, "settings": job.point, "tracker": job.name}
    identity["fingerprint of code and values"] = parts.fingerprint(job.values)
    part = parts.read(path, identity)
    if part is None:
        part = _compute(plan, job, runs)
        parts.write(path, identity, part)
    return part


def _compute(plan: sweep.Plan, job: sweep.Job, runs: range) -> parts.Part:
    """Runs a chunk."""
    keys = run_keys(plan.attributes["seed"], runs.start, len(runs))
    static = job.tracker, plan.max_detections
    called = devices.call(watch_chunk, static, job.values, keys)
    scores, seen = called.result
    there = seen if runs.start == 0 else {}
    example = {name: x[0] for name, x in there.items() if x is not None}
    return parts.Part(scores._asdict(), called.seconds, called.compile_seconds, example)
