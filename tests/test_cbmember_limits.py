"""What the CBMeMBer update bears, and its balance by claims, against enumeration."""

import functools
import math

import jax
import numpy as np
import pytest
from reference import bruteforce

from jaxtrack.targets import single
from jaxtrack.trackers import cbmember, limits, multi_bernoulli

SLOTS, RUNS, EXISTS = 8, 100, 0.95


@functools.cache
def program(balance):
    """Expected number and log-evidence of many scenes."""
    weigh = {
        "paper": multi_bernoulli.balanced,
        "claims": multi_bernoulli.claimed,
    }[balance]

    def one(prob, log_miss, log_score, log_clutter, valid, rate):
        seen = multi_bernoulli.Seen(None, None, prob, log_miss, log_score, log_clutter)
        update = weigh(seen, valid, rate)
        return update.legacy_prob.sum() + update.updated_prob.sum(), update

    return jax.jit(jax.vmap(one))


def scene(rng, num, detect, false):
    """Scores of up to two targets, and what enumeration says of them."""
    clutter = false / (2 * limits.SIGMAS)  # innovations have variance 1
    mean = np.array([-1.0, 1.0]) * rng.uniform(0, 2)
    prob = np.where(np.arange(2) < num, EXISTS, 0.0)
    hits = mean[rng.random(2) < prob * detect]
    z = np.append(
        hits + rng.normal(size=hits.size), rng.uniform(-8, 8, rng.poisson(16 * clutter))
    )
    z = z[np.argsort(np.abs(z[:, None] - mean[None, :num]).min(1))][: SLOTS - 2]
    g = np.exp(-((z[None] - mean[:, None]) ** 2) / 2) / math.sqrt(2 * math.pi)
    given = np.full(2, detect), g, np.full(z.size, clutter), 16 * clutter
    evidence, causes = bruteforce.multi_bernoulli(prob, *given)
    score = np.zeros((2, SLOTS))
    score[:, : z.size] = np.log(detect * g)
    valid = np.arange(SLOTS) < z.size
    log_clutter = np.full(SLOTS, np.log(clutter))
    row = prob, np.log(1 - given[0]), score, log_clutter, valid, given[3]
    return row, np.log(evidence), causes


def scenes(num, detect, false, seed=0):
    rng = np.random.default_rng(seed)
    rows, evidence, causes = zip(
        *(scene(rng, num, detect, false) for _ in range(RUNS)), strict=True
    )
    return [np.stack(x) for x in zip(*rows, strict=True)], np.array(evidence), causes


@pytest.mark.parametrize("num", [1, 2])
@pytest.mark.parametrize("detect", [0.5, 0.95])
def test_claims_are_exact(num, detect):
    """Number, evidence, and whose each detection is, to what claims leave out."""
    rows, evidence, causes = scenes(num, detect, 1.0)
    found, update = program("claims")(*rows)
    np.testing.assert_allclose(found, [x.sum() for x in causes], rtol=1e-6)
    np.testing.assert_allclose(update.log_evidence, evidence, rtol=1e-6)
    for legacy, updated, exact in zip(
        update.legacy_prob, update.updated_prob, causes, strict=True
    ):
        # Claims less likely than 1e-9 are left out (`multi_bernoulli.NEGLIGIBLE`), so
        # probabilities may be off by as much, whatever their size.
        left_out = multi_bernoulli.NEGLIGIBLE
        np.testing.assert_allclose(legacy, exact[:, 0], rtol=1e-9, atol=left_out)
        seen, shares = updated[: exact.shape[1] - 1], exact[:, 1:].sum(0)
        np.testing.assert_allclose(seen, shares, rtol=1e-9, atol=left_out)


# (P_D, false detections in a gate): bias of the paper's update, a third more or less.
TABLE = {(0.95, 0.1): 0.04, (0.95, 1.0): 0.36, (0.8, 1.0): 0.11, (0.99, 3.0): 1.68}


@pytest.mark.parametrize("setting", TABLE)
def test_overcount_is_that_of_the_table(setting):
    rows, _, causes = scenes(1, *setting)
    found, _ = program("paper")(*rows)
    bias = (np.asarray(found) - [x.sum() for x in causes]).mean()
    assert 0.5 < bias / TABLE[setting] < 1.5


def test_expected_false_detections_are_density_times_volume():
    found = limits.false_in_gate(2.0, np.diag([4.0, 9.0]))
    np.testing.assert_allclose(found, 2.0 * math.pi * 9 * 6, rtol=1e-12)
    line = limits.false_in_gate(0.5, np.array([[4.0]]))
    np.testing.assert_allclose(line, 0.5 * 12, rtol=1e-12)


def test_warning_names_what_is_outside():
    assert limits.warning("x", 0.95, 0.1) is None
    assert "P_D" in (limits.warning("x", 0.7, 0.1) or "")
    assert "false detections" in (limits.warning("x", 0.95, 2.0) or "")


def test_balance_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="balance is 'none'"):
        cbmember.cbmember(single.single(), balance="none")
