"""What does a scan cost an LMB filter, by how it shares out the detections, and GLMB?

`crossing-many` with twenty targets, known at first, and ten false detections: the whole
way into the middle and out of it, for many runs side by side on one core; a target may
be born at each of two places. The time is that of the processor. Not in `make bench`.
"""

from typing import Any

import jax
import numpy as np

from benchmarks import common
from benchmarks.common import Job, Row, Size
from jaxtrack import engine, scenarios
from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.targets import single
from jaxtrack.trackers import glmb, lmb, undetected
from jaxtrack.types import Tracker

KIND = "float32"
TARGETS, FALSE, RUNS = 20, 10, 8
EVENTS, HYPOTHESES = 100, 100
BIRTH_PROB = 0.01


def places(prob: float, mean: np.ndarray, std: list[float]) -> MultiBernoulliBirth:
    """Returns places [B, D] of equal probability and spread."""
    num = len(mean)
    cov = np.tile(np.diag(np.square(std)), (num, 1, 1))
    drawn = np.full(num, prob), mean, cov, np.ones((num, 1))
    return MultiBernoulliBirth(*(jax.numpy.asarray(x, KIND) for x in drawn))


def trackers() -> dict[str, Tracker]:
    """Returns the filters by what they are called in the table."""
    target = single.single()
    own = {"max_tracks": TARGETS, "exist_threshold": 1e-3}
    room = {"max_hypotheses": HYPOTHESES, "max_tracks": TARGETS + 4}
    return {
        "LMB, belief propagation": lmb.lmb(target, method="belief", **own),
        "LMB, exact in clusters": lmb.lmb(target, **own),
        f"LMB, {EVENTS} best joint events": lmb.lmb(
            target, method="k-best", max_events=EVENTS, **own
        ),
        f"LMB, {EVENTS} joint events drawn": lmb.lmb(
            target, method="gibbs", max_events=EVENTS, **own
        ),
        f"GLMB, {HYPOTHESES} hypotheses, best": glmb.glmb(
            target, method="k-best", **room
        ),
        f"GLMB, {HYPOTHESES} hypotheses, drawn": glmb.glmb(target, **room),
    }


def rows(size: Size) -> list[Row]:
    """Answers the question."""
    quick, made = size == common.QUICK, []
    num, runs = (4, 2) if quick else (TARGETS, RUNS)
    with common.precision(KIND):
        scenario = scenarios.make(
            "crossing-many", num_targets=num, clutter_rate=float(FALSE)
        )
        given = scenario.trackers["jipda"][1]
        first = np.asarray(scenario.world.truth.state[0])
        std = [10.0, 5.0, 10.0, 5.0]
        params = undetected.Params(
            given.target,
            places(BIRTH_PROB, first[:2], std),
            given.clutter,
            start=places(0.9, first, std),
        )
        keys = engine.run_keys(0, 0, runs)
        _, scans = jax.jit(jax.vmap(scenario.simulate))(keys)
        if quick:
            scans = jax.tree.map(lambda x: x[:, :3], scans)
        for name, tracker in list(trackers().items())[: 1 if quick else None]:

            def on(scans: Any, keys: Any, tracker: Tracker = tracker) -> Any:
                run = jax.vmap(lambda x, key: engine.run(tracker, params, x, key))
                told = run(scans, keys)
                return told.mean, told.num_mean

            call, seconds = common.compiled(on, scans, keys)
            call()
            own = Job("jaxtrack", call, runs * scans.valid.shape[1], seconds)
            work = f"{name}, {num} targets, {FALSE} false detections"
            rounds = min(size.rounds, 3)
            made += common.compare(work, KIND, own, rounds=rounds, unit="scans/s")
            print(work, f"{1000 / made[-1].rate:.3f} ms a scan", flush=True)
    return made


if __name__ == "__main__":
    common.main(rows)
