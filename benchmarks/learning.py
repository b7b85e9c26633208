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
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxtrack import start

HALF = 100.0  # m, half the line that is watched


class Case(NamedTuple):
    """A tracker and what is learned through it.

    Attributes:
        tracker: Of `trackers`.
        params: The truth.
        first: Where the fit begins.
        where: What is learned.
        names: By path, what it is called and, of several numbers, which is shown.
        size: Recordings, scans of each, slots of a scan.
    """

    tracker: Any
    params: Any
    first: Any
    where: Callable[[Any], Any]
    names: dict[str, tuple[str, tuple[int, ...]]]
    size: tuple[int, int, int] = (8, 50, 12)


def cases() -> dict[str, Callable[[], Case]]:
    """Returns the makers of the cases."""
    known = functools.partial(followed, one=False)
    return {
        "Kalman": functools.partial(followed, one=True),
        "JPDA, exact": functools.partial(known, method="auto"),
        "JPDA, belief propagation": functools.partial(known, method="belief"),
        "IMM-JPDA": switching,
        "PHD": functools.partial(born, "phd"),
        "CPHD": functools.partial(born, "cphd"),
        "CBMeMBer": functools.partial(born, "cbmember"),
        "PMBM": functools.partial(born, "pmbm"),
        "MHT": functools.partial(born, "mht"),
    }


def line(density: Any, std: float, detect: float, survive: float) -> Any:
    """Returns the parameters of one target on the line."""
    import jax.numpy as jnp

    from jaxtrack import models
    from jaxtrack.targets import single

    return single.Params(
        models.motion.ConstantVelocity(jnp.array([density])),
        models.sensor.Position(jnp.array([std])),
        models.probability.Constant(jnp.array(survive)),
        models.probability.Constant(jnp.array(detect)),
    )


def clutter(rate: float) -> Any:
    """Returns false detections all over the line."""
    import jax.numpy as jnp

    from jaxtrack.models.clutter import UniformClutter

    return UniformClutter(jnp.array(rate), jnp.array([-HALF]), jnp.array([HALF]))


def there(prob: float, number: int, modes: int = 1, speed: float = 1.0) -> Any:
    """Returns targets that may begin at places along the line, so fast (m/s)."""
    import jax.numpy as jnp

    from jaxtrack.models.birth import MultiBernoulliBirth

    place = jnp.linspace(-HALF / 2, HALF / 2, number) if number > 1 else jnp.zeros(1)
    return MultiBernoulliBirth(
        existence_prob=jnp.full(number, prob),
        mean=jnp.stack([place, jnp.zeros(number)], 1),
        cov=jnp.tile(jnp.diag(jnp.array([25.0, speed**2]))[None], (number, 1, 1)),
        mode_prob=jnp.full((number, modes), 1.0 / modes),
    )


def patient(target: Any, number: int, **more: Any) -> Any:
    """Makes a JPDA that drops nobody and has no gate, as a fit wants it."""
    from jaxtrack.trackers import jpda, management

    rule = management.MofN(3, 5, 32, 32)
    return jpda.jpda(target, rule=rule, max_tracks=number, gate_prob=1.0, **more)


def followed(one: bool, method: str = "auto") -> Case:
    """Makes a case of known targets that stay: one alone, or two in clutter.

    They begin 100 m apart and seldom meet: where they do JPDA's evidence is worse.
    """
    from jaxtrack.targets import single
    from jaxtrack.trackers import single_scan

    number = 1 if one else 2
    tracker = patient(single.single(), number, method=method)

    def params(density: float, std: float, detect: float, rate: float) -> Any:
        target = line(density, std, 0.9 if one else detect, 1.0)
        rate = 1e-9 if one else rate
        begin = there(1.0, number, speed=0.2)
        return single_scan.Params(target, None, clutter(rate), begin)

    names = {
        "target.motion.noise_density": ("process noise, m²/s³", (0,)),
        "target.sensor.noise_std": ("sensor noise, m", (0,)),
    }
    if one:
        return Case(
            tracker,
            params(0.5, 2.0, 0.9, 0.0),
            params(1.0, 1.4, 0.9, 0.0),
            lambda p: (p.target.motion, p.target.sensor),
            names,
        )
    return Case(
        tracker,
        params(0.02, 2.0, 0.9, 2.0),
        params(0.04, 1.4, 0.7, 3.0),
        lambda p: (p.target.motion, p.target.sensor, p.target.detect, p.clutter.rate),
        names
        | {
            "target.detect.value": ("detection", ()),
            "clutter.rate": ("clutter a scan", ()),
        },
    )


def switching() -> Case:
    """Makes a case of two targets that switch between two motions."""
    import jax.numpy as jnp

    from jaxtrack import models
    from jaxtrack.targets import imm
    from jaxtrack.trackers import single_scan

    def params(slow: float, fast: float, leave: float, back: float) -> Any:
        one = line(1.0, 1.0, 0.95, 1.0)
        motions = tuple(
            models.motion.ConstantVelocity(jnp.array([x])) for x in (slow, fast)
        )
        change = jnp.array([[1 - leave, leave], [back, 1 - back]])
        modes = models.switching.MarkovSwitching(change)
        target = imm.Params(motions, modes, *one[1:])
        return single_scan.Params(target, None, clutter(1.0), there(1.0, 2, 2))

    return Case(
        patient(imm.imm(), 2),
        params(0.05, 10.0, 0.05, 0.2),
        params(0.1, 5.0, 0.1, 0.1),
        lambda p: (p.target.motions, p.target.switching),
        {
            "target.motions[0].noise_density": ("noise of the slow mode", (0,)),
            "target.motions[1].noise_density": ("noise of the fast mode", (0,)),
            "target.switching.transition": ("slow to fast", (0, 1)),
        },
        (8, 100, 10),
    )


def born(name: str) -> Case:
    """Makes a case of targets that are born at a place and die."""
    from jaxtrack.targets import single
    from jaxtrack.trackers import cbmember, cphd, intensity, mht, phd, pmbm, undetected

    target, room = single.single(), {"max_tracks": 12}
    poisson = name in ("phd", "pmbm", "mht")
    makers: dict[str, Callable[[], Any]] = {
        "phd": lambda: phd.phd(target, max_components=40, gate_prob=1.0),
        "cphd": lambda: cphd.cphd(target, max_components=40, gate_prob=1.0),
        "cbmember": lambda: cbmember.cbmember(target, **room),
        "pmbm": lambda: pmbm.pmbm(
            target, max_hypotheses=30, max_undetected=4, gate_prob=1.0, **room
        ),
        "mht": lambda: mht.mht(target, max_undetected=4, gate_prob=1.0, **room),
    }
    kinds = {
        "phd": intensity.Params,
        "cphd": intensity.Params,
        "cbmember": cbmember.Params,
    }

    def params(
        std: float, detect: float, survive: float, rate: float, more: Any
    ) -> Any:
        from jaxtrack.models.birth import PoissonBirth

        birth = there(more, 1)
        if poisson or name == "cphd":
            birth = PoissonBirth(*birth)
        kind = kinds.get(name, undetected.Params)
        return kind(line(0.2, std, detect, survive), birth, clutter(rate))

    return Case(
        makers[name](),
        params(1.0, 0.9, 0.95, 2.0, 0.1),
        params(1.4, 0.8, 0.9, 3.0, 0.2),
        lambda p: (
            p.target.sensor,
            p.target.detect,
            p.target.survive,
            p.clutter.rate,
            p.birth.existence_prob
            if hasattr(p.birth, "existence_prob")
            else p.birth.rate,
        ),
        {
            "target.sensor.noise_std": ("sensor noise, m", (0,)),
            "target.detect.value": ("detection", ()),
            "target.survive.value": ("survival", ()),
            "clutter.rate": ("clutter a scan", ()),
            "birth.rate": ("births a scan", (0,)),
            "birth.existence_prob": ("births a scan", (0,)),
        },
    )


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
        newton(),
        where=case.where,
        num_steps=25,
        patience=4,
        tolerance=1e-5,
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
            known = found.information
            error = np.nan if known is None else known.std_error[path]
            three = (truth[path], told[path], error)
            rows[word] = [
                float(np.broadcast_to(x, np.shape(three[0]))[index]) for x in three
            ]
    return {"case": name, "rows": rows, "seconds": seconds, "stopped": found.stopped}


@functools.cache
def newton() -> Any:
    """Returns one optimiser for all, so that a case compiles once."""
    import optax

    return optax.lbfgs()


def table(fits: list[dict[str, Any]], sizes: dict[str, int]) -> str:
    """Returns the table of all fits in Markdown."""
    import numpy as np

    head = (
        "| tracker | what | truth | mean of fits | error of one | within two errors |"
    )
    lines = [head, "|---|---|---|---|---|---|"]
    for name in dict.fromkeys(each["case"] for each in fits):
        mine = [each for each in fits if each["case"] == name]
        for word in mine[0]["rows"]:
            every = np.array([each["rows"][word] for each in mine])
            truth, found, error = every.T
            fine = np.isfinite(error)
            inside = (fine & (np.abs(found - truth) <= 2 * error)).mean()
            spread = (
                found.std(ddof=1) / np.sqrt(len(found)) if len(found) > 1 else np.nan
            )
            lines.append(
                f"| {name} | {word} | {truth[0]:g} | {found.mean():.4g} ± {spread:.2g} "
                f"| {np.median(error):.2g} | {inside:.0%} |"
            )
        seconds = np.median([each["seconds"] for each in mine])
        done = sum(each["stopped"] == "converged" for each in mine)
        lines.append(
            f"| | {sizes[name]} scans, {seconds:.2g} s a fit, {done} of {len(mine)} "
            "converged | | | | |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Makes the fits that are not there yet, and writes the table."""
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
    fits, sizes = [], {}
    for name in given.only or every:
        case = every[name]()
        sizes[name] = case.size[0] * case.size[1]
        for seed in range(given.fits):
            path = given.out / f"{name}-{seed}.json"
            if not path.exists():
                part = path.with_suffix(".part")
                part.write_text(json.dumps(fit(name, case, seed)) + "\n")
                part.replace(path)
            fits.append(json.loads(path.read_text()))
        (given.out / "table.md").write_text(table(fits, sizes))
        print(table([x for x in fits if x["case"] == name], sizes), flush=True)


if __name__ == "__main__":
    main()
