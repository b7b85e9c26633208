"""Affine stand-ins for nonlinear models: what makes a Kalman filter an EKF or a UKF.

Each method turns (function, belief) into an `Affine` map that agrees with the function
where the belief has its mass, so that `kalman.predict` and `kalman.update` serve all:

    taylor      first-order expansion at the mean                     (EKF)
    unscented   statistical linear regression on 2 D + 1 sigma points (UKF)
    cubature    the same on 2 D points of equal weight                (CKF)

A statistical linear regression keeps what the line leaves unexplained as extra noise,
which makes the Kalman update identical to the textbook UKF and CKF.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import linearize
    >>> from jaxtrack.types import Gaussian
    >>> belief = Gaussian(jnp.array([3.0]), jnp.eye(1))
    >>> print(linearize.taylor(lambda x: x**2, belief, jnp.eye(1)).matrix)
    [[6.]]
    >>> print(linearize.cubature(lambda x: x**2, belief, jnp.eye(1)).offset)
    [-8.]

References: Julier and Uhlmann, "Unscented filtering and nonlinear estimation", Proc.
IEEE 92(3), 2004; Arasaratnam and Haykin, "Cubature Kalman filters", IEEE Trans.
Automatic Control 54(6), 2009; Arasaratnam, Haykin and Elliott, "Discrete-time nonlinear
filtering algorithms using Gauss-Hermite quadrature", Proc. IEEE 95(5), 2007.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp

from jaxtrack import linalg
from jaxtrack.entries import Matrix, plus, scalars
from jaxtrack.types import Affine, Array, Gaussian

Function = Callable[[Array], Array]
Method = Callable[..., Affine]
Residual = Callable[[Array, Array], Array]


def taylor(
    function: Function, belief: Gaussian, cov: Array, residual: Residual = jnp.subtract
) -> Affine:
    """Expands a function to first order at the mean of a belief.

    Args:
        function: [D] -> [Z].
        belief: mean [D], cov [D, D].
        cov: Covariance of the additive noise, [Z, Z].
        residual: Unused; all methods share one signature.

    Returns:
        matrix [Z, D], offset [Z], cov [Z, Z].
    """
    del residual
    matrix, value = jax.jacfwd(lambda x: (function(x),) * 2, has_aux=True)(belief.mean)
    chex.assert_shape(cov, (value.size, value.size))
    return Affine(matrix, value - matrix @ belief.mean, cov)


def unscented(
    function: Function,
    belief: Gaussian,
    cov: Array,
    residual: Residual = jnp.subtract,
    spread: float = 3.0,
) -> Affine:
    """Regresses a function on the sigma points of the unscented transform.

    The centre has weight 1 - D / spread, the other 2 D points share the rest. The
    default, spread = 3, matches the fourth moment of a Gaussian along each axis. With
    more than 3 components the centre's weight is then negative, and where the function
    is far from a line the result may lose positive definiteness; `cubature` cannot.

    Args:
        function: [D] -> [Z].
        belief: mean [D], cov [D, D], positive definite.
        cov: Covariance of the additive noise, [Z, Z].
        residual: (value, centre) -> [Z]; wraps the differences of angles.
        spread: D + kappa of Julier and Uhlmann: squared distance of the points from
            the mean, in standard deviations.

    Returns:
        matrix [Z, D], offset [Z], cov [Z, Z] with the residual variance added.
    """
    centre_weight = 1 - belief.mean.size / spread
    return _regress(function, belief, cov, residual, spread, centre_weight)


def cubature(
    function: Function, belief: Gaussian, cov: Array, residual: Residual = jnp.subtract
) -> Affine:
    """Regresses a function on the 2 D points of the third-degree cubature rule.

    Arguments and results are those of `unscented`; the centre has no weight and the
    points lie at sqrt(D) standard deviations.
    """
    return _regress(function, belief, cov, residual, float(belief.mean.size), 0.0)


def _regress(
    function: Function,
    belief: Gaussian,
    cov: Array,
    residual: Residual,
    spread: float,
    centre_weight: float,
) -> Affine:
    dim = belief.mean.size
    lower = linalg.cholesky(belief.cov)
    steps = jnp.sqrt(jnp.asarray(spread, lower.dtype)) * lower.T  # a row per axis
    weight = (1 - centre_weight) / (2 * dim)

    # All values are taken relative to the centre's, so that angles wrap only once.
    centre = function(belief.mean)
    from_centre = jax.vmap(lambda x: residual(function(x), centre))
    ahead, behind = (from_centre(belief.mean[None] + s * steps) for s in (1, -1))
    mean = weight * (ahead + behind).sum(0)

    slope = weight * jnp.sqrt(jnp.asarray(spread, lower.dtype)) * (ahead - behind)
    matrix = linalg.solve_upper(lower, slope).T
    off = jnp.concatenate([ahead, behind]) - mean[None]
    total = weight * off.T @ off + centre_weight * jnp.outer(mean, mean)
    unexplained = linalg.symmetrize(total - matrix @ belief.cov @ matrix.T)
    return Affine(matrix, centre + mean - matrix @ belief.mean, cov + unexplained)


def motion_affine(
    motion: Any, belief: Gaussian, interval: Array, method: Method
) -> Affine:
    """Makes the affine model of one move; a linear motion is taken as it is.

    Args:
        motion: Any model of `jaxtrack.models.motion` or `jaxtrack.models.turn`.
        belief: Where to linearise; mean [D], cov [D, D].
        interval: Seconds.
        method: `taylor`, `unscented` or `cubature`.

    Returns:
        matrix [D, D], offset [D], cov [D, D].
    """
    noise = motion.noise(interval)
    if motion.linear:
        return Affine(motion.transition(interval), jnp.zeros_like(belief.mean), noise)
    if method is taylor and hasattr(motion, "expand"):
        moved, matrix = motion.expand(belief.mean, interval)
        matrix = linalg.settle(matrix)
        return Affine(matrix, moved - matrix @ belief.mean, noise)
    return method(lambda state: motion.move(state, interval), belief, noise)


def sensor_affine(sensor: Any, motion: Any, belief: Gaussian, method: Method) -> Affine:
    """Makes the affine model of one detection; a linear sensor is taken exactly.

    Args:
        sensor: Any model of `jaxtrack.models.sensor`, without ages (see `untimed`).
        motion: The motion model, which knows where position and velocity stand.
        belief: Where to linearise; mean [D], cov [D, D].
        method: `taylor`, `unscented` or `cubature`.

    Returns:
        matrix [Z, D], offset [Z], cov [Z, Z].
    """
    if sensor.linear:
        pick = functools.partial(_pick, belief.mean.size)
        matrix = sensor.measure(
            pick(motion.position_index), pick(motion.velocity_index)
        )
        offset = jnp.zeros_like(belief.mean, shape=matrix.shape[:1])
        return Affine(matrix, offset, sensor.cov())

    if method is taylor:
        return _expand_sensor(sensor, motion, belief)

    def measure(state: Array) -> Array:
        position = jnp.stack([state[i] for i in motion.position_index])
        velocity = jnp.stack([state[i] for i in motion.velocity_index])
        return sensor.measure(position, velocity)

    return method(measure, belief, sensor.cov(), sensor.residual)


def _expand_sensor(sensor: Any, motion: Any, belief: Gaussian) -> Affine:
    """Expands as `taylor` does, but only in what the sensor looks at."""
    where = motion.position_index, motion.velocity_index
    parts = [jnp.stack([belief.mean[i] for i in index]) for index in where]
    expected, used = linalg.once(sensor.measure(*parts)), _used(sensor.measure, *parts)
    columns: list[Any] = [[0] * expected.size] * belief.mean.size
    for index, part, looked_at in zip(where, range(2), used, strict=True):
        for axis, component in enumerate(index if looked_at else ()):
            step = [jnp.zeros_like(x) for x in parts]
            step[part] = step[part].at[axis].set(1.0)
            slope = jax.jvp(sensor.measure, tuple(parts), tuple(step))[1]
            both = zip(columns[component], scalars(slope), strict=True)
            columns[component] = [plus(x, y) for x, y in both]
    matrix = linalg.settle(Matrix(columns).T)
    return Affine(matrix, expected - matrix @ belief.mean, sensor.cov())


def _used(function: Function, *arguments: Array) -> list[bool]:
    """Says which arguments a function looks at."""
    jaxpr = jax.make_jaxpr(function)(*arguments).jaxpr
    seen = {id(x) for step in jaxpr.eqns for x in step.invars}
    seen |= {id(x) for x in jaxpr.outvars}
    return [id(x) in seen for x in jaxpr.invars]


def _pick(size: int, index: Sequence[int]) -> Matrix:
    """Returns the matrix that picks components from a state, [P, D]."""
    return Matrix([int(i == j) for j in range(size)] for i in index)
