"""How fast is the trajectory metric, beside the same linear programme by HiGHS?

Runs of some targets that come and go, tracked with noise, breaks, false tracks and
labels that change places where targets are near: in the first scene targets are spread
out and cross, in the others all meet in the middle. The order is 2, the cut-off 10, the
switch cost 2, the tolerance 1e-3. The peer is a loop over HiGHS on the first few of the
same runs, once with all pairs, as in the paper, and once with `trajectories.exact`,
which leaves out those that are never nearer than the cut-off. That both agree within
the tolerance is checked. Further rows show the cost against the number of times and of
trajectories.
"""

from typing import NamedTuple

import jax
import numpy as np

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack.metrics import coupled, trajectories
from jaxtrack.types import Array

CUTOFF, SWITCH, TOLERANCE = 10.0, 2.0, 1e-3
RUNS, PEERS, ROUNDS = 100, 3, 3
NEAR = 6.0  # m, where labels may change places


class Scene(NamedTuple):
    """What is simulated.

    Attributes:
        name: For the table.
        times: T.
        targets: N.
        tracks: L.
        spread: Standard deviation of the places at half time, m.
    """

    name: str
    times: int
    targets: int
    tracks: int
    spread: float


SCENES = (
    Scene("spread", 81, 10, 10, 25.0),
    Scene("meeting", 81, 4, 6, 2.0),
    Scene("meeting", 81, 10, 10, 2.0),
    Scene("spread", 81, 12, 20, 25.0),
    Scene("spread", 21, 10, 10, 25.0),
    Scene("spread", 41, 10, 10, 25.0),
    Scene("spread", 161, 10, 10, 25.0),
    Scene("spread", 81, 5, 5, 25.0),
    Scene("spread", 81, 20, 20, 50.0),
)


def simulate(scene: Scene, seed: int) -> tuple[np.ndarray, ...]:
    """Draws targets [T, N, 2], tracks [T, L, 2], and when they are alive."""
    rng = np.random.default_rng(seed)
    times, targets = scene.times, scene.targets
    walk = rng.normal(size=(times, targets, 2)).cumsum(0).cumsum(0) * 0.1
    along = np.arange(times)[:, None, None] - times // 2
    velocity = rng.normal(size=(targets, 2)) * 0.7
    truth = walk - walk[times // 2] + along * velocity
    truth = truth + rng.normal(size=(targets, 2)) * scene.spread
    born = rng.integers(0, times // 3, targets)
    dead = rng.integers(2 * times // 3, times + 1, targets)
    time = np.arange(times)[:, None]
    alive = (time >= born) & (time < dead)

    estimate = np.zeros((times, scene.tracks, 2))
    reported = np.zeros((times, scene.tracks), bool)
    label, free = np.full(targets, -1), list(range(scene.tracks))
    for t in range(times):
        for n in range(targets):
            if label[n] < 0 and free and alive[t, n]:
                label[n] = free.pop(0)
            if label[n] >= 0 and (not alive[t, n] or rng.random() < 0.5 / times):
                label[n] = -1
            others = np.linalg.norm(truth[t] - truth[t, n], axis=1) < NEAR
            other = rng.choice(np.flatnonzero(others))
            if rng.random() < 0.1:
                label[[n, other]] = label[[other, n]]
        seen = np.flatnonzero((label >= 0) & (rng.random(targets) < 0.95))
        estimate[t, label[seen]] = truth[t, seen] + rng.normal(size=(len(seen), 2)) * 2
        reported[t, label[seen]] = True
    for slot in free:  # what no target has taken is false, or nothing
        begin = rng.integers(times)
        reported[begin : begin + rng.integers(8), slot] = True
        estimate[:, slot] = rng.uniform(-50, 50, 2)
    return truth, alive, estimate, reported


def metric(*sets: Array) -> trajectories.Score:
    """Measures one run."""
    return trajectories.metric(*sets, CUTOFF, SWITCH, tolerance=TOLERANCE)


def exact(*sets: np.ndarray) -> list[float]:
    """Measures runs one by one by HiGHS."""
    scores = (trajectories.exact(*x, CUTOFF, SWITCH) for x in zip(*sets, strict=True))
    return [float(score.distance) for score in scores]


def all_pairs(
    truth: np.ndarray, alive: np.ndarray, estimate: np.ndarray, reported: np.ndarray
) -> list[float]:
    """Solves the programme of each run with the pairs that no optimum needs, too."""
    gap = truth[:, :, :, None] - estimate[:, :, None]
    near = np.minimum(np.linalg.norm(gap, axis=-1) / CUTOFF, 1) ** 2 - 1
    cost = np.where(alive[:, :, :, None] & reported[:, :, None], near, 0)
    # What costs anything below zero is not left out; so little does not matter.
    change = (SWITCH / CUTOFF) ** 2 / 2
    return [float(coupled.exact(each - 1e-9, change).upper) for each in cost]


def compare(scene: Scene, runs: int, peers: int, rounds: int) -> list[Row]:
    """Times one scene."""
    drawn = [simulate(scene, seed) for seed in range(runs)]
    sets = tuple(map(np.stack, zip(*drawn, strict=True)))
    few = tuple(x[:peers] for x in sets)
    call, seconds = common.compiled(jax.vmap(metric), *sets)
    score: trajectories.Score = call()
    error = common.check(
        "jaxtrack", score.distance[:peers], np.array(exact(*few)), TOLERANCE
    )
    own = Job("jaxtrack", call, runs, seconds, error)
    others = [
        Job("HiGHS", lambda: exact(*few), peers),
        Job("HiGHS, all pairs", lambda: all_pairs(*few), peers),
    ]
    size = f"{scene.times} times, {scene.targets} x {scene.tracks}"
    work = f"trajectory metric, {scene.name}, {size}"
    return common.compare(work, "float64", own, others, None, rounds, "metrics/s")


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    with common.precision("float64"):
        if size == common.QUICK:
            return compare(Scene("spread", 12, 3, 4, 10.0), 4, 2, 1)
        return [row for scene in SCENES for row in compare(scene, RUNS, PEERS, ROUNDS)]


if __name__ == "__main__":
    common.main(rows)
