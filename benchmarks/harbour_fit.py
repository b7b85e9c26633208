"""What does a fit find in the harbour, and does it track better than settings by hand?

Detections of ships in the middle of New York harbour, an hour in two halves of thirty
scans. All numbers of `jaxtrack/recorded/harbour.toml` that the evidence knows are
fitted on one half, from these settings and from such that are off by a factor of three,
and held against the other half: evidence, and the scores of `jaxtrack track`. The
identities of the ships are for the scores alone.

Not in `make bench`: each fit takes minutes. What is done is kept in `--out`, so that a
stopped command goes on (remove it when something is changed); the table of
`docs/learning.md`, the settings that were found and a picture are written there.

    python -m benchmarks.harbour_fit --out harbour_fit
"""

import argparse
import functools
import json
import pathlib
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks import harbour_tables
from jaxtrack import start

LOW, SIDE = (-4000.0, -4500.0), 8000.0  # m, the corner of the box and its sides
ROOM = {"max_tracks": 140, "max_births": 48, "gate_prob": 1 - 1e-6}
SLOTS = 48  # of a scan; the fullest has 47 detections
SETTLED = 0.8  # share of the scans that count, after tracks have begun in the others
STEPS = 40
FITS = ("by hand", "first"), ("off", "first"), ("by hand", "second")


class Half(NamedTuple):
    """Half of the recording: its table of detections, its scans, and these for jax."""

    table: Any
    scans: Any
    scan: Any


class Case(NamedTuple):
    """What is fitted.

    Attributes:
        tracker: Its `Params` are `recorded.fitted.Numbers`.
        settings: Those by hand, none open.
        motion: A motion model, which says where positions and velocities stand.
        halves: By name.
    """

    tracker: Any
    settings: Any
    motion: Any
    halves: dict[str, Half]


def within(table: Any, inside: Any) -> Any:
    """Returns the rows of a table that are inside, a mask [n]."""
    other = {name: column[inside] for name, column in table.other.items()}
    return table._replace(time=table.time[inside], xy=table.xy[inside], other=other)


def harbour() -> tuple[Any, Any]:
    """Returns the ships in the box, and the settings with their share of the rates."""
    from jaxtrack.data import files
    from jaxtrack.recorded import reading
    from jaxtrack.recorded.settings import known

    every = files.read_detections(files.harbour_path())
    inside = ((every.xy > LOW) & (every.xy < np.add(LOW, SIDE))).all(1)
    chosen, share = reading.harbour(), float(inside.mean())
    sensor, targets = chosen.sensor, chosen.targets
    return within(every, inside), chosen._replace(
        sensor=sensor._replace(clutter_rate=sensor.clutter_rate * share),
        targets=targets._replace(birth_rate=known(targets.birth_rate) * share),
        scans=chosen.scans._replace(max_detections=SLOTS),
        tracker=chosen.tracker._replace(**ROOM),
    )


def make(table: Any, settings: Any, name: str) -> Case:
    """Makes the case of a tracker.

    Args:
        table: Detections of both halves.
        settings: By hand, with a period.
        name: The tracker's, of `recorded.settings.ALGORITHMS`.
    """
    import jax
    import jax.numpy as jnp

    from jaxtrack.recorded import fitted, guess, tracking
    from jaxtrack.recorded import settings as kinds

    def half(inside: Any) -> Half:
        part = within(table, inside)
        scans = tracking.group(part, settings)
        floats = jax.tree.map(
            lambda x: jnp.asarray(x, float if x.dtype.kind == "f" else None), scans.scan
        )
        return Half(part, scans, floats)

    middle = (table.time[0] + table.time[-1]) / 2
    inside = {"first": table.time < middle, "second": table.time >= middle}
    halves = {name: half(rows) for name, rows in inside.items()}
    chosen = kinds.with_algorithm(settings, name)
    chosen = guess.complete(chosen, halves["first"].scans)
    motion = tracking.make(table, chosen)[1].target.layout
    return Case(fitted.tracker(table, chosen), chosen, motion, halves)


def off(settings: Any) -> Any:
    """Returns settings that are wrong by a factor of three, each to the worse side.

    Of probabilities the odds are.
    """

    def mode(one: Any) -> Any:
        odds = one.detect_prob / (1 - one.detect_prob) / 3
        return one._replace(
            noise_density=3 * one.noise_density,
            drift_std=3 * one.drift_std,
            detect_prob=odds / (1 + odds),
            sojourn=one.sojourn / 3,
        )

    sensor, targets = settings.sensor, settings.targets
    return settings._replace(
        sensor=sensor._replace(
            noise_std=3 * sensor.noise_std, clutter_rate=3 * sensor.clutter_rate
        ),
        targets=targets._replace(
            lifetime=targets.lifetime / 3, birth_rate=3 * targets.birth_rate
        ),
        modes={name: mode(one) for name, one in settings.modes.items()},
    )


@functools.cache
def optimizer(steps: int) -> Any:
    """Returns one optimiser for all fits, so that a tracker compiles once."""
    import optax

    return optax.adam(optax.cosine_decay_schedule(0.15, steps))


def fit(
    case: Case, begin: str, half: str, steps: int = STEPS, directory: Any = None
) -> dict[str, Any]:
    """Fits one half; what was found, as JSON can hold it.

    Args:
        case: From `make`.
        begin: Of `FITS`, where it starts.
        half: "first" or "second".
        steps: Of the optimiser.
        directory: Where a fit that is not finished is kept.
    """
    from jaxtrack import learn
    from jaxtrack.recorded import fitted

    first = case.settings if begin == "by hand" else off(case.settings)
    clock = time.perf_counter()
    found = learn.fit(
        case.tracker,
        fitted.numbers(first),
        case.halves[half].scan,
        optimizer(steps),
        loss=learn.loss.held_out(SETTLED),
        num_steps=steps,
        patience=None,
        errors=False,  # NaN: hypotheses come and go where it would measure slopes
        directory=directory,
    )
    told = found.history
    assert told is not None
    return {
        "numbers": harbour_tables.lists(found.params._asdict()),
        "evidence": (-told.loss).tolist(),
        "history": harbour_tables.lists(told.values),
        "seconds": time.perf_counter() - clock,
    }


def tracked(case: Case, settings: Any, half: str) -> Any:
    """Returns the estimates of settings in a half that is tracked anew."""
    import jax

    from jaxtrack.recorded import fitted, tracking

    given, scan = fitted.numbers(settings), case.halves[half].scan
    estimates = tracking.run(case.tracker, given, scan, jax.random.key(0))
    return jax.tree.map(np.asarray, estimates)


def told(case: Case, settings: Any, half: str) -> dict[str, float]:
    """Returns evidence and scores of settings in a half."""
    from jaxtrack.recorded import tracking

    one, estimates = case.halves[half], tracked(case, settings, half)
    # How tracks are scored does not depend on what they were made with.
    made = one.scans, case.settings, case.motion, 0.0, 0.0
    return numbers_of(tracking.Result(estimates, *made), one.table)


def numbers_of(result: Any, table: Any) -> dict[str, float]:
    """Returns evidence and scores of tracks."""
    from jaxtrack.recorded import scoring

    evidence = result.estimates.log_evidence
    settled = len(evidence) - int(np.ceil(SETTLED * len(evidence)))
    scores = scoring.score(result, table, "MMSI")
    gospa = scores.gospa
    return {
        "evidence": float(evidence[settled:].mean()),
        "idf1": float(scores.identity.idf1),
        "switches": int(scores.identity.num_switches),
        "gospa": float(gospa.distance.mean()),
        "near": float(scores.identity.motp),
        "missed": float(gospa.num_missed.mean()),
        "false": float(gospa.num_false.mean()),
        "dropped": float(result.estimates.dropped.mean()),
    }


def everywhere(settings: Any, name: str) -> Any:
    """Returns settings of the box for all of the harbour, and a tracker's name."""
    from jaxtrack.recorded import reading

    plain = reading.harbour()
    share = harbour()[1].sensor.clutter_rate / plain.sensor.clutter_rate
    sensor, targets = settings.sensor, settings.targets
    return settings._replace(
        sensor=sensor._replace(clutter_rate=sensor.clutter_rate / share),
        targets=targets._replace(birth_rate=targets.birth_rate / share),
        scans=plain.scans,
        tracker=plain.tracker._replace(name=name),
    )


def whole(settings: Any) -> dict[str, float]:
    """Returns evidence and scores of all ships in the second half."""
    from jaxtrack.data import files
    from jaxtrack.recorded import tracking

    every = files.read_detections(files.harbour_path())
    table = within(every, every.time >= (every.time[0] + every.time[-1]) / 2)
    return numbers_of(tracking.track(table, settings), table)


def rows(found: dict[str, Any], case: Case) -> dict[str, Any]:
    """Returns the settings that are compared, by what they are called.

    Args:
        found: From `fit`, by "HALF half, begun START".
        case: From `make`.
    """
    from jaxtrack.recorded import fitted

    made = {"by hand": case.settings, "off by 3": off(case.settings)}
    for name, one in found.items():
        numbers = fitted.Numbers(**one["numbers"])
        made[f"fitted on {name}"] = fitted.settings(case.settings, numbers)
    return made


def mixed(settings: dict[str, Any]) -> dict[str, Any]:
    """Returns settings by hand with a number that was found, and the other way round.

    Args:
        settings: From `rows`.
    """
    hand, found = (
        settings["by hand"],
        next(one for name, one in settings.items() if name.startswith("fitted")),
    )
    noise = hand.sensor._replace(noise_std=found.sensor.noise_std)
    life = found.targets._replace(lifetime=hand.targets.lifetime)
    return {
        "by hand, noise_std fitted": hand._replace(sensor=noise),
        "fitted, lifetime by hand": found._replace(targets=life),
    }


def kept(path: pathlib.Path, work: Callable[[], Any]) -> Any:
    """Returns what a file holds, or does the work and keeps it there."""
    if not path.exists():
        part = path.with_suffix(".part")
        part.write_text(json.dumps(work()) + "\n")
        part.replace(path)
    return json.loads(path.read_text())


def fits(case: Case, name: str, out: pathlib.Path) -> dict[str, Any]:
    """Returns what is found, by "HALF half, begun START"; fits what is not yet."""
    found = {}
    for begin, half in FITS:
        work = functools.partial(
            fit, case, begin, half, directory=out / f"{name}-{begin}-{half}"
        )
        one = kept(out / f"{name}-fit-{begin}-{half}.json", work)
        found[word := f"{half} half, begun {begin}"] = one
        print(f"{name}, {word}: {one['seconds']:.0f} s", flush=True)
    return found


def study(name: str, also: list[str], out: pathlib.Path) -> None:
    """Does what is not done yet with a tracker, and writes what came out.

    Args:
        name: The tracker's.
        also: Other trackers that have what it found, with all ships.
        out: Where everything is kept.
    """
    from jaxtrack.recorded import fitted

    case = make(*harbour(), name)
    found, scores = fits(case, name, out), {}
    every = rows(found, case)
    for word, settings in mixed(every).items():
        work = functools.partial(told, case, settings, "second")
        one = kept(out / f"{name}-{word}-second.json", work)
        scores[word] = {"second half, mixed": one}
    for word, settings in every.items():
        scores[word] = mine = {}
        for half in case.halves:
            work = functools.partial(told, case, settings, half)
            mine[f"{half} half"] = kept(out / f"{name}-{word}-{half}.json", work)
        if "second" in word:
            continue  # it was fitted on what is asked for next
        for other in (name, *also):
            chosen = everywhere(settings, other)
            work = functools.partial(whole, chosen)
            one = kept(out / f"{name}-{word}-whole-{other}.json", work)
            mine[f"second half, all ships, {other}"] = one
            (out / f"{name}-{word}-{other}.toml").write_text(fitted.toml(chosen))
    text = (
        harbour_tables.scores_table(scores)
        + "\n"
        + harbour_tables.numbers_table(case, found)
    )
    (out / f"{name}.md").write_text(text)
    harbour_tables.picture(case, found, out / f"{name}.png")
    print(text, flush=True)


def main() -> None:
    """Fits through the trackers that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=["lmb", "mht"], metavar="tracker")
    parser.add_argument(
        "--also", nargs="*", default=["cbmember", "gnn"], metavar="tracker"
    )
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("harbour_fit"))
    given = parser.parse_args()
    start.cores()
    start.cache()
    given.out.mkdir(parents=True, exist_ok=True)
    import jax

    jax.config.update("jax_enable_x64", True)
    for name in given.only:
        study(name, given.also, given.out)


if __name__ == "__main__":
    main()
