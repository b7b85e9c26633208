"""Random scenes small enough to know everything: stationary targets on a line.

A newborn is distributed as any target is at any time, so one Gaussian a track is exact.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.models.birth import PoissonBirth
from jaxtrack.models.clutter import UniformClutter
from jaxtrack.models.motion import OrnsteinUhlenbeck
from jaxtrack.models.probability import Constant
from jaxtrack.models.sensor import Position
from jaxtrack.targets import single
from jaxtrack.trackers import undetected
from jaxtrack.types import Scan

SIZES = 2, 1, 2
INTERVAL, BOX = 0.7, 40.0
target = single.single()


def draw(seed):
    """Numbers of a random problem."""
    rng = np.random.default_rng(seed)
    return {
        "position_std": rng.uniform(1.0, 4.0),
        "time_constant": rng.uniform(1.0, 3.0),
        "sensor_var": rng.uniform(0.2, 2.0),
        "births": rng.uniform(0.05, 0.8),
        "undetected": rng.uniform(0.2, 2.0),
        "survive": rng.uniform(0.6, 0.99),
        "detect": rng.uniform(0.4, 0.95),
        "clutter": rng.uniform(0.2, 3.0),
        "false_density": 1 / BOX,
    }


def params_of(drawn):
    motion = OrnsteinUhlenbeck(
        jnp.asarray(drawn["position_std"])[None],
        jnp.asarray(drawn["time_constant"])[None],
    )
    speed = drawn["position_std"] / drawn["time_constant"]
    cov = jnp.diag(jnp.stack([drawn["position_std"] ** 2, speed**2]))

    def places(rate):
        one = jnp.asarray(rate)[None]
        return PoissonBirth(one, jnp.zeros((1, 2)), cov[None], jnp.ones((1, 1)))

    return undetected.Params(
        target=single.Params(
            motion,
            Position(jnp.sqrt(drawn["sensor_var"])[None]),
            Constant(jnp.asarray(drawn["survive"])),
            Constant(jnp.asarray(drawn["detect"])),
        ),
        birth=places(drawn["births"]),
        clutter=UniformClutter(
            jnp.asarray(drawn["clutter"]), -BOX / 2 * jnp.ones(1), BOX / 2 * jnp.ones(1)
        ),
        undetected=places(drawn["undetected"]),
    )


def model_of(drawn, **more):
    """The same for the plain references."""
    x = INTERVAL / drawn["time_constant"]  # a critically damped oscillator
    transition = np.exp(-x) * np.array(
        [[1 + x, INTERVAL], [-x / drawn["time_constant"], 1 - x]]
    )
    speed = drawn["position_std"] / drawn["time_constant"]
    stationary = np.diag([drawn["position_std"] ** 2, speed**2])
    return {**drawn, "transition": transition, "stationary": stationary, **more}


def detections(seed, sizes=SIZES):
    rng = np.random.default_rng(1000 + seed)
    return [rng.normal(0.0, 3.0, size) for size in sizes]


def scans_of(places):
    return [
        Scan(x[:, None], jnp.ones(len(x), bool), jnp.asarray(INTERVAL)) for x in places
    ]


def padded(places):
    """The same scans, all of the same number of slots."""
    most = max(len(x) for x in places)
    return [
        Scan(
            jnp.pad(x, (0, most - len(x)))[:, None],
            jnp.arange(most) < len(x),
            jnp.asarray(INTERVAL),
        )
        for x in places
    ]


def stacked(trees):
    return jax.tree.map(lambda *x: jnp.stack([jnp.asarray(y) for y in x]), *trees)
