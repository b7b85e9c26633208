"""What is learned through each tracker: does it come out, and are its errors right?

Truth is drawn from what the tracker assumes (`scenarios.drawn`), on a line, and fitted
from parameters that are off by a tenth up to a factor of two. Fits are repeated on new
recordings: of those that should be known the truth should lie within two standard
errors in some 95 of 100. Not in `make bench`: all of it takes an hour. Every fit is
kept in `--out` when it is done, so that a stopped command goes on (remove it when a
case is changed), and the table of `docs/learning.md` is written there.

    python -m benchmarks.learning --fits 50 --out learning
"""

import argparse
import functools
import json
import pathlib
import time
from collections.abc import Iterable
from typing import Any, NamedTuple

from benchmarks.learning_cases import Case, cases, there
from jaxtrack import start


class About(NamedTuple):
    """What the table says of a case.

    Attributes:
        scans: Of all its recordings.
        kinds: What values a number may have, by what it is called.
    """

    scans: int
    kinds: dict[str, Any]


def about(case: Case) -> About:
    """Returns what the table says of a case."""
    from jaxtrack.learn import leaves

    plan = leaves.plan(case.params, case.where)
    kind = {leaf.path: leaf.constraint.kind for leaf in plan}
    words = case.names.items()
    kinds = {word: kind[path] for path, (word, _) in words if path in kind}
    return About(case.size[0] * case.size[1], kinds)


def recordings(case: Case, seed: int) -> Any:
    """Draws the scans of all recordings, [R, T, ...]."""
    import jax
    import jax.numpy as jnp

    from jaxtrack.scenarios import drawn
    from jaxtrack.scenarios.world import observe

    number, scans, slots = case.size
    params, target = case.params, case.params.target
    first = getattr(params, "start", None)
    birth = params.birth if params.birth is not None else there(0.0, 1)
    if params.birth is None and hasattr(target, "motions"):
        birth = there(0.0, 1, len(target.motions))
    motion = target.motions[0] if hasattr(target, "motions") else target.motion

    def one(key: Any) -> Any:
        keys = jax.random.split(key)
        truth = drawn.draw(keys[0], target, birth, jnp.ones(scans), first, room=2)
        world = truth, motion, target.sensor, target.detect, params.clutter
        return observe(keys[1], *world, slots)

    keys = jax.random.split(jax.random.key(seed), number)
    return jax.jit(jax.vmap(one))(keys)


def fit(name: str, case: Case, seed: int) -> dict[str, Any]:
    """Fits new recordings; estimates and standard errors by what they are called."""
    import jax
    import numpy as np

    from jaxtrack import learn
    from jaxtrack.learn import leaves

    scans, begin = recordings(case, seed), time.perf_counter()
    found = learn.fit(
        case.tracker,
        case.first,
        scans,
        optimizer(case.steps, getattr(case.rough, "draws", None) is not None),
        where=case.where,
        num_steps=case.steps or 25,
        patience=case.steps or 4,
        tolerance=1e-5,
        rough=case.rough,
    )
    seconds = time.perf_counter() - begin
    truth, told = (
        {
            leaf.path: jax.tree.leaves(params)[leaf.index]
            for leaf in leaves.plan(params, case.where)
        }
        for params in (case.params, found.params)
    )
    rows = {}
    for path, (word, index) in case.names.items():
        if path in truth:
            known, value = found.information, told[path]
            error = np.nan if known is None else known.std_error[path]
            three = (truth[path], value, error)
            numbers = [np.broadcast_to(x, np.shape(three[0]))[index] for x in three]
            rows[word] = [float(x) if np.isfinite(x) else None for x in numbers]
    return {"case": name, "rows": rows, "seconds": seconds, "stopped": found.stopped}


@functools.cache
def optimizer(steps: int, drawn: bool) -> Any:
    """Returns one optimiser for all, so that a case compiles once."""
    import optax

    if not steps:
        return optax.lbfgs()
    # Where slopes are drawn the places must go on moving for their mean to be better.
    return optax.adam(0.05 if drawn else optax.cosine_decay_schedule(0.1, steps))


def table(fits: list[dict[str, Any]], abouts: dict[str, About]) -> str:
    """Returns the table of all fits in Markdown."""
    import numpy as np

    heads = (
        "tracker",
        "what",
        "truth",
        "mean of fits",
        "error of one",
        "within two errors",
        "in its interval",
        "scans",
        "seconds",
    )
    lines = [_row(heads), _row(["---"] * len(heads))]
    for name in dict.fromkeys(each["case"] for each in fits):
        mine = [each for each in fits if each["case"] == name]
        seconds = np.median([each["seconds"] for each in mine])
        told = abouts[name]
        rest = told.scans, f"{float(f'{seconds:.2g}'):g}"
        for word in mine[0]["rows"]:
            every = np.array([each["rows"][word] for each in mine], float)
            numbers = _numbers(told.kinds[word], *every.T)
            lines.append(_row([name, word, *numbers, *rest]))
            name, rest = "", ("", "")
    return "\n".join(lines) + "\n"


def _numbers(kind: Any, truth: Any, found: Any, error: Any) -> list[str]:
    """Returns what a row of the table says of a parameter's fits."""
    import numpy as np

    from jaxtrack.learn import intervals

    spread = found.std(ddof=1) / np.sqrt(len(found)) if len(found) > 1 else np.inf
    mean = [f"{truth[0]:g}", f"{found.mean():.4g} ± {spread:.2g}"]
    within = np.abs(found - truth) <= 2 * error  # not so without an error
    low, high = intervals.interval(kind, found, error).T
    inside = (low <= truth) & (truth <= high)
    covered = f"{within.mean():.0%} of {len(within)}", f"{inside.mean():.0%}"
    return [*mean, f"{np.nanmedian(error):.2g}", *covered]


def _row(cells: Iterable[Any]) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def main() -> None:
    """Makes the fits that are not there yet, and writes the table of all that are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=50)
    parser.add_argument("--only", nargs="*", metavar="case", help="these trackers only")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("learning"))
    given = parser.parse_args()
    start.cores()
    start.cache()
    given.out.mkdir(parents=True, exist_ok=True)
    every = cases()
    if unknown := set(given.only or every) - set(every):
        parser.error(f"no case is {min(unknown)}; there are {'; '.join(every)}")
    for name in given.only or every:
        case = every[name]()
        for seed in range(given.fits):
            path = given.out / f"{name}-{seed}.json"
            if not path.exists():
                part = path.with_suffix(".part")
                found = fit(name, case, seed)
                part.write_text(json.dumps(found, allow_nan=False) + "\n")
                part.replace(path)
        fits, abouts = kept(given.out)
        (given.out / "table.md").write_text(table(fits, abouts))
        print(table([x for x in fits if x["case"] == name], abouts), flush=True)


def kept(out: pathlib.Path) -> tuple[list[dict[str, Any]], dict[str, About]]:
    """Reads all fits of a folder, and what there is to say about their cases."""
    fits, abouts = [], {}
    for name, make in cases().items():
        paths = sorted(out.glob(f"{name}-*.json"), key=lambda x: (len(x.name), x.name))
        fits += [json.loads(path.read_text()) for path in paths]
        if paths:
            abouts[name] = about(make())
    return fits, abouts


if __name__ == "__main__":
    main()
