"""Particles that are drawn once it is known what was detected.

After a motion a particle is where the motion led, its noise not yet drawn: a belief is
a mixture of Gaussians N(x; m_l, G G^T), with G the factor `root` of its mode's noise. A
detection is linearised about each m_l in the noise's own coordinates e, x = m_l + G e,
so that noise of any rank will do:

    score       sum_l w_l p_D N(z; h(m_l), A A^T + R),   A = dh / de
    correct     e ~ N(M^-1 A^T R^-1 (z - h), M^-1),   M = 1 + A^T R^-1 A

and the weights are right whatever the linearisation: those of a draw from another
density than the posterior. With a linear sensor that correction is one: it is the
optimal proposal (Doucet, Godsill and Andrieu 2000). A newborn's prior waits likewise,
so that births are drawn where the detection is. Where a particle was missed its noise
waits until the next motion, or until it is known what a blend makes of it. The
probability of detection is taken at m_l when a miss and a score are weighed.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import linearize
    >>> from jaxtrack.targets import cloud_proposals
    >>> line = cloud_proposals.line(
    ...     linearize.taylor, lambda x: x[:1], jnp.subtract, 3.0 * jnp.eye(1),
    ...     jnp.zeros(2), jnp.eye(2))
    >>> print(line.lower)  # of 1 + 3
    [[2.]]

Reference: Doucet, Godsill and Andrieu, "On sequential Monte Carlo sampling methods for
Bayesian filtering", Statistics and Computing 10, 2000, section II-D; van der Merwe,
Doucet, de Freitas and Wan, "The unscented particle filter", NIPS 2000.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import linalg, mixture, particle
from jaxtrack.entries import dense
from jaxtrack.linalg import safe_log
from jaxtrack.linearize import Method
from jaxtrack.models.sensor import untimed
from jaxtrack.targets import blending, cloud_motion, cloud_views, clouds
from jaxtrack.targets.clouds import Belief
from jaxtrack.types import Array, Gaussian, Mixture


class Line(NamedTuple):
    """What a sensor reports as a line in the noise e ~ N(0, 1) of one particle.

    Attributes:
        expected: [Z].
        lower: Cholesky factor of the covariance of what is reported, [Z, Z].
        gain: From what is a surprise to the mean of e, [D, Z].
        spread: Factor of the covariance of e, given a detection, [D, D].
        log_volume: Log-determinant of that factor.
    """

    expected: Array
    lower: Array
    gain: Array
    spread: Array
    log_volume: Array


class View(NamedTuple):
    """A belief as the sensor sees it.

    Attributes:
        belief: L particles.
        log_detect: Log-probability to detect each, [L].
        lines: [L, ...]; None where each detection has its own.
    """

    belief: Belief
    log_detect: Array
    lines: Line | None


def line(
    method: Method,
    function: Callable[[Array], Array],
    residual: Callable[[Array, Array], Array],
    cov: Array,
    centre: Array,
    root: Array,
) -> Line:
    """Linearises what a sensor reports about one particle.

    Args:
        method: Of `linearize`.
        function: State [D] -> [Z].
        residual: (detection, expected) -> [Z].
        cov: R, [Z, Z].
        centre: m, [D].
        root: G, [D, D].
    """
    dim = centre.size
    identity = jnp.eye(dim, dtype=centre.dtype)
    unit = Gaussian(jnp.zeros_like(centre), identity)
    affine = method(lambda e: function(centre + root @ e), unit, cov, residual)
    noise = linalg.cholesky(dense(affine.cov))
    white = linalg.solve_lower(noise, affine.matrix)  # [Z, D]
    inner = linalg.cholesky(identity + white.T @ white)
    spread = linalg.solve_upper(inner, identity)
    gain = linalg.solve(inner, linalg.solve_upper(noise, white).T)
    return Line(
        expected=affine.offset,
        lower=linalg.cholesky(affine.matrix @ affine.matrix.T + affine.cov),
        gain=gain,
        spread=spread,
        log_volume=-jnp.log(jnp.diagonal(inner)).sum(),
    )


def look(method: Method, params: Any, belief: Belief) -> View:
    """Looks at all particles through a target's sensor."""
    log_detect = safe_log(clouds.prob(params.detect, belief))
    if not cloud_views.shares(params.sensor):
        return View(belief, log_detect, None)
    lines = _linearised(method, params.sensor, params, belief)
    return View(belief, log_detect, lines)


def score(method: Method, params: Any, view: View, detections: Array) -> Array:
    """Returns the log-densities of detections [K, Z], times that of detection, [K]."""

    def one(detection: Array) -> Array:
        log_factor = _log_factor(method, params, view, detection)
        return mixture.total(view.belief.log_weight + log_factor)

    return jax.vmap(one)(detections)


def distance(
    method: Method, params: Any, view: View, detections: Array
) -> tuple[Array, Array]:
    """Measures how far detections are from what is expected; see `cloud_views`."""
    weight = mixture.normalise(view.belief.log_weight + view.log_detect)

    def one(detection: Array) -> tuple[Array, Array]:
        sensor, plain = untimed(params.sensor, detection)
        lines = _lines(method, sensor, params, view)
        heaviest = lines.expected[jnp.argmax(weight)]
        gap = jax.vmap(sensor.residual, (0, None))(lines.expected, heaviest)
        covs = lines.lower @ jnp.swapaxes(lines.lower, 1, 2)
        pooled = mixture.moment_match(weight, gap, covs)
        lower = linalg.cholesky(pooled.cov)
        surprise = sensor.residual(plain, heaviest + pooled.mean)
        white = linalg.solve_lower(lower, surprise)
        return (white * white).sum(), 2 * jnp.log(jnp.diagonal(lower)).sum()

    return jax.vmap(one)(detections)


def correct(method: Method, params: Any, view: View, detection: Array) -> Belief:
    """Draws each particle from its proposal, and weighs it."""
    following, keys = clouds.split(clouds.fold(view.belief.key, detection), 1)
    lines = _lines(method, untimed(params.sensor, detection)[0], params, view)
    every = jnp.broadcast_to(detection, (len(view.log_detect), *detection.shape))
    noise = _noise(keys[0], view.belief)
    state, log_factor = _draw(params, view.belief, lines, every, noise)
    drawn = _settled(view.belief, state)._replace(key=following)
    return clouds.reweighted(drawn, log_factor)[0]


def blend(
    method: Method,
    params: Any,
    view: View,
    missed: Belief,
    log_weight: Array,
    detections: Array,
) -> Belief:
    """Draws for each particle which detection was its own, or none, and then itself.

    The choice is the largest of log-weights with Gumbel noise of each detection's own.
    """
    following, keys = clouds.split(clouds.fold(view.belief.key, clouds.BLENDED), 2)
    likelihood = functools.partial(_log_factor, method, params, view)
    log_factor = jax.vmap(likelihood)(detections)  # [K, L]
    each, _ = jax.vmap(particle.reweight, (None, 0))(view.belief.log_weight, log_factor)
    each = jnp.concatenate([each, missed.log_weight[None]])
    each = blending.shares(log_weight)[:, None] + each
    choice, own = clouds.choose(keys[0], detections, each, view.belief.key)
    none, last = choice == len(detections), len(detections) - 1

    noise = _noise(keys[1], missed)
    lines = _own_lines(method, params, view, own)
    state, log_exact = _draw(params, missed, lines, own, noise)
    log_rough = jnp.take_along_axis(log_factor, jnp.minimum(choice, last)[None], 0)[0]
    sure = none | (log_rough == -jnp.inf)
    log_right = jnp.where(sure, 0.0, log_exact - jnp.where(sure, 0.0, log_rough))
    state = jnp.where(none[:, None], _pushed(missed, noise), state)
    drawn = _settled(missed, state)._replace(
        log_weight=mixture.total(each), key=following
    )
    return clouds.reweighted(drawn, log_right)[0]


def moments(belief: Belief) -> Gaussian:
    """Returns mean [D] and covariance [D, D], with the noise not drawn yet."""
    drawn = particle.moments(belief.particles)
    prob = particle.mode_prob(belief.particles, len(belief.root))
    waiting = belief.root @ jnp.swapaxes(belief.root, 1, 2)
    return drawn._replace(cov=drawn.cov + (prob[:, None, None] * waiting).sum(0))


def parts(belief: Belief) -> Mixture:
    """Returns the particles with the covariance of the noise that is not drawn yet."""
    waiting = belief.root @ jnp.swapaxes(belief.root, 1, 2)
    return Mixture(belief.log_weight, belief.state, waiting[belief.mode])


def settle(key: Array, belief: Belief) -> Belief:
    """Draws the noise that has waited."""
    return _settled(belief, _pushed(belief, _noise(key, belief)))


def _settled(belief: Belief, state: Array) -> Belief:
    return belief._replace(state=state, root=jnp.zeros_like(belief.root))


def _pushed(belief: Belief, noise: Array) -> Array:
    return belief.state + cloud_motion.push(list(belief.root), belief.mode, noise)


def _noise(key: Array, belief: Belief) -> Array:
    return particle.normals(key, belief.state)


def _lines(method: Method, sensor: Any, params: Any, view: View) -> Line:
    """Returns the lines of all particles, worked out before or now."""
    if view.lines is not None:
        return view.lines
    return _linearised(method, sensor, params, view.belief)


def _own_lines(method: Method, params: Any, view: View, own: Array) -> Line:
    """Returns the lines of particles that each have a detection of their own."""
    if view.lines is not None:
        return view.lines

    def one(detection: Array, state: Array, mode: Array) -> Line:
        sensor, _ = untimed(params.sensor, detection)
        alone = view.belief._replace(state=state[None], mode=mode[None])
        lines = _linearised(method, sensor, params, alone)
        return jax.tree.map(lambda x: x[0], lines)

    return jax.vmap(one)(own, view.belief.state, view.belief.mode)


def _linearised(method: Method, sensor: Any, params: Any, belief: Belief) -> Line:
    measure = functools.partial(cloud_views.measure, sensor, params.layout)
    cov = dense(sensor.cov())
    one = functools.partial(line, method, measure, sensor.residual, cov)
    return jax.vmap(one)(belief.state, belief.root[belief.mode])


def _log_factor(method: Method, params: Any, view: View, detection: Array) -> Array:
    """Returns what a detection [Z] multiplies the weights by, in logarithms, [L]."""
    sensor, plain = untimed(params.sensor, detection)
    lines = _lines(method, sensor, params, view)

    def one(expected: Array, lower: Array) -> Array:
        return linalg.log_normal(sensor.residual(plain, expected), lower)

    return view.log_detect + jax.vmap(one)(lines.expected, lines.lower)


def _draw(
    params: Any, belief: Belief, lines: Line, own: Array, noise: Array
) -> tuple[Array, Array]:
    """Draws each particle given its own detection.

    Returns:
        The states [L, D], and the logs of what the weights are multiplied by, [L].
    """

    def shift(own_line: Line, detection: Array, white: Array) -> tuple[Array, Array]:
        sensor, plain = untimed(params.sensor, detection)
        surprise = sensor.residual(plain, own_line.expected)
        drawn = own_line.gain @ surprise + own_line.spread @ white
        gain = ((white * white).sum() - (drawn * drawn).sum()) / 2
        return drawn, gain + own_line.log_volume

    drawn, log_ratio = jax.vmap(shift)(lines, own, noise)
    state = _pushed(belief, drawn)
    moved = belief._replace(state=state)
    log_detect = safe_log(clouds.prob(params.detect, moved))
    log_density = jax.vmap(functools.partial(cloud_views.log_density_of, params))
    return state, log_ratio + log_detect + log_density(state, own)
