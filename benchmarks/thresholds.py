"""Are thresholds of a likely-model set learned by gradient as good as searched ones?

The evidence of twenty flights of `manoeuvre-digraph`, with soft choices, is climbed
from two places; what is found is used with hard choices, beside a search on a grid.
Prints the table of `docs/learning.md`.

    python -m benchmarks.thresholds
"""

from typing import Any

from jaxtrack import start

RUNS, STEPS, TEMPERATURE = 20, 80, 0.5
STARTS = (0.15, 0.9), (0.01, 0.3)  # t1, t2
GRID = (0.0005, 0.002, 0.01, 0.05, 0.15), (0.2, 0.3, 0.5, 0.9)


def flights() -> tuple[Any, Any]:
    """Returns the runs' keys and their scans."""
    from jaxtrack import engine, scenarios

    keys = engine.run_keys(0, 0, RUNS)
    simulate = scenarios.make("manoeuvre-digraph").simulate
    return keys, engine.map_runs(lambda key: simulate(key)[1], keys)


def score(unlikely: float, principal: float) -> tuple[float, float, float]:
    """Returns evidence of a run, RMS error (m) and active models, of hard choices."""
    import jax.numpy as jnp

    from jaxtrack import engine, scenarios

    made = scenarios.make(
        "manoeuvre-digraph", unlikely_prob=unlikely, principal_prob=principal
    )
    keys, scans = flights()
    told = engine.run_many(*made.trackers["lms-jpda"], scans, keys)
    where = jnp.array(made.world.motion.position_index)
    miss = (told.mean[:, :, 0] - made.world.truth.state[None, :, 0])[..., where]
    error = jnp.sqrt((miss**2).sum(-1).mean())
    active = (told.mode_prob > 0).sum(-1).mean()
    return float(told.log_evidence.sum(1).mean()), float(error), float(active)


def learned(unlikely: float, principal: float) -> Any:
    """Fits both thresholds, beginning there."""
    import optax

    from jaxtrack import learn, scenarios
    from jaxtrack.targets import likely_modes
    from jaxtrack.trackers import jpda

    made = scenarios.make(
        "manoeuvre-digraph", unlikely_prob=unlikely, principal_prob=principal
    )
    soft = likely_modes.likely_modes(temperature=TEMPERATURE)
    return learn.fit(
        jpda.jpda(soft, max_tracks=1, max_births=0, gate_prob=1.0),
        made.trackers["lms-jpda"][1],
        flights()[1],
        optax.adam(0.1),
        where=lambda p: (p.target.unlikely_prob, p.target.principal_prob),
        num_steps=STEPS,
    )


def main() -> None:
    """Prints the table."""
    start.cores()
    start.cache()
    print("| t1 | t2 | log-evidence of a run | RMS error, m | active models |")
    print("|---|---|---|---|---|")
    for unlikely in GRID[0]:
        for principal in GRID[1]:
            show(f"{unlikely:g}", f"{principal:g}", score(unlikely, principal))
    for begin in STARTS:
        unlikely, principal = (f"start: {x:g}" for x in begin)
        show(unlikely, principal, score(*begin))
        found = learned(*begin)
        target, errors = found.params.target, found.information.std_error
        names = "unlikely_prob", "principal_prob"
        values = [float(getattr(target, name)) for name in names]
        unlikely, principal = (
            f"learned: {value:.3f} ± {float(errors[f'target.{name}']):.3f}"
            for value, name in zip(values, names, strict=True)
        )
        show(unlikely, principal, score(*values))


def show(unlikely: str, principal: str, scores: tuple[float, float, float]) -> None:
    """Prints a row."""
    evidence, error, active = scores
    print(
        f"| {unlikely} | {principal} | {evidence:.2f} | {error:.2f} | {active:.2f} |",
        flush=True,
    )


if __name__ == "__main__":
    main()
