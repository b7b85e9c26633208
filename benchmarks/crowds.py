"""How does the cost of a tracker grow with targets and with detections?

Scans of `crossing-many` around the time when all targets meet: with 2 to 200 targets
among few false detections, and with 10 targets among more and more. Not in
`make bench`: compiling all of it takes half an hour. JPDA* and set JPDA go through
joint events one by one, and are timed over a single run. It writes
`results/crowds.json` and `results/crowds.png`.
"""

import json
import pathlib
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
SLOW = "jpda-star", "set-jpda"
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


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    quick = size == common.QUICK
    size, made = size._replace(rounds=min(size.rounds, 3)), []
    sweep = [(n, FEW_FALSE) for n in TARGETS] + [(FEW_TARGETS, k) for k in FALSE]
    with common.precision(KIND):
        for name in TRACKERS[:1] if quick else TRACKERS:
            for targets, false in sweep[:1] if quick else sweep:
                made += row(name, targets, false, size)
                print(
                    made[-1].work, f"{1000 / made[-1].rate:.2f} ms a scan", flush=True
                )
    if not quick:
        keep(made)
    return made


def keep(made: list[Row]) -> None:
    """Writes the numbers and the picture."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    cost = {each.work: 1000 / each.rate for each in made}
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "crowds.json").write_text(json.dumps(cost, indent=1) + "\n")
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), sharey=True, layout="tight")
    for name in TRACKERS:
        by_targets = [
            cost[f"{name}, {n} targets, {FEW_FALSE} false detections"] for n in TARGETS
        ]
        by_false = [
            cost[f"{name}, {FEW_TARGETS} targets, {k} false detections"] for k in FALSE
        ]
        axes[0].loglog(TARGETS, by_targets, "o-", label=name)
        axes[1].loglog(FALSE, by_false, "o-", label=name)
    axes[0].set(
        xlabel=f"targets, among {FEW_FALSE} false detections", ylabel="ms a scan"
    )
    axes[1].set(xlabel=f"false detections a scan, {FEW_TARGETS} targets")
    for axis, ticks in zip(axes, (TARGETS, FALSE), strict=True):
        axis.set_xticks(ticks, [str(x) for x in ticks])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(RESULTS / "crowds.png", dpi=120)


if __name__ == "__main__":
    common.main(rows)
