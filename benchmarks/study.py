"""How many runs of a published study are done in a second, and what takes the time?

`yuan2013-linear`, 50 scans a run: simulated, tracked and scored by
`engine.monte_carlo` on two cores, by the clock on the wall and by the CPU time of
both, which others on the machine disturb less; and the stages of a tracker's step on
one core, each compiled and timed alone, as shares of the whole step. What the parts
lose or gain by being apart makes the shares add up to more or less than one.
"""

import functools
import time
from typing import Any

import jax
import numpy as np

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack import engine, scenarios
from jaxtrack.trackers import bernoulli, multi_bernoulli

KIND = "float32"
SCENARIO = "yuan2013-linear"
STUDIES = {"imm-mm-cbmember": 200, "gm-mm-cbmember": 50}  # runs
ROUNDS = 3  # of a study
TOGETHER = 20  # runs in the step that is taken apart
SETTLED = 8  # scans before it


def study_rows(name: str, runs: int, rounds: int) -> list[Row]:
    """Times a study, by the wall and by the CPU; a first one compiles."""
    engine.monte_carlo(SCENARIO, [name], runs=runs)
    wall, spent = [], []
    for seed in range(rounds):
        start = time.process_time()
        done = engine.monte_carlo(SCENARIO, [name], runs=runs, seed=seed)
        spent.append((time.process_time() - start) / runs)
        wall.append(float(done.seconds.sum()) / runs)
    work, made = f"{SCENARIO}, {name}", []
    cores = f"runs/s, {len(jax.devices())} cores"
    for taken, unit in (np.array(wall), cores), (np.array(spent), "runs/s of CPU time"):
        rate, spread = float(1 / np.median(taken)), common.spread(taken)
        made.append(Row(work, KIND, rate, unit, spread=spread))
    return made


def stages(name: str, runs: int, **settings: int) -> dict[str, Job]:
    """Returns the whole step of many runs, and its stages."""
    scenario = scenarios.make(SCENARIO, **settings)
    tracker, params = scenario.trackers[name]
    made_by: Any = tracker.step  # a partial function of the maker's arguments
    sizes = made_by.args[0]
    keys = engine.run_keys(0, 0, runs)
    scans = jax.jit(jax.vmap(lambda key: scenario.simulate(key)[1]))(keys)
    state = jax.jit(jax.vmap(tracker.init, (None, 0)))(params, keys)
    step = jax.jit(jax.vmap(tracker.step, (None, 0, 0)))
    for k in range(SETTLED):
        state, _ = step(params, state, jax.tree.map(lambda x, k=k: x[:, k], scans))
    scan = jax.tree.map(lambda x: x[:, SETTLED], scans)

    jobs = {}

    def add(stage: str, function: Any, *own: Any) -> Any:
        call, seconds = common.compiled(jax.vmap(function), *own)
        jobs[stage] = Job(stage, call, runs, seconds)
        return call()

    add("step", functools.partial(tracker.step, params), state, scan)
    predict = functools.partial(bernoulli.predict, sizes.target, params.target)
    tracks = add("predict", predict, state.tracks, scan.interval)
    update = functools.partial(
        multi_bernoulli.update, sizes.balance, sizes.target, params
    )
    updated = add("update", update, tracks, scan)
    keep = functools.partial(multi_bernoulli.keep, sizes, params.target)
    add("keep", keep, tracks, scan, updated)
    return jobs


def stage_rows(name: str, runs: int, rounds: int, **settings: int) -> list[Row]:
    """Times the stages of a step."""
    jobs = stages(name, runs, **settings)
    whole, *parts = common.interleave(list(jobs.values()), rounds)
    own = jobs["step"]
    work, rate = f"{name}, step", float(1 / np.median(whole))
    made = [Row(work, KIND, rate, "scans/s", spread=common.spread(whole))]
    made[0] = made[0]._replace(compile_seconds=own.compile_seconds)
    for stage, seconds in zip(list(jobs)[1:], parts, strict=True):
        share = float(np.median(seconds / whole))
        spread, unit = common.spread(seconds), "of the step's time"
        made.append(Row(f"{work}: {stage}", KIND, share, unit, spread=spread))
    return made


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    if size == common.QUICK:
        return stage_rows("imm-mm-cbmember", 2, size.rounds, max_tracks=2)
    made = []
    for name, runs in STUDIES.items():
        made += study_rows(name, runs, ROUNDS)
    common.pin()
    for name in STUDIES:
        made += stage_rows(name, TOGETHER, size.rounds)
    return made


if __name__ == "__main__":
    common.main(rows, cores=2)
