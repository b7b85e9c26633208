"""Every tracker is learned from two recordings at once, as from each alone.

Of many runs side by side JAX turns choices into selections, whose slopes it does not
know in every place: so the slopes of a fit are held against those of single runs.
"""

import jax
import numpy as np
import pytest
from cases.runs import runner
from cases.trackers import CASES, SCANS, case_of, random_scans, tracker_of

from jaxtrack.learn import leaves, loss, slopes

# It compiles quickly.
FEW = {"cbmember_single"}


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=[] if x in FEW else pytest.mark.slow) for x in CASES]
)
def test_slopes_of_two_recordings_are_those_of_each(name):
    params = case_of(name).params
    scans = [random_scans(name, seed) for seed in (0, 1)]
    plan = leaves.plan(params, lambda p: (p.target.sensor, p.clutter))
    problem = slopes.Problem(
        tracker_of(name), plan, loss.evidence, None, None, None, 16, 1
    )
    data = slopes.gather(jax.tree.map(lambda *x: np.stack(x), *scans), None, 0)
    # Trackers that draw do so with the key of the single runs.
    data = data._replace(keys=jax.numpy.stack([jax.random.key(0)] * 2))
    told = slopes.slope(
        problem, params, data, leaves.unconstrain(plan, params), jax.random.key(0)
    )
    alone = [runner(name)(params, one) for one in scans]
    evidence = np.mean([value for (value, _), _ in alone])
    np.testing.assert_allclose(told.loss, -evidence / SCANS, rtol=1e-9)
    slope = np.mean([x.target.sensor.noise_std for _, x in alone], axis=0)
    expected = -slope * np.array(params.target.sensor.noise_std) / SCANS
    found = told.gradient["target.sensor.noise_std"]
    # Slopes of a loss of some 10 are of order 1.
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    rate = np.mean([x.clutter.rate for _, x in alone])
    expected = -rate * np.array(params.clutter.rate) / SCANS
    np.testing.assert_allclose(
        told.gradient["clutter.rate"][0], expected, rtol=1e-6, atol=1e-9
    )
