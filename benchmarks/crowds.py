"""How does the cost of a tracker grow with targets and with detections?

Scans of `crossing-many` around the time when all targets meet: with 2 to 200 targets
among few false detections, and with 10 targets among more and more. Not in
`make bench`: compiling all of it takes half an hour. JPDA* and set JPDA go through
joint events one by one: they are timed over a single run and up to 20 targets, where
they take as long as JPDA for some thousand. It writes `results/crowds.json` and
`results/crowds.png`; with the names of trackers after it, only theirs anew.
"""

import json
import math
import pathlib
import sys
from typing import Any

import jax

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack import engine, scenarios

KIND = "float32"
TRACKERS = (
    *("nn", "gnn", "pda", "ipda", "jpda", "jpda-bp", "jipda", "cbmember"),
    *("jpda-star", "set-jpda"),
)
ONLY = [name for name in sys.argv[1:] if name in TRACKERS]
SLOW, SLOW_TARGETS = ("jpda-star", "set-jpda"), 20
TARGETS, FEW_FALSE = (2, 20, 200), 10
FALSE, FEW_TARGETS = (5, 80), 10
RUNS, SCANS, MIDDLE = 4, 6, 27  # scans from one before all meet
RESULTS = pathlib.Path(__file__).parent / "results"


def row(name: str, targets: int, false: int, size: Size) -> list[Row]:
    """Times a few runs of the scans in the middle, begun with the tracks in place."""
    scenario = scenarios.make(
        "crossing-many", num_targets=targets, clutter_rate=float(false)
    )
    tracker, params = scenario.trackers[name]
    runs = 1 if name in SLOW else RUNS
    keys = engine.run_keys(0, 0, runs)
    _, scans = jax.jit(jax.vmap(scenario.simulate))(keys)
    begin, middle = (
        jax.tree.map(lambda x, part=part: x[:, part], scans)
        for part in (slice(0, MIDDLE), slice(MIDDLE, MIDDLE + SCANS))
    )

    def to_middle(scans: Any, key: Any) -> Any:
        state = tracker.init(params, key)
        return jax.lax.scan(lambda s, x: tracker.step(params, s, x), state, scans)

    states, _ = jax.jit(jax.vmap(to_middle))(begin, keys)

    def on(states: Any, scans: Any) -> Any:
        def one(state: Any, scans: Any) -> Any:
            return jax.lax.scan(lambda s, x: tracker.step(params, s, x), state, scans)

        return jax.vmap(one)(states, scans)[1].mean

    call, seconds = common.compiled(on, states, middle)
    call()
    work = f"{name}, {targets} targets, {false} false detections"
    own = Job("jaxtrack", call, runs * SCANS, seconds)
    return common.compare(work, KIND, own, rounds=size.rounds, unit="scans/s")


def sweep(name: str) -> list[tuple[int, int]]:
    """Returns the numbers of targets and false detections for a tracker."""
    few = [n for n in TARGETS if n <= SLOW_TARGETS or name not in SLOW]
    return [(n, FEW_FALSE) for n in few] + [(FEW_TARGETS, k) for k in FALSE]


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    quick = size == common.QUICK
    size, made = size._replace(rounds=min(size.rounds, 3)), []
    with common.precision(KIND):
        for name in TRACKERS[:1] if quick else ONLY or TRACKERS:
            for targets, false in sweep(name)[:1] if quick else sweep(name):
                made += row(name, targets, false, size)
                print(
                    made[-1].work, f"{1000 / made[-1].rate:.2f} ms a scan", flush=True
                )
                if not quick:  # so that nothing is lost if it is interrupted
                    keep(made)
    return made


def keep(made: list[Row]) -> None:
    """Writes the numbers and the picture."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / "crowds.json"
    cost = json.loads(path.read_text()) if path.exists() else {}
    cost |= {each.work: 1000 / each.rate for each in made}
    path.write_text(json.dumps(cost, indent=1) + "\n")
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), sharey=True, layout="tight")
    for name in TRACKERS:
        work = [f"{name}, {n} targets, {k} false detections" for n, k in sweep(name)]
        known = [cost.get(one, math.nan) for one in work]
        few = len(work) - len(FALSE)
        axes[0].loglog(TARGETS[:few], known[:few], "o-", label=name)
        axes[1].loglog(FALSE, known[few:], "o-", label=name)
    axes[0].set(
        xlabel=f"targets, among {FEW_FALSE} false detections", ylabel="ms a scan"
    )
    axes[1].set(xlabel=f"false detections a scan, {FEW_TARGETS} targets")
    for axis, ticks in zip(axes, (TARGETS, FALSE), strict=True):
        axis.set_xticks(ticks, [str(x) for x in ticks])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[1].legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    figure.savefig(RESULTS / "crowds.png", dpi=120)


if __name__ == "__main__":
    sys.argv = [word for word in sys.argv if word not in ONLY]
    common.main(rows)
