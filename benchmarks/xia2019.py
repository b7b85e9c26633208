"""How good are the trajectory filters in the two scenarios of Xia et al. 2019?

Table I and figures 2 to 4 of the paper, see `docs/xia2019.md`. Runs on all cores; a
tracker's runs are kept in `--out` when they are done, so that a stopped command goes
on. It writes numbers and pictures there.

    python -m benchmarks.xia2019 --runs 100 --out docs/xia2019
"""

import argparse
import json
import pathlib
import time
from typing import Any

import numpy as np

from jaxtrack import start

SCENARIOS = "spread", "coalescing"
TRACKERS = "tpmbm", "tmbm", "tmbm01", "glmb", "lmb-gibbs", "lmb", "pmbm"
COLORS: dict[str, str] = {
    "tpmbm": "#c0392b",
    "tmbm": "#2a5ca8",
    "tmbm01": "#a33ea1",
    "glmb": "#3a8f4d",
    "lmb-gibbs": "#1fa3b5",
    "lmb": "#0b5563",
    "pmbm": "#c98a1b",
}
GOSPA = "distance", "localisation", "missed", "false"
WHOLE = (*GOSPA, "switch")


def measure(which: str, name: str, runs: int) -> dict[str, np.ndarray]:
    """Runs a tracker: squares of distances and parts, [parts, R, T], CPU seconds."""
    import jax

    from jaxtrack import engine, scenarios
    from jaxtrack.scenarios.xia2019 import SWITCH_COST
    from jaxtrack.study import trajectories

    scenario = scenarios.make(f"xia2019-{which}")
    tracker, params = scenario.trackers[name]
    keys = engine.run_keys(0, 0, runs)
    scans = engine.map_runs(lambda x: scenario.simulate(x)[1], keys)
    seconds = []
    for _ in range(2):  # the first compiles
        begin = time.process_time()
        told = engine.run_many(tracker, params, scans, keys, block=4)
        jax.block_until_ready(told.mean)
        seconds.append(time.process_time() - begin)
    found = trajectories.score_runs(scenario, name, runs, SWITCH_COST)

    def parts(score: Any, names: tuple[str, ...]) -> np.ndarray:
        some = [np.asarray(getattr(score, x), float) for x in names]
        return np.stack([some[0] ** 2, *some[1:]])

    return {
        "gospa": parts(found.gospa, GOSPA),
        "without": parts(found.filtered, WHOLE),
        "with": parts(found.smoothed, WHOLE),
        "seconds": np.array(seconds[-1]),
        "dropped": np.array(found.dropped.max()),
    }


def sums(power: np.ndarray) -> dict[str, list[float]]:
    """Sums over time: roots of means over runs, means of roots, and their errors."""
    root = np.sqrt(power)
    spread = root.sum(2).std(1, ddof=1) / np.sqrt(power.shape[1])
    every = {
        "root_mean": np.sqrt(power.mean(1)).sum(1),
        "mean": root.mean(1).sum(1),
        "mean_error": spread,
    }
    return {name: [round(float(x), 2) for x in found] for name, found in every.items()}


def beyond(own: np.ndarray, other: np.ndarray) -> list[float]:
    """Mean and standard error of a distance's sums over time less another's, paired."""
    runs = min(own.shape[1], other.shape[1])
    sums = [np.sqrt(x[0, :runs]).sum(1) for x in (own, other)]
    gap = sums[0] - sums[1]
    error = gap.std(ddof=1) / np.sqrt(runs)
    return [round(float(gap.mean()), 2), round(float(error), 2)]


def curves(found: dict[str, dict[str, np.ndarray]], kind: str, path: Any) -> None:
    """Draws distances and parts over time: figures 3 (gospa) and 4 (with)."""
    from matplotlib import pyplot as plt

    names = GOSPA if kind == "gospa" else WHOLE
    figure, axes = plt.subplots(
        1, len(names), figsize=(3.2 * len(names), 3.2), layout="constrained"
    )
    for part, (axis, title) in enumerate(zip(axes, names, strict=True)):
        for name, own in found.items():
            for each, style in (
                (("gospa", "-"),)
                if kind == "gospa"
                else (
                    ("without", "-"),
                    ("with", "-."),
                )
            ):
                if each == "with" and np.array_equal(own["with"], own["without"]):
                    continue  # it does not smooth
                root = np.sqrt(own[each][part].mean(0))
                label = name if kind == "gospa" else f"{name} {each} smoothing"
                color = COLORS[name]
                axis.plot(1 + np.arange(root.size), root, style, c=color, label=label)
        axis.set(title=title, xlabel="scan", ylim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].set(ylabel="m")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    figure.savefig(path, dpi=110)


def cost(found: dict[str, dict[str, np.ndarray]], path: Any) -> None:
    """Draws the error of each against its time, as figure 2."""
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(4.5, 3.5), layout="constrained")
    for name, own in found.items():
        runs = own["gospa"].shape[1]
        error = np.sqrt(own["gospa"][0]).mean(0).sum()
        axis.plot(float(own["seconds"]) / runs, error, "o", c=COLORS[name], label=name)
    axis.set(xlabel="seconds a run", ylabel="GOSPA, summed over scans (m)")
    axis.grid(alpha=0.3)
    axis.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measures what is not there yet, and writes numbers and pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("xia2019"))
    given = parser.parse_args()
    start.cores()
    start.cache()
    given.out.mkdir(parents=True, exist_ok=True)
    import matplotlib

    matplotlib.use("agg")
    table = {}
    for which in SCENARIOS:
        every = {}
        for name in TRACKERS:
            path = given.out / f"{which}-{name}-{given.runs}.npz"
            if not path.exists():
                found = measure(which, name, given.runs)
                np.savez(path, allow_pickle=False, **found)
            every[name] = own = dict(np.load(path))
            kinds = "gospa", "without", "with"
            first = every[TRACKERS[0]]
            table[f"{which} {name}"] = {x: sums(own[x]) for x in kinds} | {
                "beyond the first": {x: beyond(own[x], first[x]) for x in kinds},
                "runs": own["gospa"].shape[1],
                "dropped": int(own["dropped"]),
                "seconds_a_run": float(own["seconds"]) / own["gospa"].shape[1],
            }
            print(which, name, json.dumps(table[f"{which} {name}"]), flush=True)
        curves(every, "gospa", given.out / f"{which}-gospa.png")
        curves(every, "with", given.out / f"{which}-trajectories.png")
        cost(every, given.out / f"{which}-cost.png")
    (given.out / "numbers.json").write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
