"""What is learned of targets that are born and die, for `benchmarks.learning`."""

import functools
from typing import Any

from benchmarks.learning_cases import Case, clutter, line, there


def born(
    name: str,
    certain: bool = True,
    detect: float = 0.9,
    rate: float = 2.0,
    births: float = 0.1,
) -> Case:
    """Makes a case of targets that are born at a place and die.

    Args:
        name: Of the tracker.
        certain: Whether its evidence is right enough to tell a missed detection and a
            death apart; if not, their probabilities are known.
        detect: Probability of detection.
        rate: False detections a scan.
        births: Of targets, a scan.
    """
    from jaxtrack import learn

    unsure = (0.8, 0.9) if certain else (detect, 0.95)
    # A newborn that is hard to tell from clutter is what a Poisson process does worst.
    width = 5.0 if name in ("phd", "cphd") else 20.0
    birth = functools.partial(one_birth, name, width)
    return Case(
        maker(name),
        world(name, 1.0, detect, 0.95, rate, birth(births, 0.0)),
        world(name, 1.4, *unsure, 1.5 * rate, birth(2 * births, width / 2)),
        lambda p: (
            p.target.sensor,
            (p.target.detect, p.target.survive) if certain else (),
            p.clutter.rate,
            p.birth[0],  # how many
            p.birth.mean,
        ),
        {
            "target.sensor.noise_std": ("sensor noise, m", (0,)),
            "target.detect.value": ("detection", ()),
            "target.survive.value": ("survival", ()),
            "clutter.rate": ("clutter a scan", ()),
            "birth.rate": ("births a scan", (0,)),
            "birth.existence_prob": ("births a scan", (0,)),
            "birth.mean": ("place of births, m", (0, 0)),
        },
        steps=80,
        rough=learn.Rough(),
    )


def maker(name: str) -> Any:
    """Makes a tracker of targets that are born and die, with room for all of them."""
    from jaxtrack.targets import single
    from jaxtrack.trackers import cbmember, cphd, mht, phd, pmbm

    target, room = single.single(), {"max_tracks": 12}
    # Merging widens components, which less noise would make up for.
    cloud: Any = {"max_components": 40, "merge_threshold": 1.0}
    cloud |= {"prune_threshold": 1e-4}
    if name == "phd":
        return phd.phd(target, **cloud)
    if name == "cphd":
        return cphd.cphd(target, max_targets=8, **cloud)
    if name == "cbmember":
        return cbmember.cbmember(target, **room)
    if name == "mht":  # after two scans some count as dead that are seen again
        room |= {"num_scans": 4, "max_leaves": 20, "max_tracks": 16}
        return mht.mht(target, max_undetected=4, gate_prob=1.0, **room)
    if name != "pmbm":
        raise ValueError(f"name is {name!r}; give phd, cphd, cbmember, pmbm or mht")
    # Weak tracks that go back to those undetected need no hypotheses of their own.
    return pmbm.pmbm(
        target,
        max_hypotheses=30,
        max_undetected=24,
        recycle_threshold=0.3,
        gate_prob=1.0,
        **room,
    )


def world(
    name: str, std: float, detect: float, survive: float, rate: float, birth: Any
) -> Any:
    """Returns the parameters of a tracker of targets that are born and die."""
    from jaxtrack.trackers import cbmember, intensity, undetected

    kinds = {
        "phd": intensity.Params,
        "cphd": intensity.Params,
        "cbmember": cbmember.Params,
    }
    kind = kinds.get(name, undetected.Params)
    return kind(line(0.2, std, detect, survive), birth, clutter(rate))


def one_birth(name: str, width: float, births: float, place: float) -> Any:
    """Returns how targets are born, so many a scan, within `width` of a place (m)."""
    import jax.numpy as jnp

    from jaxtrack.models.birth import PoissonBirth

    birth = there(births, 1)
    cov = jnp.diag(jnp.array([width**2, 1.0]))[None]
    birth = birth._replace(mean=birth.mean.at[0, 0].set(place), cov=cov)
    return birth if name == "cbmember" else PoissonBirth(*birth)
