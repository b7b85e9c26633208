"""What does a run of RMM-MHT cost beside IMM-MHT, in which switching is told?

Whole runs of `turning-aircraft`, twenty side by side, of both as the scenario has them;
IMM-MHT is the peer. Not in `make bench`: compiling takes minutes.
"""

from typing import Any

import jax

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack import engine, scenarios

KIND, RUNS = "float32", 20
OWN, PEER = "rmm-mht", "imm-mht-p2"
INTERVALS = (5.0, 10.0)  # seconds


def job(name: str, scenario: Any, scans: Any, keys: Any) -> Job:
    """Compiles some runs of a tracker."""
    tracker, params = scenario.trackers[name]

    def one(scans: Any, key: Any) -> Any:
        told = engine.run(tracker, params, scans, key)
        return told.mean, told.exists

    call, seconds = common.compiled(jax.vmap(one), scans, keys)
    return Job(name, call, len(keys), seconds)


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    quick = size == common.QUICK
    made = []
    with common.precision(KIND):
        for interval in INTERVALS[-1:] if quick else INTERVALS:
            scenario = scenarios.make("turning-aircraft", interval=interval)
            keys = engine.run_keys(0, 0, 1 if quick else RUNS)
            scans = jax.jit(jax.vmap(lambda x, s=scenario: s.simulate(x)[1]))(keys)
            own, peer = (job(x, scenario, scans, keys) for x in (OWN, PEER))
            work = f"{OWN}, a run at {interval:g} s"
            rounds = min(size.rounds, 3)
            made += common.compare(work, KIND, own, [peer], None, rounds, "runs/s")
    return made


if __name__ == "__main__":
    common.main(rows)
