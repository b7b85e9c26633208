"""What is learned of known targets, for `benchmarks.learning`, and the list of all."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

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
        steps: Of Adam, slower and slower but where slopes are drawn; 0 where the
            evidence is so smooth that a quasi-Newton method finds its way, which stops
            before a cliff.
        rough: What is done where it is rough, a `learn.Rough`.
    """

    tracker: Any
    params: Any
    first: Any
    where: Callable[[Any], Any]
    names: dict[str, tuple[str, tuple[int, ...]]]
    size: tuple[int, int, int] = (8, 50, 12)
    steps: int = 0
    rough: Any = None


def cases() -> dict[str, Callable[[], Case]]:
    """Returns the makers of the cases."""
    from benchmarks.learning_born import born

    known = functools.partial(followed, one=False)
    return {
        "Kalman": functools.partial(followed, one=True),
        "JPDA, exact": functools.partial(known, method="auto"),
        "JPDA, belief propagation": functools.partial(known, method="belief"),
        "particles": particles,
        "IMM-JPDA, precise sensor": functools.partial(
            switching, std=0.2, slow=0.5, fast=5.0, half=1e4
        ),
        "IMM-JPDA": switching,
        "JPDA, mixtures of modes": functools.partial(switching, mixtures=True),
        "PHD": functools.partial(born, "phd", certain=False),
        "PHD, detection 0.98": functools.partial(born, "phd", False, detect=0.98),
        "CPHD": functools.partial(born, "cphd", certain=False),
        "CPHD, detection 0.98, clutter 0.5": functools.partial(
            born, "cphd", False, detect=0.98, rate=0.5
        ),
        "CBMeMBer": functools.partial(born, "cbmember", certain=False),
        "CBMeMBer, few targets": functools.partial(
            born, "cbmember", False, rate=0.5, births=0.03
        ),
        "PMBM": functools.partial(born, "pmbm"),
        "MHT": functools.partial(born, "mht"),
        "PHD, all at once": functools.partial(born, "phd"),
        "CPHD, all at once": functools.partial(born, "cphd"),
        "CBMeMBer, all at once": functools.partial(born, "cbmember"),
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


def clutter(rate: float, half: float = HALF) -> Any:
    """Returns false detections all over the line, to so many m from its middle."""
    import jax.numpy as jnp

    from jaxtrack.models.clutter import UniformClutter

    return UniformClutter(jnp.array(rate), jnp.array([-half]), jnp.array([half]))


def there(
    prob: float, number: int, modes: int = 1, speed: float = 1.0, half: float = HALF
) -> Any:
    """Returns targets that may begin at places along the line, so fast (m/s)."""
    import jax.numpy as jnp

    from jaxtrack.models.birth import MultiBernoulliBirth

    place = jnp.linspace(-half / 2, half / 2, number) if number > 1 else jnp.zeros(1)
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


def switching(
    mixtures: bool = False,
    std: float = 1.0,
    slow: float = 0.05,
    fast: float = 10.0,
    half: float = HALF,
) -> Case:
    """Makes a case of two targets that switch between two motions.

    They stay 20 scans or more in each: IMM, which merges what it knows of older
    switches, is the worse the oftener there are some, and the longer it matters what
    was before: with a noisy sensor, and motions that have little in common.

    Args:
        mixtures: Whether several histories of modes are kept apart.
        std: Noise of the sensor, m.
        slow: Noise of one motion, m^2/s^3.
        fast: Noise of the other.
        half: Of the line, m; how far apart they begin.
    """
    import jax.numpy as jnp

    from jaxtrack import learn, models
    from jaxtrack.targets import imm, mixture
    from jaxtrack.trackers import single_scan

    def params(one: float, two: float, leave: float, back: float) -> Any:
        rest = line(1.0, std, 0.95, 1.0)[1:]
        motions = tuple(
            models.motion.ConstantVelocity(jnp.array([x])) for x in (one, two)
        )
        change = jnp.array([[1 - leave, leave], [back, 1 - back]])
        modes = models.switching.MarkovSwitching(change)
        target = imm.Params(motions, modes, *rest)
        begin = there(1.0, 2, 2, half=half)
        return single_scan.Params(target, None, clutter(1.0, half), begin)

    several = mixture.mixture(8, prune_threshold=1e-7, merge_threshold=0.01)
    return Case(
        patient(several if mixtures else imm.imm(), 2),
        params(slow, fast, 0.02, 0.05),
        params(2 * slow, fast / 2, 0.05, 0.1),
        lambda p: (p.target.motions, p.target.switching),
        {
            "target.motions[0].noise_density": ("noise of the slow mode", (0,)),
            "target.motions[1].noise_density": ("noise of the fast mode", (0,)),
            "target.switching.transition": ("slow to fast", (0, 1)),
        },
        (8, 150, 10),
        steps=100,
        rough=None if mixtures else learn.Rough(),
    )


def particles() -> Case:
    """Makes the case of one target, followed by particles.

    Their slopes scatter, the less, the better the particles are placed: drawn from the
    motion by ten times as much as one recording knows of the process noise.
    """
    import jax.numpy as jnp

    from jaxtrack import learn, linearize, models, resampling
    from jaxtrack.targets import imm
    from jaxtrack.targets import particles as cloud

    case = followed(one=True)

    def several(params: Any) -> Any:
        one, alone = params.target, models.switching.MarkovSwitching(jnp.ones((1, 1)))
        return params._replace(target=imm.Params((one.motion,), alone, *one[1:]))

    target = cloud.particles(
        600, scheme=resampling.soft(0.5), proposal=linearize.taylor
    )
    name, *rest = case.names
    first = "target.motions[0].noise_density"
    return case._replace(
        tracker=patient(target, 1),
        params=several(case.params),
        first=several(case.first),
        where=lambda p: (p.target.motions, p.target.sensor),
        names={first: case.names[name]} | {x: case.names[x] for x in rest},
        steps=50,
        rough=learn.Rough(average=25, apart=2.0, draws=8),
    )
