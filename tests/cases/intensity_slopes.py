"""Scenes on the edges of what an intensity can meet, and slopes of their evidence.

All have the same shapes, so that one program serves all. The values are what may be
learned; what cannot move both ways, such as a probability of 1, is held by no
difference.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from cases import intensities, slopes

EMPTY = -np.inf


class Sight(NamedTuple):
    """Detection that fades out beyond an edge, softly."""

    value: Any
    edge: Any

    def prob(self, mode, state, interval):
        del mode, interval
        return self.value * jax.nn.sigmoid(self.edge - state[0])


class Values(NamedTuple):
    """What may be learned, all finite; `there` and `possible` of an Edge mask some."""

    log_weight: Any
    log_number: Any
    mean: Any
    cov: Any
    detections: Any
    detect: Any
    edge: Any
    rate: Any
    noise_std: Any


class Edge(NamedTuple):
    """Which slots hold anything, and which values have no difference to hold them."""

    valid: Any
    there: Any
    possible: Any
    stuck: tuple = ()


FULL = Edge(np.ones(4, bool), np.ones(4, bool), np.ones(6, bool))
SOME = Edge(np.arange(4) % 3 == 1, np.arange(4) != 2, np.arange(6) != 1)
USUAL = {"detect": 0.9, "edge": 1e3, "rate": 2.0}
EDGES = {
    "full": (FULL, {}),
    "with_empty_slots": (SOME, {}),
    "no_detection": (FULL._replace(valid=np.zeros(4, bool)), {}),
    "nobody": (FULL._replace(there=np.zeros(4, bool), possible=np.arange(6) == 0), {}),
    "known_number": (FULL._replace(possible=np.arange(6) == 3), {}),
    "no_clutter": (SOME._replace(stuck=("rate",)), {"rate": 0.0}),
    "sure": (FULL._replace(stuck=("detect", "edge")), {"detect": 1.0}),
    "blind": (FULL._replace(stuck=("detect",)), {"detect": 0.0}),
    "blind_without_clutter": (
        SOME._replace(stuck=("detect", "rate")),
        {"detect": 0.0, "rate": 0.0},
    ),
    "field_of_view": (FULL, {"edge": 0.5}),
}


def values_of(which):
    rng = np.random.default_rng(3)
    given = {**USUAL, **EDGES[which][1]}
    root = rng.normal(size=(4, 2, 2))
    return Values(
        log_weight=np.log(rng.uniform(0.3, 1.5, 4)),
        log_number=np.log(rng.dirichlet(np.ones(6))),
        mean=rng.uniform(-4, 4, (4, 2)),
        cov=root @ np.swapaxes(root, 1, 2) + 0.3 * np.eye(2)[None],
        detections=rng.uniform(-5, 5, (4, 1)),
        noise_std=np.array([intensities.STD]),
        **{name: np.array(value) for name, value in given.items()},
    )


def scene_of(edge, values):
    params = intensities.params_of("single", (0.5,), 0.5)
    sensor = params.target.sensor._replace(noise_std=values.noise_std)
    sight = Sight(values.detect, values.edge)
    target = params.target._replace(detect=sight, sensor=sensor)
    clutter = params.clutter._replace(rate=values.rate)
    cov = (values.cov + jnp.swapaxes(values.cov, 1, 2)) / 2
    components = intensities.intensity.Components(
        jnp.where(edge.there, values.log_weight, EMPTY),
        intensities.Gaussian(values.mean, cov),
        jnp.arange(4),
    )
    return intensities.Scene(
        params._replace(target=target, clutter=clutter),
        components,
        jnp.where(edge.possible, values.log_number, EMPTY),
        intensities.Scan(values.detections, edge.valid, jnp.array(1.0)),
    )


def program(log_evidence):
    """(valid, there, possible, values[B]) -> log-evidence and slopes, compiled."""

    def one(valid, there, possible, values):
        return log_evidence(scene_of(Edge(valid, there, possible), values))

    return jax.jit(jax.vmap(jax.value_and_grad(one, argnums=3), (None, None, None, 0)))


def check(value_and_slope, which):
    """Slopes are finite, and the differences where values may move both ways."""
    edge, values = EDGES[which][0], values_of(which)
    moved, scale = slopes.walks(values)
    every = jax.tree.map(lambda x, y: np.concatenate([x[None], y]), values, moved)
    found, slope = value_and_slope(*edge[:3], every)
    slope = jax.tree.map(lambda x: np.asarray(x[0]), slope)
    assert np.isfinite(found[0])
    assert np.isfinite(slopes.flat(slope)).all()
    free = slopes.flat(
        Values(
            *(
                np.full(x.shape, n not in edge.stuck)
                for n, x in values._asdict().items()
            )
        )
    )
    # Absolute, for slopes near zero: the evidence is a few hundred, its rounding 1e-13,
    # which a step of 1e-5 makes 1e-8; ten times that are allowed.
    slopes.assert_near(
        values,
        slopes.flat(slope) * scale * free,
        slopes.differences(found[1:]) * free,
        rtol=1e-5,
        atol=1e-7,
    )
