"""How far is each tracker's `log_evidence` from the truth, where that can be known?

Small problems, drawn from what the trackers assume, of which all hypotheses are listed:
two targets that are known and compete for their detections (`listed`, in NumPy), and
targets that are born and die (`jaxtrack.trackers.oracle`). Prints the table of
`docs/learning.md`: by how much a scan's log-evidence is too large, and how that differs
between problems.

    python -m benchmarks.evidence
"""

import itertools
from typing import Any, NamedTuple

import numpy as np

from jaxtrack import start

PROBLEMS, SLOTS, HALF = 100, 4, 20.0  # of each kind; detections a scan; m
KNOWN, BORN = 4, 3  # scans
STD, TIME, SENSOR, DETECT = 8.0, 3.0, 1.5, 0.9  # m, s, m
SURVIVE, BIRTHS, CLUTTER = 0.9, 0.3, 1.0
PLACES = -2.0, 2.0  # m, of the known targets
STD_KNOWN = 2.0  # m, and m/s
LOG_FALSE = np.log(CLUTTER / (2 * HALF))  # of a detection, if it is false


class Kind(NamedTuple):
    """Problems of a kind.

    Attributes:
        name: What is known of the targets.
        scans: [P, T, ...].
        exact: The log-evidence of each, [P].
        trackers: By name, with their parameters.
    """

    name: str
    scans: Any
    exact: np.ndarray
    trackers: dict[str, tuple[Any, Any]]


def target(survive: float) -> Any:
    """Returns the parameters of a target that stays near 0, as long as it lives."""
    import jax.numpy as jnp

    from jaxtrack import models
    from jaxtrack.targets import single

    return single.Params(
        models.motion.OrnsteinUhlenbeck(jnp.array([STD]), jnp.array([TIME])),
        models.sensor.Position(jnp.array([SENSOR])),
        models.probability.Constant(jnp.array(survive)),
        models.probability.Constant(jnp.array(DETECT)),
    )


def clutter(rate: float) -> Any:
    """Returns false detections all over the line."""
    import jax.numpy as jnp

    from jaxtrack.models.clutter import UniformClutter

    return UniformClutter(jnp.array(rate), jnp.array([-HALF]), jnp.array([HALF]))


def there(prob: float, places: tuple[float, ...], std: float, speed: float) -> Any:
    """Returns targets that may be at places."""
    import jax.numpy as jnp

    from jaxtrack.models.birth import MultiBernoulliBirth

    num = len(places)
    cov = jnp.diag(jnp.array([std**2, speed**2]))
    return MultiBernoulliBirth(
        existence_prob=jnp.full(num, prob),
        mean=jnp.stack([jnp.array(places), jnp.zeros(num)], 1),
        cov=jnp.tile(cov[None], (num, 1, 1)),
        mode_prob=jnp.ones((num, 1)),
    )


def drawn(one: Any, birth: Any, known: Any, scans: int, slots: int) -> Any:
    """Draws the scans of all problems."""
    import jax
    import jax.numpy as jnp

    from jaxtrack.scenarios import drawn, world

    def scene(key: Any) -> Any:
        keys = jax.random.split(key)
        truth = drawn.draw(keys[0], one, birth, jnp.ones(scans), known)
        seen = one.motion, one.sensor, one.detect, clutter(CLUTTER)
        return world.observe(keys[1], truth, *seen, slots)

    return jax.jit(jax.vmap(scene))(jax.random.split(jax.random.key(0), PROBLEMS))


def listed(places: np.ndarray, valid: np.ndarray) -> float:
    """Lists whose the detections of the known targets may be, and sums up.

    Args:
        places: [T, K].
        valid: [T, K] (bool).
    """
    choices = [[-1, *np.nonzero(seen)[0]] for seen in valid]
    sequences = np.array(list(itertools.product(*choices)))
    one, other = (
        np.array([alone(place, places, sequence) for sequence in sequences])
        for place in PLACES
    )
    both = one[:, None] + other[None]
    clash = (sequences[:, None] == sequences[None]) & (sequences[:, None] >= 0)
    both = np.where(clash.any(-1), -np.inf, both)
    false = valid.sum() * LOG_FALSE - CLUTTER * len(valid)
    return float(np.logaddexp.reduce(both.ravel()) + false)


def alone(place: float, places: np.ndarray, sequence: np.ndarray) -> float:
    """Returns the log-density of a target's detections, against their being false.

    Args:
        place: Where it was expected at first.
        places: [T, K].
        sequence: Which of them are its own, -1 for none, [T] (int).
    """
    fade, x = np.exp(-1 / TIME), 1 / TIME  # a critically damped oscillator, after 1 s
    step = fade * np.array([[1 + x, 1.0], [-x / TIME, 1 - x]])
    rest = np.diag([STD**2, (STD / TIME) ** 2])
    noise = rest - step @ rest @ step.T
    mean, cov, total = np.array([place, 0.0]), STD_KNOWN**2 * np.eye(2), 0.0
    for scan, k in zip(places, sequence, strict=True):
        mean, cov = step @ mean, step @ cov @ step.T + noise
        if k < 0:
            total += np.log(1 - DETECT)
            continue
        spread, miss = cov[0, 0] + SENSOR**2, scan[k] - mean[0]
        likelihood = -0.5 * (np.log(2 * np.pi * spread) + miss**2 / spread)
        total += np.log(DETECT) + likelihood - LOG_FALSE
        gain = cov[:, 0] / spread
        mean, cov = mean + gain * miss, cov - np.outer(gain, cov[0])
    return total


def known() -> Kind:
    """Makes the problems of two known targets."""
    import jax.numpy as jnp

    from jaxtrack.models.birth import PoissonBirth
    from jaxtrack.trackers import single_scan, undetected

    one, begin = target(1.0), there(1.0, PLACES, STD_KNOWN, STD_KNOWN)
    nobody = begin._replace(existence_prob=jnp.zeros(2))
    scans = drawn(one, nobody, begin, KNOWN, SLOTS)
    exact = [
        listed(*pair)
        for pair in zip(
            np.asarray(scans.detections[..., 0], float),
            np.asarray(scans.valid),
            strict=True,
        )
    ]
    by_scan = single_scan.Params(one, None, clutter(CLUTTER), begin)
    bernoullis = undetected.Params(one, nobody, clutter(CLUTTER), start=begin)
    poisson = bernoullis._replace(birth=PoissonBirth(jnp.zeros(2), *nobody[1:]))
    every = {name: (tracker, by_scan) for name, tracker in of_one_scan().items()}
    every |= {name: (tracker, poisson) for name, tracker in of_several_scans().items()}
    every |= {name: (tracker, bernoullis) for name, tracker in of_bernoullis().items()}
    return Kind("two known targets", scans, np.array(exact), every)


def of_one_scan() -> dict[str, Any]:
    """Makes trackers of known targets that decide in every scan."""
    from jaxtrack.targets import single
    from jaxtrack.trackers import (
        gnn,
        jpda,
        jpda_star,
        management,
        nearest,
        pda,
        set_jpda,
    )

    algebra, rule = single.single(), management.MofN(3, 5, 32, 32)
    stay: Any = {"rule": rule, "max_tracks": 2, "gate_prob": 1.0}
    return {
        "jpda": jpda.jpda(algebra, **stay),
        "jpda, belief propagation": jpda.jpda(algebra, method="belief", **stay),
        "jpda, 3 likeliest events": jpda.jpda(algebra, max_events=3, **stay),
        "set_jpda": set_jpda.set_jpda(algebra, **stay),
        "jpda_star": jpda_star.jpda_star(algebra, **stay),
        "gnn": gnn.gnn(algebra, **stay),
        "nearest": nearest.nearest(algebra, **stay),
        "pda": pda.pda(algebra, **stay),
    }


def of_several_scans() -> dict[str, Any]:
    """Makes trackers of known targets that decide later."""
    from jaxtrack.targets import single
    from jaxtrack.trackers import mht

    tracker = mht.mht(single.single(), max_tracks=12, gate_prob=1.0)
    return {"mht, decided after 2 scans": tracker}


def of_bernoullis() -> dict[str, Any]:
    """Makes trackers of known targets that were born in a Bernoulli process."""
    from jaxtrack.targets import single
    from jaxtrack.trackers import lmb, mbm

    algebra, few = single.single(), {"max_tracks": 4, "gate_prob": 1.0}
    return {
        "lmb": lmb.lmb(algebra, **few),
        "mbm, 10 hypotheses": mbm.mbm(algebra, max_hypotheses=10, **few),
        "mbm, 100 hypotheses": mbm.mbm(algebra, max_hypotheses=100, **few),
    }


def born() -> Kind:
    """Makes the problems of targets that are born and die."""
    import jax

    from jaxtrack.models.birth import PoissonBirth
    from jaxtrack.targets import single
    from jaxtrack.trackers import cphd, intensity, oracle, phd, undetected

    one, algebra = target(SURVIVE), single.single()
    birth = PoissonBirth(*there(BIRTHS, (0.0,), STD, STD / TIME))
    scans = drawn(one, birth, None, BORN, 2)
    params = undetected.Params(one, birth, clutter(CLUTTER))

    def truth(scans: Any) -> Any:
        apart = [jax.tree.map(lambda x, t=t: x[t], scans) for t in range(BORN)]
        told = oracle.posterior(algebra, params, apart, jax.random.key(0))
        return told.log_evidence

    exact = jax.jit(lambda scans: jax.lax.map(truth, scans, batch_size=20))(scans)
    every: dict[str, tuple[Any, Any]] = {
        name: (tracker, params) for name, tracker in of_births().items()
    }
    density = intensity.Params(one, birth, clutter(CLUTTER))
    every["phd"] = phd.phd(algebra), density
    every["cphd"] = cphd.cphd(algebra), density
    return Kind("targets that are born and die", scans, np.asarray(exact), every)


def of_births() -> dict[str, Any]:
    """Makes trackers with hypotheses of targets that are born and die."""
    from jaxtrack.targets import single
    from jaxtrack.trackers import hypothesis_mht, mcmcda, mht, pmb, pmbm, tpmbm

    algebra = single.single()
    room: Any = {"gate_prob": 1.0, "max_tracks": 8}
    return {
        "pmbm": pmbm.pmbm(algebra, max_hypotheses=100, **room),
        "pmbm, 3 hypotheses": pmbm.pmbm(algebra, max_hypotheses=3, **room),
        "pmb": pmb.pmb(algebra, **room),
        "tpmbm": tpmbm.tpmbm(algebra, **room),
        "mht": mht.mht(algebra, **room),
        "hypothesis_mht": hypothesis_mht.hypothesis_mht(algebra, **room),
        "mcmcda": mcmcda.mcmcda(algebra),
    }


def differences(kind: Kind, name: str) -> np.ndarray:
    """Returns a tracker's log-evidence of all scans less the exact one, [P]."""
    import jax

    from jaxtrack import engine

    tracker, params = kind.trackers[name]
    keys = engine.run_keys(0, 0, len(kind.exact))
    told = engine.run_many(tracker, params, kind.scans, keys)
    return np.asarray(jax.device_get(told.log_evidence)).sum(1) - kind.exact


def main() -> None:
    """Prints the table."""
    start.cores()
    start.cache()
    import jax

    jax.config.update("jax_enable_x64", True)
    print("| problems | tracker | too large by | differs by | at most |")
    print("|---|---|---|---|---|")
    for make, scans in ((known, KNOWN), (born, BORN)):
        kind = make()
        for name in kind.trackers:
            off = differences(kind, name) / scans
            shown = [
                f"{x:.1e}" if abs(x) < 1e-3 else f"{x:.3f}"
                for x in (off.mean(), off.std(), abs(off).max())
            ]
            print(f"| {kind.name} | `{name}` | {' | '.join(shown)} |", flush=True)


if __name__ == "__main__":
    main()
