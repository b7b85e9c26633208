"""What does it gain to report later, and smoothed?

IMM-MHT on `turning-aircraft` at 5 s, decided after one scan: OSPA and hops of what is
reported at once, and one, two and four scans later. `python -m benchmarks.delayed`
prints the table of docs/mht.md. A hop is how far a track is from where its last state
was heading.
"""

from typing import Any

import jax
import numpy as np

from benchmarks import common
from jaxtrack import engine, scenarios
from jaxtrack.study.scores import score
from jaxtrack.targets import imm
from jaxtrack.trackers import mht, retrodiction

RUNS, INTERVAL, DELAYS = 50, 5.0, (1, 2, 4)
ROOM = {"max_hypotheses": 1, "max_tracks": 24, "max_leaves": 6}


def told(scenario: Any, delay: int, keys: Any) -> tuple[Any, Any]:
    """Runs it; returns scores and reports at once and later, [R, T, ...] each."""
    params = scenario.trackers["imm-mht-p1"][1]
    tracker = mht.mht(imm.imm(), num_scans=1, delay=delay, **ROOM)
    world, limits = scenario.world, (scenario.cutoff, scenario.order)

    def one(key: Any) -> tuple[Any, Any]:
        scores, reports = {}, {}
        _, estimate = engine.simulate_and_run(
            tracker, params, world, scenario.max_detections, key
        )
        later = retrodiction.align(estimate, delay)
        for when, said in (("at once", estimate), ("later", later)):
            scores[when] = score(world.truth, world.motion, said, *limits)
            reports[when] = said.mean, said.label, said.exists
        return scores, reports

    return jax.jit(jax.vmap(one))(keys)


def hops(mean: Any, label: Any, exists: Any) -> np.ndarray:
    """Returns the distances of all steps of all tracks, metres."""
    found = []
    for means, labels, there in zip(
        *map(np.asarray, (mean, label, exists)), strict=True
    ):
        last = {}
        for t in range(len(means)):
            now = {labels[t, n]: means[t, n] for n in np.flatnonzero(there[t])}
            for one in now.keys() & last.keys():
                after, before = now[one], last[one]
                speed = (after[[1, 3]] + before[[1, 3]]) / 2
                gap = after[[0, 2]] - before[[0, 2]] - INTERVAL * speed
                found.append(np.hypot(*gap))
            last = now
    return np.array(found)


def line(name: str, scores: Any, reports: Any) -> str:
    """Returns a row of the table."""
    parts = []
    for field in (scores.ospa, scores.ospa_localisation):
        mean = np.asarray(field).mean(1)
        parts.append(f"{mean.mean():.1f} ± {mean.std(ddof=1) / RUNS**0.5:.1f}")
    middle, most = np.percentile(hops(*reports), [50, 95])
    return f"| {name} | {parts[0]} | {parts[1]} | {middle:.0f}, {most:.0f} m |"


def main() -> None:
    """Prints the table."""
    scenario = scenarios.make("turning-aircraft", interval=INTERVAL)
    keys = engine.run_keys(0, 0, RUNS)
    print("| reported | OSPA | of which places | hops |\n|---|---|---|---|", flush=True)
    for delay in DELAYS:
        scores, reports = told(scenario, delay, keys)
        if delay == DELAYS[0]:
            print(line("at once", scores["at once"], reports["at once"]), flush=True)
        plural = "s" if delay > 1 else ""
        name = f"{delay} scan{plural} later"
        print(line(name, scores["later"], reports["later"]), flush=True)


if __name__ == "__main__":
    with common.precision("float32"):
        main()
