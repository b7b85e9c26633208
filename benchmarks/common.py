"""Timing side by side: pinned to one core, in interleaved rounds, checked beforehand.

A benchmark makes `Job`s, calls that wait for their results, of the library, of peers
and of a limit. `compare` runs them in turn, round after round, in one process on one
core; the clock is the CPU time of the process, so that others disturb little.
Rates differ from machine to machine and hour to hour, ratios hardly: each is the median
over the rounds of the ratio within a round.

    >>> from benchmarks import common
    >>> jobs = [common.Job(name, lambda: sum(range(n)), 1) for name, n in
    ...         [("library", 1000), ("peer", 10000)]]
    >>> rows = common.compare("adding", "int", jobs[0], jobs[1:], rounds=3)
    >>> rows[0].peer
    'peer'
"""

import argparse
import contextlib
import json
import os
import pathlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.problems import Problem
from jaxtrack import engine
from jaxtrack.types import Gaussian

ENOUGH = 0.02  # seconds; calls shorter than this are repeated within a round


class Size(NamedTuple):
    """How much work: runs, scans of a run, and rounds of timing."""

    runs: int = 1024
    scans: int = 100
    rounds: int = 11


QUICK = Size(runs=16, scans=3, rounds=1)


class Job(NamedTuple):
    """Something to time.

    Attributes:
        name: Who does the work.
        call: Does it and waits until it is done.
        items: How many items of work a call does.
        compile_seconds: What it took to compile, None if nothing was compiled.
        error: Of the result, relative to the reference's.
    """

    name: str
    call: Callable[[], Any]
    items: int
    compile_seconds: float | None = None
    error: float | None = None


class Row(NamedTuple):
    """One line of the results.

    Attributes:
        work: What is done.
        precision: float32 or float64.
        rate: Items of work a second, the median.
        unit: What an item is.
        peer: Who else does it in the same rounds.
        ratio_to_peer: How many times as fast as the peer.
        limit: What the machine can do.
        ratio_to_limit: Share of the limit that is reached.
        spread: Interquartile range of the time, relative to its median.
        compile_seconds: CPU time.
        error: Largest relative error against the reference.
    """

    work: str
    precision: str
    rate: float
    unit: str
    peer: str | None = None
    ratio_to_peer: float | None = None
    limit: str | None = None
    ratio_to_limit: float | None = None
    spread: float | None = None
    compile_seconds: float | None = None
    error: float | None = None


def pin(cores: int = 1) -> None:
    """Binds all threads of this process, those to come too, to so many cores.

    Must come before jax makes its first array, which counts the cores.
    """
    if hasattr(os, "sched_setaffinity"):
        chosen = sorted(os.sched_getaffinity(0))[-cores:]
        for thread in os.listdir("/proc/self/task"):
            os.sched_setaffinity(int(thread), chosen)


@contextlib.contextmanager
def precision(name: str) -> Iterator[np.dtype]:
    """Makes float32 or float64 the default of jax within the block."""
    with jax.enable_x64(name == "float64"):
        yield np.dtype(name)


def compiled(function: Callable, *arguments: Any) -> tuple[Callable[[], Any], float]:
    """Compiles a function for its arguments.

    Returns:
        A call without arguments that waits for the result, and the CPU seconds that
        tracing and compiling took.
    """
    arguments = jax.tree.map(jax.numpy.asarray, arguments)
    start = time.process_time()
    program = jax.jit(function).lower(*arguments).compile()
    seconds = time.process_time() - start
    return lambda: jax.block_until_ready(program(*arguments)), seconds


def many(function: Callable, num_shared: int) -> Callable:
    """Returns a function of many runs, from one of one run.

    Args:
        function: (*shared, *own) -> results, of one run.
        num_shared: How many of the arguments are the same for all runs.
    """

    def call(*arguments: Any) -> Any:
        axes = [None if k < num_shared else 0 for k in range(len(arguments))]
        return engine.map_runs(function, *arguments, in_axes=axes)

    return call


def library(
    function: Callable[..., Any],
    shared: tuple,
    problem: Problem,
    check: Callable[[str, Any], float],
) -> Job:
    """Returns the library's work on all runs of a problem, checked.

    Args:
        function: (*shared, prior, detections [T, 2]) -> anything, of one run.
        shared: What is the same for all runs.
        problem: The runs.
        check: (name, result) -> error.
    """
    prior = Gaussian(problem.mean, problem.cov)
    function = many(function, len(shared))
    call, seconds = compiled(function, *shared, prior, problem.detections)
    items = problem.detections[..., 0].size
    return Job("jaxtrack", call, items, seconds, check("jaxtrack", call()))


def runs_last(*arrays: np.ndarray) -> list[np.ndarray]:
    """Returns arrays with the axis over runs moved to the end, as C wants it."""
    return [np.ascontiguousarray(np.moveaxis(x, 0, -1)) for x in arrays]


def check(name: str, result: Any, reference: Any, tolerance: float) -> float:
    """Returns the largest error relative to the largest entry of the reference.

    Raises:
        ValueError: It is beyond the tolerance.
    """
    result, reference = (np.asarray(x, float) for x in (result, reference))
    error = float(np.abs(result - reference).max() / np.abs(reference).max())
    if not error <= tolerance:
        raise ValueError(f"{name} is off by {error:.1e}, more than {tolerance:.0e}")
    return error


def interleave(jobs: Sequence[Job], rounds: int) -> np.ndarray:
    """Returns the CPU seconds that each job needs for an item, [jobs, rounds]."""
    counts = [_enough(job) for job in jobs]
    pairs = list(zip(jobs, counts, strict=True))
    seconds = [[_seconds(*pair) for pair in pairs] for _ in range(rounds)]
    return np.array(seconds).T


def _enough(job: Job) -> int:
    """Returns how many calls make a timing, after one to warm up."""
    job.call()
    return max(1, round(ENOUGH / max(_seconds(job, 1) * job.items, 1e-6)))


def _seconds(job: Job, count: int) -> float:
    start = time.process_time()
    for _ in range(count):
        job.call()
    return (time.process_time() - start) / (count * job.items)


def spread(seconds: np.ndarray) -> float:
    """Returns the interquartile range relative to the median."""
    low, middle, high = np.percentile(seconds, [25, 50, 75])
    return float((high - low) / middle)


def compare(
    work: str,
    kind: str,
    library: Job,
    peers: Sequence[Job] = (),
    limit: Job | None = None,
    rounds: int = 11,
    unit: str = "steps/s",
) -> list[Row]:
    """Times the library beside peers and limit, and returns a row for each peer.

    Args:
        work: What is done.
        kind: The precision.
        library: What the library does.
        peers: Who else does it; without any there is one row all the same.
        limit: The loop in C; None where there is no compiler.
        rounds: How often each is timed, in turn.
        unit: What an item is.
    """
    others = [*peers, *([limit] if limit else [])]
    own, *their = interleave([library, *others], rounds)
    row = Row(work, kind, float(1 / np.median(own)), unit, spread=spread(own))
    row = row._replace(compile_seconds=library.compile_seconds, error=library.error)
    if limit:
        share = float(np.median(their[-1] / own))
        row = row._replace(limit=limit.name, ratio_to_limit=share)
    ratios = [float(np.median(seconds / own)) for seconds in their[: len(peers)]]
    return [
        row._replace(peer=peer.name, ratio_to_peer=ratio)
        for peer, ratio in zip(peers, ratios, strict=True)
    ] or [row]


def main(rows: Callable[[Size], list[Row]], cores: int = 1) -> None:
    """Runs one benchmark from the command line, prints its rows and may keep them.

    Args:
        rows: The benchmark.
        cores: How many it may use.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="tiny sizes, one round")
    parser.add_argument("--out", type=pathlib.Path, help="write the rows as JSON")
    options = parser.parse_args()
    pin(cores)
    jax.config.update("jax_num_cpu_devices", cores)
    jax.config.update("jax_enable_compilation_cache", False)
    made = rows(QUICK if options.quick else Size())
    for row in made:
        print(describe(row), file=sys.stderr, flush=True)
    if options.out:
        options.out.write_text(json.dumps([row._asdict() for row in made], indent=1))


def describe(row: Row) -> str:
    """Returns a row as one line of text."""
    text = f"{row.work} ({row.precision}): {row.rate:,.3g} {row.unit}"
    for other, ratio in (row.peer, row.ratio_to_peer), (row.limit, row.ratio_to_limit):
        if other:
            text += f", {ratio:.3g} x {other}"
    if row.spread is not None:
        text += f", spread {row.spread:.0%}"
    if row.compile_seconds is not None:
        text += f", compiled in {row.compile_seconds:.2g} s"
    return text + (f", error {row.error:.0e}" if row.error is not None else "")
