"""Running a tracker over time, and over many simulated runs.

    estimates = run(tracker, params, scans, key)          # T scans
    dataset = monte_carlo(scenario, ["gm-mm-cbmember"])   # R runs, scored

One run looks like this:

    >>> import functools, jax
    >>> from jaxtrack import engine
    >>> from jaxtrack.scenarios import yuan2013_linear
    >>> scenario = yuan2013_linear.make()
    >>> truth, scans = jax.jit(scenario.simulate)(jax.random.key(0))
    >>> tracker, params = scenario.trackers["gm-cv-cbmember"]
    >>> run = jax.jit(functools.partial(engine.run, tracker))
    >>> estimates = run(params, scans, jax.random.key(1))
    >>> estimates.mean.shape
    (50, 16, 4)
"""

import functools
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from jaxtrack.scenarios.world import Maker, World, observe, shown
from jaxtrack.study import devices, parts, sweep, table
from jaxtrack.study.scores import Scores, score
from jaxtrack.types import Array, PyTree, Scan, Scans, Tracker

if TYPE_CHECKING:
    import xarray


def run(tracker: Tracker, params: PyTree, scans: Scan | Scans, key: Array) -> PyTree:
    """Runs a tracker over T scans; every estimate comes back with a leading T.

    For R runs at once, `run_many`.

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


def map_runs(
    function: Callable[..., PyTree],
    *arguments: PyTree,
    in_axes: int | None | Sequence[int | None] = 0,
    static: tuple[Hashable, ...] = (),
    block: int = 1024,
) -> PyTree:
    """Calls a function of one run for R runs, as `jax.vmap` does, but faster.

    The runs are shared among all local devices, and each computes them block by block,
    so that what it works on stays in its cache. (`jaxtrack.start.cores()` makes devices
    of the cores of a CPU.) It can be called under `jax.jit` and differentiated. A
    function made anew is traced anew.

    Args:
        function: (*static, *arguments of one run) -> arrays.
        arguments: With a leading R, or the same for all runs.
        in_axes: 0 for an argument with a leading R, None for one without, as in
            `jax.vmap`; a single 0 says so of all arguments.
        static: What the program depends on, such as a tracker.
        block: Runs that are computed side by side, at most. One Kalman filter is
            fastest with 512 to 2,048, a tracker of many targets with some 16.

    Returns:
        What the function returns, with a leading R.

    Raises:
        ValueError: An axis is neither 0 nor None, no argument has runs, they differ
            in their number, or the block is empty.
    """
    axes = (
        list(in_axes) if isinstance(in_axes, Sequence) else [in_axes] * len(arguments)
    )
    if 0 not in axes or not {0, None}.issuperset(axes) or len(axes) != len(arguments):
        raise ValueError(
            f"in_axes is {in_axes}; give 0 or None for each of the {len(arguments)} "
            "arguments, and 0 for at least one"
        )
    if block < 1:
        raise ValueError(f"block is {block}; give at least 1 run")
    own = tuple(axis == 0 for axis in axes)
    runs = [x for x, mine in zip(arguments, own, strict=True) if mine]
    _count(runs)
    mesh = devices.local_mesh()
    return devices.map_blocks(function, static, own, block, mesh, arguments)


def _count(runs: PyTree) -> int:
    """Returns R, of which all arrays have as many.

    Raises:
        ValueError: They have not, or there is none.
    """
    numbers = sorted({(*jnp.shape(x), 0)[0] for x in jax.tree.leaves(runs)})
    if len(numbers) != 1 or not numbers[0]:
        told = ", ".join(map(str, numbers)) or "no"
        raise ValueError(
            f"the arguments are of {told} runs; give as many of each, and at least 1"
        )
    return numbers[0]


def share(runs: PyTree) -> PyTree:
    """Puts runs on all local devices, an equal share on each, as `map_runs` has them.

    It does so itself in every call; if the same runs are used again, and one takes
    little time, as a Kalman filter does, sharing them once is worth it.

    Args:
        runs: Arrays with a leading R, a multiple of the number of devices.

    Raises:
        ValueError: R is no such multiple, or the arrays differ in it.
    """
    number, mesh = _count(runs), devices.local_mesh()
    if number % mesh.size:
        raise ValueError(
            f"there are {number} runs for {mesh.size} devices; give a multiple of them"
        )
    return jax.device_put(runs, devices.shares(mesh))


def run_many(
    tracker: Tracker, params: PyTree, scans: Scan, keys: Array, block: int = 16
) -> PyTree:
    """Runs a tracker over the T scans of R runs; estimates have a leading R, T.

    Args:
        tracker: A tracker.
        params: Its `Params`, the same for all runs.
        scans: Scans with a leading R, T.
        keys: Random keys, [R].
        block: See `map_runs`.
    """
    axes, static = (None, 0, 0), (tracker,)
    return map_runs(run, params, scans, keys, in_axes=axes, static=static, block=block)


def run_keys(seed: int, first: int, count: int) -> Array:
    """Returns the keys of runs first, first + 1, ...; run r has `fold_in(key, r)`.

    So a run's data are the same whatever the batch, the chunk or the machine.
    """
    fold = jax.vmap(jax.random.fold_in, (None, 0))
    return fold(jax.random.key(seed), jnp.arange(first, first + count))


def simulate_and_run(
    tracker: Tracker, params: PyTree, world: World, max_detections: int, key: Array
) -> tuple[Scan | Scans, Any]:
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
        seen = shown(scans, world.sensor)
        return scores, {**seen._asdict(), **estimates._asdict()}

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
