"""What does a fit cost: its time, its gradient beside the value, and its memory?

Through JPDA, four targets in clutter, 64 recordings of 100 scans, on all cores; and
through IMM-JPDA, four targets, one recording of 10,000 scans.

    python -m benchmarks.fit
"""

import time
from collections.abc import Callable
from typing import Any

from jaxtrack import start

RECORDINGS, SCANS, SLOTS, STEPS = 64, 100, 18, 80
LONG, SEGMENT, TIMES = 10_000, 100, 5
HALF = 300.0  # m


def parameters(noise: float, std: float, detect: float) -> Any:
    """Returns those of four targets, which begin at the corners of a square."""
    import jax.numpy as jnp

    from jaxtrack import models
    from jaxtrack.targets import single
    from jaxtrack.trackers import single_scan

    corners = jnp.array([[x, 0.0, y, 0.0] for x in (-60.0, 60.0) for y in (-60.0, 60)])
    begin = models.birth.MultiBernoulliBirth(
        existence_prob=jnp.ones(4),
        mean=corners,
        cov=jnp.tile(jnp.diag(jnp.array([4.0, 1.0, 4.0, 1.0]))[None], (4, 1, 1)),
        mode_prob=jnp.ones((4, 1)),
    )
    box = jnp.full(2, HALF)
    target = single.Params(
        models.motion.ConstantVelocity(jnp.full(2, noise)),
        models.sensor.Position(jnp.full(2, std)),
        models.probability.Constant(jnp.array(1.0)),
        models.probability.Constant(jnp.array(detect)),
    )
    clutter = models.clutter.UniformClutter(jnp.array(5.0), -box, box)
    return single_scan.Params(target, None, clutter, begin)


def several(params: Any) -> Any:
    """Returns the parameters of the same targets with two modes of motion."""
    import jax.numpy as jnp

    from jaxtrack import models
    from jaxtrack.targets import imm

    calm = params.target.motion
    motions = calm, calm._replace(noise_density=20 * calm.noise_density)
    switching = models.switching.MarkovSwitching(jnp.array([[0.95, 0.05], [0.1, 0.9]]))
    begin = params.start._replace(mode_prob=jnp.full((4, 2), 0.5))
    target = imm.Params(motions, switching, *params.target[1:])
    return params._replace(target=target, start=begin)


def recordings(seed: int) -> Any:
    """Draws the scans of all recordings, [R, T, ...]."""
    import jax
    import jax.numpy as jnp

    from jaxtrack.scenarios import drawn, world

    params = parameters(0.02, 2.0, 0.9)
    nobody = params.start._replace(existence_prob=jnp.zeros(4))

    def one(key: Any) -> Any:
        keys = jax.random.split(key)
        ones = jnp.ones(SCANS)
        truth = drawn.draw(keys[0], params.target, nobody, ones, params.start)
        truth = truth._replace(state=truth.state[:, :4], exists=truth.exists[:, :4])
        motion, sensor, _, detect = params.target
        seen = truth, motion, sensor, detect, params.clutter
        return world.observe(keys[1], *seen, SLOTS)

    return jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(seed), RECORDINGS))


def tracker(target: Any) -> Any:
    """Makes a JPDA as a fit wants it: nobody is dropped, and there is no gate."""
    from jaxtrack.trackers import jpda, management

    rule = management.MofN(3, 5, 32, 32)
    return jpda.jpda(target, max_tracks=4, gate_prob=1.0, rule=rule)


def whole_fits() -> list[float]:
    """Returns the seconds of two fits, of which the first compiles, and tells them."""
    import numpy as np
    import optax

    from jaxtrack import learn
    from jaxtrack.targets import single

    optimizer, seconds = optax.adam(0.1), []
    for seed in range(2):
        scans, begin = recordings(seed), time.perf_counter()
        found = learn.fit(
            tracker(single.single()),
            parameters(0.04, 4.0, 0.7),
            scans,
            optimizer,
            where=learned,
            num_steps=STEPS,
        )
        seconds.append(time.perf_counter() - begin)
        if found.information is None or found.history is None:
            raise RuntimeError(f"the fit told nothing: {found.message}")
        best = int(np.argmin(found.history.loss))
        for name, error in found.information.std_error.items():
            value = found.history.values[name][best]
            print(f"  {name}: {value.round(4)} ± {error.round(4)}")
    return seconds


def learned(params: Any) -> Any:
    """Names what is fitted."""
    return params.target.motion, params.target.sensor, params.target.detect


def gradient() -> tuple[float, float]:
    """Returns the seconds of a value and of a slope of all recordings."""
    import jax

    from jaxtrack.learn import leaves, loss, slopes
    from jaxtrack.targets import single

    params = parameters(0.04, 4.0, 0.7)
    plan = leaves.plan(params, learned)
    rest = None, None, None, 16, 1  # no prior, batch or window; blocks and segments
    problem = slopes.Problem(tracker(single.single()), plan, loss.evidence, *rest)
    data, key = slopes.gather(recordings(0), None, 0), jax.random.key(0)
    free = leaves.unconstrain(plan, params)
    value = jax.jit(slopes.value_of, static_argnums=0)
    return (
        quickest(lambda: value(problem, params, free, data, key)),
        quickest(lambda: slopes.slope(problem, params, data, free, key)),
    )


def quickest(call: Callable[[], Any]) -> float:
    """Returns the seconds of the quickest of several calls, after a first one."""
    import jax

    jax.block_until_ready(call())
    seconds = []
    for _ in range(TIMES):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def memory(segment: int | None) -> float:
    """Returns the MiB that a slope over many scans needs at once."""
    import jax
    import jax.numpy as jnp

    from jaxtrack.learn import segments
    from jaxtrack.targets import imm
    from jaxtrack.types import Scan

    params, key = several(parameters(0.1, 2.0, 0.9)), jax.random.key(0)
    shape = LONG, 6, 2
    places = jax.random.uniform(key, shape, minval=-HALF, maxval=HALF)
    scans = Scan(places, jnp.ones(shape[:2], bool), jnp.ones(LONG))

    def evidence(params: Any) -> Any:
        told = segments.run(tracker(imm.imm()), params, scans, key, segment)
        return told.log_evidence.mean()

    compiled = jax.jit(jax.value_and_grad(evidence)).lower(params).compile()
    used: Any = compiled.memory_analysis()
    return used.temp_size_in_bytes / 2**20


def main() -> None:
    """Prints all."""
    start.cores()
    start.cache()
    print(f"fits of {RECORDINGS} recordings of {SCANS} scans, {STEPS} steps:")
    first, second = whole_fits()
    print(f"  {first:.1f} s with compilation, then {second:.1f} s")
    value, slope = gradient()
    print(
        f"value {value:.3f} s, slope {slope:.3f} s, {slope / value:.1f} times as much"
    )
    for segment in None, SEGMENT:
        told = f"{LONG} scans, segment {segment}: {memory(segment):.1f} MiB"
        print(told, flush=True)


if __name__ == "__main__":
    main()
