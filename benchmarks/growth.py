"""How does the cost grow with runs, components and detections?

Runs: the Kalman filter of `benchmarks.kalman` through models. Components and
detections: the mixture update of `benchmarks.gaussians`, and whole scans of a tracker,
`yuan2013-linear` with more Gaussians a track or more clutter.
"""

import functools

import jax

from benchmarks import common, gaussians, kalman, problems
from benchmarks.common import Job, Row, Size
from jaxtrack import engine, scenarios

KIND = "float32"
RUNS = (1, 10, 100, 1_000, 10_000, 100_000)
PAIRS = ((16, 30), (128, 30), (1024, 30), (8192, 30), (400, 1), (400, 10), (400, 100))
GAUSSIANS = (3, 8, 24)  # a track
CLUTTER = (5, 40, 320)  # false detections a scan
TRACKED = 8  # runs of a tracker
CHECKED = 1_000  # runs that are checked


def kalman_row(runs: int, size: Size) -> list[Row]:
    """Times the Kalman filter on so many runs."""
    whole = -(-runs // 16) * 16  # the loop in C takes its runs in sixteens
    exact = problems.linear(whole, size.scans)
    answer = problems.kalman(problems.first(exact, CHECKED))
    total, tolerance = answer.log_density, kalman.TOLERANCE[KIND]

    def check(name: str, result: jax.Array) -> float:
        few = min(len(result), len(total))
        return common.check(name, result[:few], total[:few], tolerance)

    models, mine = kalman.models(), problems.first(exact, runs).to(KIND)
    own = common.library(kalman.model_log_likelihood, models, mine, check)
    limit = kalman.loop(exact.to(KIND), check)
    work = f"Kalman filter, models, {runs:,} runs"
    return common.compare(work, KIND, own, limit=limit, rounds=size.rounds)


def tracker_row(name: str, what: str, size: Size, **settings: int) -> list[Row]:
    """Times a tracker on a few runs of a scenario."""
    scenario = scenarios.make("yuan2013-linear", **settings)
    tracker, params = scenario.trackers[name]
    keys = engine.run_keys(0, 0, min(TRACKED, size.runs))
    scans = jax.jit(jax.vmap(lambda key: scenario.simulate(key)[1]))(keys)
    scans = jax.tree.map(lambda x: x[:, : size.scans], scans)
    run = functools.partial(engine.run_many, tracker)
    call, seconds = common.compiled(run, params, scans, keys)
    own = Job("jaxtrack", call, scans.interval.size, seconds)
    work, rounds = f"{name}, {what}", min(size.rounds, 3)
    return common.compare(work, KIND, own, rounds=rounds, unit="scans/s")


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    size, made = size._replace(rounds=min(size.rounds, 5)), []
    quick = size == common.QUICK
    with common.precision(KIND):
        for runs in RUNS[:1] if quick else RUNS:
            made += kalman_row(runs, size)
        for pair in PAIRS[:1] if quick else PAIRS:
            made += gaussians.rows_of(*pair, size.rounds)
        for num in GAUSSIANS[:1] if quick else GAUSSIANS:
            what, few = f"{num} Gaussians a track", {"max_tracks": 2} if quick else {}
            made += tracker_row("gm-cv-cbmember", what, size, max_components=num, **few)
        for num in () if quick else CLUTTER:
            what = f"clutter of {num} a scan"
            made += tracker_row("imm-mm-cbmember", what, size, clutter_rate=num)
    return made


if __name__ == "__main__":
    common.main(rows)
