"""How long does it take to the first result, without and with a warm cache?

Every number is from a new process on one core, in CPU time: Python and the imports,
then the first call of a program, tracing included, with an empty compilation cache and
with the one that this call has filled.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time

import jax
import numpy as np

from benchmarks import common, kalman, problems
from benchmarks.common import Row, Size
from jaxtrack import engine
from jaxtrack.types import Gaussian

KIND = "float32"
FILTER, STUDY = "Kalman filter, models", "study of 10 runs, imm-mm-cbmember"
ROUNDS = {FILTER: 3, STUDY: 1}
KEEP_ALL = {
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}


def serve(work: str, runs: int, scans: int) -> None:
    """Prints the CPU seconds of the imports and of the first call."""
    imported = time.process_time()
    common.pin()
    problem = problems.linear(runs, scans).to(KIND)
    begin = time.process_time()
    if work == FILTER:
        shared = kalman.models()
        many = jax.jit(common.many(kalman.model_log_likelihood, len(shared)))
        prior = Gaussian(problem.mean, problem.cov)
        jax.block_until_ready(many(*shared, prior, problem.detections))
    else:
        engine.monte_carlo("yuan2013-linear", ["imm-mm-cbmember"], runs=10)
    print(imported, time.process_time() - begin)


def seconds(work: str, size: Size, cache: str) -> list[float]:
    """Returns what a new process prints, with this cache."""
    command = [sys.executable, "-m", "benchmarks.start", "--serve", work]
    command += [str(size.runs), str(size.scans)]
    variables = {**os.environ, **KEEP_ALL, "JAX_COMPILATION_CACHE_DIR": cache}
    done = subprocess.run(
        command, env=variables, stdout=subprocess.PIPE, text=True, check=True
    )
    return [float(x) for x in done.stdout.split()]


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    made, imports = [], []
    works = {FILTER: 1} if size == common.QUICK else ROUNDS
    for work, rounds in works.items():
        cold, warm = [], []
        for _ in range(rounds):
            with tempfile.TemporaryDirectory() as cache:
                for kept in cold, warm:
                    imported, first = seconds(work, size, cache)
                    imports.append(imported)
                    kept.append(first)
        for state, kept in ("empty", cold), ("warm", warm):
            what = f"first call, {work}, {state} cache"
            made.append(_row(what, np.array(kept)))
    return [_row("Python and imports", np.array(imports)), *made]


def _row(work: str, taken: np.ndarray) -> Row:
    spread = common.spread(taken)
    return Row(work, KIND, float(np.median(taken)), "s", spread=spread)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--serve", nargs=3)
    chosen = parser.parse_known_args()[0].serve
    if chosen:
        serve(chosen[0], int(chosen[1]), int(chosen[2]))
    else:
        common.main(rows)
