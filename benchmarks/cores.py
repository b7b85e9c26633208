"""What do two cores bring?

Two processes, one bound to one core, the other to two with a device each, take turns at
the same runs; the clock on the wall decides, since cores are what is counted. Only on
an idle machine does this say something.
"""

import argparse
import subprocess
import sys
import time

import jax
import numpy as np

from benchmarks import common, kalman, problems
from benchmarks.common import Row, Size

KIND = "float32"
RUNS = 8192
SECONDS = 0.3  # of a turn


def serve(cores: int, runs: int, scans: int) -> None:
    """Answers every line on stdin with the rate, steps a second, of one turn."""
    common.pin(cores)
    jax.config.update("jax_num_cpu_devices", cores)
    exact = problems.linear(runs, scans)
    total = problems.kalman(problems.first(exact, 1000)).log_density

    def check(name: str, result: jax.Array) -> float:
        tolerance = kalman.TOLERANCE[KIND]
        return common.check(name, result[: len(total)], total, tolerance)

    shared = kalman.models()
    function = kalman.model_log_likelihood
    job = common.library(function, shared, exact.to(KIND), check)
    print("ready", flush=True)
    for _ in sys.stdin:
        start, calls = time.perf_counter(), 0
        while calls == 0 or time.perf_counter() - start < SECONDS:
            job.call()
            calls += 1
        seconds = time.perf_counter() - start
        print(calls * job.items / seconds, flush=True)


def start(cores: int, size: Size) -> subprocess.Popen:
    """Starts a process on so many cores and waits until it is ready."""
    numbers = [str(x) for x in (cores, size.runs, size.scans)]
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
    both = [start(cores, size) for cores in (1, 2)]
    rates = np.array([[turn(x) for x in both] for _ in range(size.rounds)]).T
    for process in both:
        process.communicate()  # closes its stdin, which ends it
    work = f"Kalman filter, models, {size.runs:,} runs, two cores"
    row = Row(work, KIND, float(np.median(rates[1])), "steps/s", "one core")
    ratio = float(np.median(rates[1] / rates[0]))
    return [row._replace(ratio_to_peer=ratio, spread=common.spread(1 / rates[1]))]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--serve", nargs=3, type=int)
    chosen = parser.parse_known_args()[0].serve
    if chosen:
        serve(*chosen)
    else:
        common.main(rows, cores=2)
