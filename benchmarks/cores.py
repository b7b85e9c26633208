"""What do two cores bring?

Processes, one bound to one core, the others to two with a device each, take turns at
the same runs; the clock on the wall decides, since cores are what is counted. In the
last one the runs lie on the devices beforehand (`engine.share`). Only on an idle
machine does this say something.
"""

import argparse
import subprocess
import sys
import time

import jax
import numpy as np

from benchmarks import common, kalman, problems
from benchmarks.common import Row, Size
from jaxtrack import engine

KIND = "float32"
RUNS = 8192
SECONDS = 0.3  # of a turn


def serve(cores: int, shared: int, runs: int, scans: int) -> None:
    """Answers every line on stdin with the rate, steps a second, of one turn."""
    common.pin(cores)
    jax.config.update("jax_num_cpu_devices", cores)
    exact = problems.linear(runs, scans)
    total = problems.kalman(problems.first(exact, 1000)).log_density

    def check(name: str, result: jax.Array) -> float:
        tolerance = kalman.TOLERANCE[KIND]
        return common.check(name, result[: len(total)], total, tolerance)

    problem = exact.to(KIND)
    if shared:
        some = problem.mean, problem.cov, problem.detections
        mean, cov, detections = engine.share(some)
        problem = problem._replace(mean=mean, cov=cov, detections=detections)
    function = kalman.model_log_likelihood
    job = common.library(function, kalman.models(), problem, check)
    print("ready", flush=True)
    for _ in sys.stdin:
        start, calls = time.perf_counter(), 0
        while calls == 0 or time.perf_counter() - start < SECONDS:
            job.call()
            calls += 1
        seconds = time.perf_counter() - start
        print(calls * job.items / seconds, flush=True)


def start(cores: int, shared: int, size: Size) -> subprocess.Popen:
    """Starts a process on so many cores and waits until it is ready."""
    numbers = [str(x) for x in (cores, shared, size.runs, size.scans)]
    command = [sys.executable, "-m", "benchmarks.cores", "--serve", *numbers]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
    _answer(process)
    return process


def _answer(process: subprocess.Popen) -> str:
    """Reads a line of a process."""
    line = process.stdout.readline() if process.stdout else ""
    if not line:
        raise RuntimeError("a process of the benchmark ended; see its message above")
    return line


def turn(process: subprocess.Popen) -> float:
    """Lets a process have its turn, and returns its rate."""
    print(file=process.stdin, flush=True)
    return float(_answer(process))


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    if size != common.QUICK:
        size = size._replace(runs=RUNS)
    every = [start(*which, size) for which in ((1, 0), (2, 0), (2, 1))]
    rates = np.array([[turn(x) for x in every] for _ in range(size.rounds)]).T
    for process in every:
        process.communicate()  # closes its stdin, which ends it
    made, work = [], f"Kalman filter, models, {size.runs:,} runs, two cores"
    for name, own in zip((work, f"{work}, shared before"), rates[1:], strict=True):
        row = Row(name, KIND, float(np.median(own)), "steps/s", "one core")
        ratio, spread = float(np.median(own / rates[0])), common.spread(1 / own)
        made.append(row._replace(ratio_to_peer=ratio, spread=spread))
    return made


if __name__ == "__main__":
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--serve", nargs=4, type=int)
    chosen = parser.parse_known_args()[0].serve
    if chosen:
        serve(*chosen)
    else:
        common.main(rows, cores=2)
