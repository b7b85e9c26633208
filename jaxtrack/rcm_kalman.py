"""The Kalman filter for random coefficient matrices: linear, of minimum variance.

Which motion and which sensor act is drawn anew in every scan, independently of the
state: motion s with probability prob[s], and so for the sensor. Randomised data
association is of this kind: which detection came from which target decides the matrix.

    belief = begin(prior)
    belief = predict(belief, motion)
    belief, log_density = update(belief, sensor, detection)

The motion that acts differs from the mean one by a matrix times the state, which is one
more noise; its covariance needs the second moment E(x x') of the state, over the past
detections too, not given them. So the filter is linear in the detections, its
covariance does not depend on them, and among such filters none has a smaller error.
Where nothing is random it is the Kalman filter.

Offsets are not part of the theory; a constant is a state component that stays one.

Reference: Liu et al., "Randomized multiple model multiple hypothesis tracking", 2021,
Proposition 1 and eq. 12 to 26, after De Koning, "Optimal estimation of linear discrete-
time systems with stochastic parameters", Automatica 20, 1984.

    >>> import jax.numpy as jnp
    >>> from jaxtrack import rcm_kalman
    >>> from jaxtrack.types import Gaussian
    >>> belief = rcm_kalman.begin(Gaussian(jnp.array([3.0]), jnp.eye(1)))
    >>> stop_or_go = rcm_kalman.RandomAffine(
    ...     prob=jnp.array([0.5, 0.5]),
    ...     matrix=jnp.array([[[0.0]], [[2.0]]]),
    ...     cov=jnp.zeros((2, 1, 1)),
    ... )
    >>> belief = rcm_kalman.predict(belief, stop_or_go)
    >>> print(belief.mean, belief.cov)
    [3.] [[11.]]
"""

from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from jaxtrack import kalman, linalg
from jaxtrack.types import Affine, Array, Gaussian


class RandomAffine(NamedTuple):
    """The map x -> matrix[s] @ x + noise, noise ~ N(0, cov[s]), s drawn by prob.

    It has S realisations: prob [S] (summing to one), matrix [S, A, D], cov [S, A, A],
    where A is D for a motion and Z for a sensor.
    """

    prob: Array
    matrix: Array
    cov: Array


class Belief(NamedTuple):
    """The linear estimate: mean [D], its error's cov [D, D], second_moment [D, D].

    The second moment is that of the state itself, E(x x'), before any detection.
    """

    mean: Array
    cov: Array
    second_moment: Array


def begin(prior: Gaussian) -> Belief:
    """Starts from a Gaussian (eq. 26).

    Beginning again from a later belief's mean and cov forgets that they came from
    detections: what follows is then conditional on those, and no longer linear.

    Args:
        prior: mean [D], cov [D, D].

    Returns:
        The belief: mean [D], cov [D, D], second_moment [D, D].
    """
    mean, cov = prior
    return Belief(mean, cov, cov + jnp.outer(mean, mean))


def average(random: RandomAffine, second_moment: Array) -> Affine:
    """Replaces a random map by an affine one with the same first two moments.

    Its matrix is the mean matrix (eq. 14, 15); its noise adds to the mean noise what
    the random part of the matrix does to the state (eq. 23, 24).

    Args:
        random: prob [S], matrix [S, A, D], cov [S, A, A].
        second_moment: E(x x') of the state that is mapped, [D, D].

    Returns:
        matrix [A, D], offset [A] (zeros), cov [A, A].
    """
    prob, matrices, covs = random
    num, rows, dim = matrices.shape
    chex.assert_shape(prob, (num,))
    chex.assert_shape(covs, (num, rows, rows))
    chex.assert_shape(second_moment, (dim, dim))

    matrix = jnp.einsum("s,sij->ij", prob, matrices)
    spread = jax.vmap(linalg.congruence, (0, None))
    extra = spread(matrices - matrix[None], second_moment)
    cov = linalg.symmetrize(jnp.einsum("s,sij->ij", prob, covs + extra))
    return Affine(matrix, jnp.zeros_like(matrix[:, 0]), cov)


def predict(belief: Belief, motion: RandomAffine) -> Belief:
    """Moves a belief one step through a random motion (eq. 19, 20, 23, 25).

    Without detections so far, mean and covariance are exactly those of the mixture over
    the realisations. After some, the covariance is an average over what they could
    have been.

    Args:
        belief: mean [D], cov [D, D], second_moment [D, D].
        motion: prob [S], matrix [S, D, D], cov [S, D, D].

    Returns:
        The predicted belief, same shapes.
    """
    affine = average(motion, belief.second_moment)
    mean, cov = kalman.predict(Gaussian(belief.mean, belief.cov), affine)
    moved = linalg.congruence(affine.matrix, belief.second_moment) + affine.cov
    return Belief(mean, cov, moved)


def update(
    belief: Belief, sensor: RandomAffine, detection: Array
) -> tuple[Belief, Array]:
    """Corrects a belief with one detection of a random sensor (eq. 18, 21, 22, 24).

    The covariance is eq. 22 in Joseph form, equal for the gain of eq. 21. That gain is
    computed from a Cholesky factor: the pseudo-inverse of the paper differs only if a
    combination of the outputs has no noise at all, and has no gradient there; so the
    mean noise covariance must be positive definite.

    Args:
        belief: A predicted belief, mean [D], cov [D, D], second_moment [D, D].
        sensor: prob [S], matrix [S, Z, D], cov [S, Z, Z].
        detection: [Z].

    Returns:
        The corrected belief (its second moment is that of the state, and stays), and
        the log-density of the detection (a scalar): the Gaussian one with the right
        mean and covariance, an approximation, since the exact density is a mixture
        over all past realisations.
    """
    affine = average(sensor, belief.second_moment)
    prior = Gaussian(belief.mean, belief.cov)
    (mean, cov), log_density = kalman.update(prior, affine, detection)
    return Belief(mean, cov, belief.second_moment), log_density
