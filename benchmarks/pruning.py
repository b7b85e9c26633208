"""How much does multiple hypothesis tracking lose for want of room?

Small problems in which everything is ambiguous, five detections of three scans in a
heap, against the exact posterior of all 136 hypotheses. `python -m benchmarks.pruning`
prints a table for each tracker and draws how the errors fall as the capacities grow.
Errors are means over the problems: of the log-evidence of all scans, of the expected
number of targets after the last, and the largest of those of the probabilities that the
track begun by each detection exists.
"""

import functools
import json
import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack import models
from jaxtrack.targets import single
from jaxtrack.trackers import enumeration, hypothesis_mht, mht, oracle, undetected
from jaxtrack.types import Array, Scan, Tracker

RESULTS = pathlib.Path(__file__).parent / "results"
SIZES, PROBLEMS, BOX, SPREAD, INTERVAL = (2, 2, 1), 200, 40.0, 3.0, 0.7
MAX_TARGETS = 20
EXACT_LEVEL = 1e-4  # where the picture shows what is exact but for rounding
target = single.single()
ROOM = {"max_tracks": 8, "max_undetected": 4, "gate_prob": 1.0}
EXACT = {"prune_threshold": 0.0, "exist_threshold": 0.0}
ALL = enumeration.count(SIZES)
TREES = {
    "max_leaves": [
        {"num_scans": 2, "max_leaves": n, "max_hypotheses": ALL} for n in (2, 4, 9)
    ],
    "num_scans": [
        {"num_scans": n, "max_leaves": 9, "max_hypotheses": ALL} for n in (0, 1, 2)
    ],
    "max_hypotheses, of trees": [
        {"num_scans": 2, "max_leaves": 9, "max_hypotheses": n} for n in (1, 4, 16, 64)
    ],
}
HYPOTHESES = [
    {"max_hypotheses": n, "max_children": min(n, 20), "max_leaves": 9}
    for n in (1, 4, 16, 64, ALL)
]


class Problem(NamedTuple):
    """What differs from problem to problem; scalars, and detections [S, K]."""

    sensor_std: Array
    birth_rate: Array
    undetected: Array
    survive: Array
    detect: Array
    clutter: Array
    detections: Array


class Error(NamedTuple):
    """Means over the problems."""

    log_evidence: float
    num_mean: float
    track_prob: float


def draw(num: int) -> Problem:
    """Draws problems."""
    rng = np.random.default_rng(0)
    low = np.array([0.5, 0.05, 0.2, 0.6, 0.4, 0.2])
    high = np.array([1.4, 0.8, 2.0, 0.99, 0.95, 3.0])
    numbers = rng.uniform(low, high, (num, len(low)))
    places = rng.normal(0.0, SPREAD, (num, len(SIZES), SIZES[0]))
    return Problem(*(jnp.asarray(x) for x in numbers.T), jnp.asarray(places))


def params_of(problem: Problem) -> undetected.Params:
    """Stationary targets on a line, each new one like any other."""
    motion = models.motion.OrnsteinUhlenbeck(jnp.array([2.5]), jnp.array([2.0]))
    cov = jnp.diag(jnp.array([2.5**2, (2.5 / 2.0) ** 2]))

    def births(rate: Array) -> models.birth.PoissonBirth:
        return models.birth.PoissonBirth(
            rate[None], jnp.zeros((1, 2)), cov[None], jnp.ones((1, 1))
        )

    return undetected.Params(
        target=single.Params(
            motion,
            models.sensor.Position(problem.sensor_std[None]),
            models.probability.Constant(problem.survive),
            models.probability.Constant(problem.detect),
        ),
        birth=births(problem.birth_rate),
        clutter=models.clutter.UniformClutter(
            problem.clutter, -BOX / 2 * jnp.ones(1), BOX / 2 * jnp.ones(1)
        ),
        undetected=births(problem.undetected),
    )


def scans_of(problem: Problem) -> Scan:
    """Returns the scans, [S], padded to the largest."""
    places = problem.detections[..., None]
    valid = jnp.arange(places.shape[1])[None] < jnp.array(SIZES)[:, None]
    return Scan(places, valid, jnp.full(len(places), INTERVAL))


def run(tracker: Tracker, problem: Problem) -> tuple[Any, Array]:
    """Returns the last estimate and the log-evidence of all scans."""
    params = params_of(problem)
    state = tracker.init(params, jax.random.key(0))
    step = functools.partial(tracker.step, params)
    _, found = jax.lax.scan(lambda s, x: step(s, x), state, scans_of(problem))
    return jax.tree.map(lambda x: x[-1], found), found.log_evidence.sum()


@functools.cache
def truth(num: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns log-evidence [n], expected number [n] and track probabilities [n, 6]."""

    def exact(problem: Problem) -> oracle.Posterior:
        scans = scans_of(problem)
        each = [
            Scan(scans.detections[k, :n], scans.valid[k, :n], scans.interval[k])
            for k, n in enumerate(SIZES)
        ]
        key = jax.random.key(0)
        return oracle.posterior(
            target, params_of(problem), each, key, max_targets=MAX_TARGETS
        )

    known = jax.jit(jax.vmap(exact))(draw(num))
    listed = enumeration.table(SIZES)
    begun = (listed.track >= 0).argmax(1)
    which = listed.track[np.arange(len(begun)), begun]
    share = np.asarray(known.track_prob * known.existence_prob)
    by_label = [
        share[:, (begun == scan) & (which == k)].sum(1)
        for scan, size in enumerate(SIZES)
        for k in range(size)
    ]
    mean = np.asarray(known.num_prob) @ np.arange(MAX_TARGETS + 1)
    return np.asarray(known.log_evidence), mean, np.stack(by_label, 1)


def error(make: Callable[..., Tracker], num: int, **room: Any) -> Error:
    """Measures one setting."""
    tracker = make(target, **{**ROOM, **EXACT, **room})
    found, log_evidence = jax.jit(jax.vmap(lambda x: run(tracker, x)))(draw(num))
    exact, mean, by_label = truth(num)
    label, prob = np.asarray(found.label), np.asarray(found.existence_prob)
    there = np.stack(
        [np.where(label == k, prob, 0.0).sum(1) for k in range(sum(SIZES))], 1
    )
    return Error(
        float(np.abs(np.asarray(log_evidence) - exact).mean()),
        float(np.abs(np.asarray(found.num_mean) - mean).mean()),
        float(np.abs(there - by_label).max(1).mean()),
    )


def table(num: int = PROBLEMS) -> dict[str, list[tuple[int, Error]]]:
    """Measures all settings."""
    made = {
        f"mht, {name}": [
            (room[name.split(",")[0]], error(mht.mht, num, **room)) for room in rooms
        ]
        for name, rooms in TREES.items()
    }
    made["hypothesis_mht, max_hypotheses"] = [
        (room["max_hypotheses"], error(hypothesis_mht.hypothesis_mht, num, **room))
        for room in HYPOTHESES
    ]
    return made


def draw_picture(made: dict[str, list[tuple[int, Error]]]) -> None:
    """Draws how the errors fall."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(made), figsize=(13, 3.4), sharey=True)
    for axis, (name, rows) in zip(axes, made.items(), strict=True):
        room = [x for x, _ in rows]
        for field in Error._fields:
            level = [max(getattr(row, field), EXACT_LEVEL) for _, row in rows]
            axis.plot(room, level, "o-", label=field)
        axis.set(yscale="log", xlabel=name)
        if room[-1] > 16:
            axis.set_xscale("log")
        axis.set_xticks(room, [str(x) for x in room])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[0].set_ylabel(f"mean error ({EXACT_LEVEL:g}: exact)")
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(RESULTS / "pruning.png", dpi=110)


def main() -> None:
    """Prints the table, keeps it, and draws it."""
    with jax.enable_x64():
        made = table()
    print("| tracker | setting | log-evidence | number of targets | tracks |")
    print("|---|---|---|---|---|")
    for name, rows in made.items():
        tracker, setting = name.split(", ", 1)
        for value, row in rows:
            cells = " | ".join(f"{x:.1e}" for x in row)
            print(f"| {tracker} | {setting.split(',')[0]} = {value} | {cells} |")
    kept = {name: [(x, *row) for x, row in rows] for name, rows in made.items()}
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "pruning.json").write_text(json.dumps(kept, indent=1) + "\n")
    draw_picture(made)


if __name__ == "__main__":
    main()
