"""Probabilistic MHT over a batch of scans: expectation-maximisation.

A fixed number of targets, and each detection has its cause independently of all others,
so that nothing grows with the number of hypotheses. One iteration is

    w[k, n] ~ lambda_n N(z_k; H x_n, R), with the clutter's density beside it
    W[n] = sum_k w[k, n],  synthetic detection sum_k w[k, n] z_k / W with R / W
    path of n = Kalman smoother on the synthetic detections

The density of detections and paths together never falls from one iteration to the next
where models are linear and lambda does not depend on the state; otherwise an iteration
is a Gauss-Newton step and it may.

What is known to be wrong with it: it starts from a guess and stays near it; it weighs
by R, however little is known of the state, so a detection off the path counts for
little even if nothing else is near; and its covariances take the association for known.
A `Spread` with some wider copies of R (homothetic measurements) helps the first two.

    >>> from jaxtrack.trackers import pmht_batch
    >>> pmht_batch.Params._fields
    ('target', 'clutter', 'start', 'spread')

References: Streit and Luginbuhl, "Probabilistic multi-hypothesis tracking", NUWC-NPT
Technical Report 10428, 1995; Willett, Ruan and Streit, "PMHT: problems and some
solutions", IEEE Trans. Aerospace and Electronic Systems 38(3), 2002.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import kalman, linalg, linearize
from jaxtrack.entries import dense
from jaxtrack.models.birth import MultiBernoulliBirth
from jaxtrack.models.sensor import Timed
from jaxtrack.targets import single
from jaxtrack.trackers import association, pmht_claims
from jaxtrack.trackers.pmht_claims import Claims, Spread
from jaxtrack.types import Affine, Array, Gaussian, Scan


class Params(NamedTuple):
    """Everything that may be learned.

    Attributes:
        target: Motion, sensor and detection; survival is not looked at.
        clutter: Of `models.clutter`.
        start: The N targets, one interval before the first scan. Where existence is
            less than sure, so many fewer detections are expected; 0 marks nobody.
        spread: Of the noise, None for R alone.
    """

    target: single.Params
    clutter: Any
    start: MultiBernoulliBirth
    spread: Spread | None = None


class Smoothed(NamedTuple):
    """What the scans tell of N targets.

    Attributes:
        belief: Given all scans; mean [N, T, D], cov [N, T, D, D].
        filtered: What the last pass knew on its way, [N, T, ...].
        prob: That each detection was caused by each target or, last, is clutter,
            [T, K, N + 1]; 0 where there is none.
        rate: Detections expected of each target in each scan, [N, T].
        log_objective: Log-density of scans and paths, before each of the iterations
            and after the last, [I + 1].
        log_density: Of each scan given those before, as the first guess has it, [T].
    """

    belief: Gaussian
    filtered: kalman.Filtered
    prob: Array
    rate: Array
    log_objective: Array
    log_density: Array


def smooth(
    params: Params,
    scans: Scan,
    num_iterations: int = 20,
    method: linearize.Method = linearize.taylor,
    learns_rates: bool = False,
) -> Smoothed:
    """Finds the paths of all targets by expectation-maximisation.

    The first guess is a pass forward, in which detections are shared out by how well
    each target predicts them. The number of iterations is fixed, so that all of it has
    gradients; `log_objective` tells whether they were enough.

    Args:
        params: Of the targets and clutter.
        scans: T scans of K slots; for none there is one that is empty.
        num_iterations: I.
        method: Of `linearize`; idle where models are linear.
        learns_rates: Expect of each target as many detections as it has got, on
            average, in place of its probability of detection.

    Raises:
        ValueError: A setting that makes no sense, or a sensor that cannot be used.
    """
    check(params, num_iterations)
    scans = jax.vmap(association.filled)(scans)
    first, log_density = _guess(method, params, scans)
    motions = _motions(method, params, first.filtered, scans)
    path = jax.vmap(kalman.smooth)(first, motions)
    rate = _rates(params, path.mean)

    def iterate(given: tuple, _: None) -> tuple[tuple, Array]:
        path, rate, _ = given
        claims, log_objective = _expect(params, path, rate, scans)
        path, filtered = _maximise(method, params, path, claims, scans)
        if learns_rates:
            number = claims.prob[:, :, :-1].sum(1).mean(0)
            rate = jnp.broadcast_to(number[:, None], rate.shape)
        else:
            rate = _rates(params, path.mean)
        return (path, rate, filtered), log_objective

    given, log_objective = jax.lax.scan(
        iterate, (path, rate, first), None, num_iterations
    )
    path, rate, filtered = given
    claims, last = _expect(params, path, rate, scans)
    log_objective = jnp.append(log_objective, last)
    return Smoothed(path, filtered, claims.prob, rate, log_objective, log_density)


def check(params: Params, num_iterations: int) -> None:
    """Raises a ValueError where settings or the sensor make no sense."""
    sensor = params.target.sensor
    if isinstance(sensor, Timed) or hasattr(sensor, "at"):
        raise ValueError(
            f"sensor is a {type(sensor).__name__}, which sees each detection its own "
            "way, so that they have no mean; give a sensor that does not"
        )
    if num_iterations < 0:
        raise ValueError(f"num_iterations is {num_iterations}; give 0 or more")


def _guess(
    method: linearize.Method, params: Params, scans: Scan
) -> tuple[kalman.Filtered, Array]:
    """Filters forward; returns beliefs [N, T, ...] and log-densities of scans [T]."""
    start, (motion, sensor, *_) = params.start, params.target

    def step(beliefs: Gaussian, scan: Scan) -> tuple[Gaussian, tuple]:
        def predict(belief: Gaussian) -> tuple[Gaussian, Affine]:
            move = linearize.motion_affine(motion, belief, scan.interval, method)
            predicted = kalman.predict(belief, move)
            seen = linearize.sensor_affine(sensor, motion, predicted, method)
            return predicted, _dense(seen)

        predicted, seen = jax.vmap(predict)(beliefs)
        claims = pmht_claims.share_out(
            sensor.residual,
            sensor.cov(),
            params.spread,
            params.clutter,
            expected=jax.vmap(_look, (None, 0))(params, predicted.mean),
            blur=jax.vmap(linalg.congruence)(seen.matrix, predicted.cov),
            rate=_rates(params, predicted.mean),
            scan=scan,
        )
        updated, log_density = jax.vmap(_update, (None, 0, 0, 0, 0))(
            params, predicted, seen, claims.surprise, claims.weight
        )
        filtered = kalman.Filtered(predicted, updated, log_density)
        return updated, (filtered, claims.log_density)

    beliefs = Gaussian(start.mean, start.cov)
    filtered, log_density = jax.lax.scan(step, beliefs, scans)[1]
    return jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), filtered), log_density


def _update(
    params: Params, belief: Gaussian, sensor: Affine, surprise: Array, weight: Array
) -> tuple[Gaussian, Array]:
    """Corrects a belief by its synthetic detection, if it has one."""
    expected = _look(params, belief.mean)
    given, detection, some = pmht_claims.synthetic(sensor, expected, surprise, weight)
    updated = kalman.update(belief, *kalman.blind(given, detection, some))
    missed = belief, jnp.zeros_like(updated[1])
    return jax.tree.map(lambda hit, miss: jnp.where(some, hit, miss), updated, missed)


def _expect(
    params: Params, path: Gaussian, rate: Array, scans: Scan
) -> tuple[Claims, Array]:
    """Shares out the detections given the paths' means; returns the objective, too."""
    sensor = params.target.sensor
    expected = jax.vmap(jax.vmap(_look, (None, 0)), (None, 0))(params, path.mean)
    blur = jnp.zeros((*expected.shape[::2], expected.shape[2]), rate.dtype)

    def share(expected: Array, rate: Array, scan: Scan) -> Claims:
        return pmht_claims.share_out(
            sensor.residual,
            sensor.cov(),
            params.spread,
            params.clutter,
            expected,
            blur,
            rate,
            scan,
        )

    claims = jax.vmap(share, (1, 1, 0))(expected, rate, scans)
    return claims, claims.log_density.sum() + _log_prior(params, path.mean, scans)


def _maximise(
    method: linearize.Method,
    params: Params,
    path: Gaussian,
    claims: Claims,
    scans: Scan,
) -> tuple[Gaussian, kalman.Filtered]:
    """Smooths each target's synthetic detections; returns [N, T, ...]."""
    motion, sensor, *_ = params.target

    def see(belief: Gaussian, surprise: Array, weight: Array) -> tuple:
        seen = linearize.sensor_affine(sensor, motion, belief, method)
        expected = _look(params, belief.mean)
        return pmht_claims.synthetic(_dense(seen), expected, surprise, weight)

    by_scan = jax.vmap(jax.vmap(see), (0, 1, 1))
    sensors, detections, some = by_scan(path, claims.surprise, claims.weight)
    motions = _motions(method, params, path, scans)
    start = Gaussian(params.start.mean, params.start.cov)
    filtered = jax.vmap(kalman.filter)(start, motions, sensors, detections, some)
    return jax.vmap(kalman.smooth)(filtered, motions), filtered


def _motions(
    method: linearize.Method, params: Params, path: Gaussian, scans: Scan
) -> Affine:
    """Returns affine models of all moves, about where they begin, [N, T, ...]."""

    def model(belief: Gaussian, interval: Array) -> Affine:
        motion = params.target.motion
        return _dense(linearize.motion_affine(motion, belief, interval, method))

    before = jax.tree.map(
        lambda x, y: jnp.concatenate([x[:, None], y[:, :-1]], 1),
        Gaussian(params.start.mean, params.start.cov),
        path,
    )
    return jax.vmap(jax.vmap(model), (0, None))(before, scans.interval)


def _log_prior(params: Params, mean: Array, scans: Scan) -> Array:
    """Returns the log-density of all paths, [N, T, D], before any scan."""
    motion = params.target.motion

    def density(before: Gaussian, after: Array, interval: Array, sure: Array) -> Array:
        model = linearize.motion_affine(motion, before, interval, linearize.taylor)
        moved = kalman.predict(before, model)
        # In no time nothing moves, with no density; the path has it right.
        unit = jnp.eye(after.size, dtype=after.dtype)
        lower = linalg.cholesky(jnp.where(sure, unit, moved.cov))
        return jnp.where(sure, 0.0, linalg.log_normal(after - moved.mean, lower))

    def one(start_mean: Array, start_cov: Array, mean: Array) -> Array:
        before = jnp.concatenate([start_mean[None], mean[:-1]])
        cov = jnp.zeros((len(mean), *start_cov.shape), mean.dtype).at[0].set(start_cov)
        sure = (scans.interval == 0) & (jnp.arange(len(mean)) > 0)
        each = jax.vmap(density)
        return each(Gaussian(before, cov), mean, scans.interval, sure).sum()

    return jax.vmap(one)(params.start.mean, params.start.cov, mean).sum()


def _look(params: Params, state: Array) -> Array:
    """Returns the detection expected of a state, [Z]."""
    layout = params.target.layout
    position = jnp.stack([state[i] for i in layout.position_index])
    velocity = jnp.stack([state[i] for i in layout.velocity_index])
    return params.target.sensor.measure(position, velocity)


def _rates(params: Params, mean: Array) -> Array:
    """Returns how many detections are expected, [N, ...], of states [N, ..., D]."""

    def rate(state: Array) -> Array:
        return jnp.asarray(params.target.detect.prob(0, state, 0.0), mean.dtype)

    states = mean.reshape(-1, mean.shape[-1])
    prob = jax.vmap(rate)(states).reshape(mean.shape[:-1])
    exists = jnp.asarray(params.start.existence_prob)
    return prob * exists.reshape(-1, *[1] * (prob.ndim - 1))


def _dense(model: Affine) -> Affine:
    cov = dense(model.cov)
    # A matrix of constants alone has the default precision, not the parameters'.
    return Affine(dense(model.matrix).astype(cov.dtype), model.offset, cov)
