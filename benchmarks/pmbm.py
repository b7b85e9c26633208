"""What does a PMBM filter cost: by targets, by clutter, by global hypotheses?

The whole `williams-crossing` as published, four targets that meet in the middle with
200 hypotheses; and scans of `crossing-many` around the time when all targets meet, with
more and more targets, false detections and hypotheses. All are runs side by side on one
core, and the time is that of the processor. Not in `make bench`: compiling all of it
takes ten minutes. It writes `results/pmbm.json` and `results/pmbm.png`.
"""

import json
import pathlib
from typing import Any

import jax

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack import engine, scenarios
from jaxtrack.targets import single
from jaxtrack.trackers import pmbm, undetected

KIND = "float32"
TARGETS, FALSE, HYPOTHESES = (2, 5, 10, 20), (5, 20, 80), (1, 10, 50, 200)
USUAL = 5, 20, 50  # targets, false detections, hypotheses
RUNS, SCANS, MIDDLE = 8, 6, 27  # scans from one before all meet
RESULTS = pathlib.Path(__file__).parent / "results"


def crossing(targets: int, false: int, hypotheses: int, size: Size) -> list[Row]:
    """Times the scans in the middle, begun with the tracks in place."""
    scenario = scenarios.make(
        "crossing-many", num_targets=targets, clutter_rate=float(false)
    )
    given = scenario.trackers["jipda"][1]
    params = undetected.Params(given.target, given.birth, given.clutter)
    tracker = pmbm.pmbm(
        single.single(),
        max_hypotheses=hypotheses,
        max_tracks=int(2 * targets + false + 8),
        max_leaves=16,
        max_undetected=1,
        max_contested=2 * targets + 8,
        exist_threshold=1e-3,
    )
    keys = engine.run_keys(0, 0, RUNS)
    _, scans = jax.jit(jax.vmap(scenario.simulate))(keys)
    begin, middle = (
        jax.tree.map(lambda x, part=part: x[:, part], scans)
        for part in (slice(0, MIDDLE), slice(MIDDLE, MIDDLE + SCANS))
    )

    def on(state: Any, scans: Any) -> Any:
        return jax.lax.scan(lambda s, x: tracker.step(params, s, x), state, scans)

    def to_middle(scans: Any, key: Any) -> Any:
        return on(tracker.init(params, key), scans)[0]

    states = jax.jit(jax.vmap(to_middle))(begin, keys)
    call, seconds = common.compiled(
        lambda s, x: jax.vmap(on)(s, x)[1].mean, states, middle
    )
    call()
    work = f"{targets} targets, {false} false detections, {hypotheses} hypotheses"
    own = Job("jaxtrack", call, RUNS * SCANS, seconds)
    return common.compare(work, KIND, own, rounds=size.rounds, unit="scans/s")


def williams(size: Size) -> list[Row]:
    """Times whole runs of the published scenario."""
    scenario = scenarios.make("williams-crossing")
    tracker, params = scenario.trackers["pmbm"]
    keys = engine.run_keys(0, 0, 16)
    _, scans = jax.jit(jax.vmap(scenario.simulate))(keys)

    def on(scans: Any, keys: Any) -> Any:
        many = jax.vmap(lambda x, key: engine.run(tracker, params, x, key))
        return many(scans, keys).mean

    call, seconds = common.compiled(on, scans, keys)
    call()
    own = Job("jaxtrack", call, scans.valid.shape[0] * scans.valid.shape[1], seconds)
    work = "williams-crossing, 200 hypotheses"
    return common.compare(work, KIND, own, rounds=size.rounds, unit="scans/s")


def sweeps() -> dict[str, list[tuple[int, int, int]]]:
    """Returns what is varied, and the rest as usual."""
    targets, false, hypotheses = USUAL
    return {
        "targets": [(n, false, hypotheses) for n in TARGETS],
        "false detections": [(targets, n, hypotheses) for n in FALSE],
        "hypotheses": [(targets, false, n) for n in HYPOTHESES],
    }


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    quick = size == common.QUICK
    size, made = size._replace(rounds=min(size.rounds, 3)), []
    every = dict.fromkeys(one for some in sweeps().values() for one in some)
    with common.precision(KIND):
        for one in list(every)[:1] if quick else every:
            made += crossing(*one, size)
            print(made[-1].work, f"{1000 / made[-1].rate:.2f} ms a scan", flush=True)
        if not quick:
            made += williams(size)
            keep(made)
    return made


def keep(made: list[Row]) -> None:
    """Writes the numbers and the picture."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    RESULTS.mkdir(exist_ok=True)
    cost = {each.work: 1000 / each.rate for each in made}
    (RESULTS / "pmbm.json").write_text(json.dumps(cost, indent=1) + "\n")
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.5), sharey=True, layout="tight")
    for axis, (name, some) in zip(axes, sweeps().items(), strict=True):
        which = list(sweeps()).index(name)
        works = [
            f"{n} targets, {k} false detections, {h} hypotheses" for n, k, h in some
        ]
        axis.loglog([one[which] for one in some], [cost[one] for one in works], "o-")
        axis.set_xticks([one[which] for one in some], [str(x[which]) for x in some])
        axis.set_yticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
        axis.minorticks_off()
        axis.set(xlabel=name)
        axis.grid(alpha=0.3)
    axes[0].set(ylabel="ms a scan")
    figure.savefig(RESULTS / "pmbm.png", dpi=120)


if __name__ == "__main__":
    common.main(rows)
