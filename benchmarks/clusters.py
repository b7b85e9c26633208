"""What do clusters of hypotheses save, where groups of targets are far apart?

One, two and four heaps of five detections in three scans, side by side: whatever is
believed about one tells nothing of the others, so the exact posterior is the product of
theirs (136 hypotheses each). `python -m benchmarks.clusters` prints, for a single list
of hypotheses and for a list of each cluster, the mean errors of the log-evidence of all
scans and of the expected number of targets after the last.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import pruning
from benchmarks.pruning import BOX, INTERVAL, MAX_TARGETS, SIZES, Problem, target
from jaxtrack import models
from jaxtrack.models.birth import PoissonBirth
from jaxtrack.targets import single
from jaxtrack.trackers import clustered_mht, hypothesis_mht, oracle, undetected
from jaxtrack.types import Array, Scan, Tracker

PROBLEMS, GROUPS, ROWS = 20, (1, 2, 4), (4, 16, 64)
# So wide that what falls outside changes nothing, and no wider than a heap's place.
GATE = {"gate_prob": 1 - 1e-9, "prune_threshold": 0.0, "exist_threshold": 0.0}


def params_of(problem: Problem, groups: int) -> undetected.Params:
    """Targets that are there from the start and drift, as many at each place."""
    place = BOX * jnp.arange(groups)
    mean = jnp.stack([place, jnp.zeros(groups)], axis=1)
    cov = jnp.tile(jnp.diag(jnp.array([2.5**2, 1.0])), (groups, 1, 1))
    modes, none = jnp.ones((groups, 1)), jnp.zeros(groups)
    return undetected.Params(
        target=single.Params(
            models.motion.ConstantVelocity(jnp.array([0.5])),
            models.sensor.Position(problem.sensor_std[None]),
            models.probability.Constant(problem.survive),
            models.probability.Constant(problem.detect),
        ),
        birth=PoissonBirth(none, mean, cov, modes),
        clutter=models.clutter.UniformClutter(
            groups * problem.clutter,
            jnp.array([-BOX / 2]),
            jnp.array([BOX * (groups - 0.5)]),
        ),
        undetected=PoissonBirth(none + problem.undetected, mean, cov, modes),
    )


@functools.cache
def draw(groups: int) -> Problem:
    """Draws problems; the detections are [n, groups, S, K]."""
    numbers = pruning.draw(PROBLEMS * groups)
    detections = numbers.detections.reshape(
        PROBLEMS, groups, *numbers.detections.shape[1:]
    )
    some = jax.tree.map(lambda x: x[:PROBLEMS], numbers)
    return some._replace(detections=detections)


def run(tracker: Tracker, groups: int, problem: Problem) -> tuple[Array, Array]:
    """Returns the log-evidence of all scans and the number of targets at the end."""
    places = problem.detections + BOX * jnp.arange(groups)[:, None, None]
    places = jnp.moveaxis(places, 0, 1).reshape(len(SIZES), -1, 1)
    slots = problem.detections.shape[2]
    valid = jnp.arange(slots)[None] < jnp.array(SIZES)[:, None]
    scans = Scan(places, jnp.tile(valid, groups), jnp.full(len(SIZES), INTERVAL))
    params = params_of(problem, groups)
    state = tracker.init(params, jax.random.key(0))
    _, told = jax.lax.scan(functools.partial(tracker.step, params), state, scans)
    return told.log_evidence.sum(), told.num_mean[-1]


@functools.cache
def truth(groups: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the same from the product of the posteriors of the groups."""

    def exact(problem: Problem, detections: Array) -> tuple[Array, Array]:
        scans = [
            Scan(row[:n, None], jnp.ones(n, bool), jnp.array(INTERVAL))
            for row, n in zip(detections, SIZES, strict=True)
        ]
        known = oracle.posterior(
            target,
            params_of(problem, 1),
            scans,
            jax.random.key(0),
            max_targets=MAX_TARGETS,
        )
        return known.log_evidence, known.num_prob @ jnp.arange(MAX_TARGETS + 1.0)

    def all_groups(problem: Problem) -> tuple[Array, Array]:
        each = jax.vmap(exact, (None, 0))(problem, problem.detections)
        return each[0].sum(), each[1].sum()

    evidence, number = jax.jit(jax.vmap(all_groups))(draw(groups))
    return np.asarray(evidence), np.asarray(number)


def make(clusters: bool, groups: int, rows: int) -> Tracker:
    """Makes a tracker with room for all but hypotheses."""
    total = sum(SIZES)
    room = {"max_hypotheses": rows, "max_leaves": 9, "max_tracks": total * groups}
    room |= {"max_undetected": 2 * groups, **GATE}
    if not clusters:
        return hypothesis_mht.hypothesis_mht(target, max_children=min(rows, 20), **room)
    return clustered_mht.clustered_mht(
        target,
        max_children=4 * rows,
        max_clusters=groups,
        max_members=total,
        max_detections=max(SIZES),
        split_threshold=0.0,
        **room,
    )


def error(clusters: bool, groups: int, rows: int) -> tuple[float, float]:
    """Returns the mean errors of the log-evidence and of the number of targets."""
    tracker = make(clusters, groups, rows)
    found = jax.jit(jax.vmap(functools.partial(run, tracker, groups)))(draw(groups))
    pairs = zip(found, truth(groups), strict=True)
    evidence, number = (float(np.abs(np.asarray(x) - y).mean()) for x, y in pairs)
    return evidence, number


def main() -> None:
    """Prints the table."""
    print("| groups | rows | one list | | a list a cluster | |")
    print("|---|---|---|---|---|---|")
    with jax.enable_x64():
        for groups in GROUPS:
            for rows in ROWS:
                both = [*error(False, groups, rows), *error(True, groups, rows)]
                cells = " | ".join(f"{x:.1e}" for x in both)
                print(f"| {groups} | {rows} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
