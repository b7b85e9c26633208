"""Settings become numbers to be learned and settings again."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.data import files
from jaxtrack.recorded import fitted, guess, reading, tracking

SMALL = "[scans]\nperiod = 8\n[tracker]\nname = 'nearest'\nmax_tracks = 4\n"
MODES = """[modes.'at "anchor"']
rest = true
detect_prob = 0.7
birth_share = 0.2
[modes.moving]
noise_density = 0.3
birth_share = 0.6
[modes.drifting]
rest = true
drift_std = 0.5
"""


def case(text=SMALL + MODES):
    """A ship that moves and one that does not, among settings none of them open."""
    time = np.arange(24.0) * 4
    xy = np.where(np.arange(24)[:, None] % 2, 5 * time[:, None], -300.0)
    xy = xy + np.random.default_rng(0).standard_normal(xy.shape)
    table = files.Table(time, xy, {}, None, None)
    chosen = reading.parse(text)
    scans = tracking.group(table, chosen)
    return table, guess.complete(chosen, scans), jax.tree.map(jnp.asarray, scans.scan)


def test_numbers_stand_where_the_settings_had_them():
    chosen = case()[1]
    told = fitted.numbers(chosen)
    modes = list(chosen.modes.values())
    np.testing.assert_array_equal(told.detect_prob, [0.7, 0.98, 0.98])
    np.testing.assert_array_equal(told.drift_std, [modes[0].drift_std, 0.5])
    np.testing.assert_allclose(told.birth_share, np.array([0.2, 0.6, 1.0]) / 1.8)
    other = jax.tree.map(lambda x: x / (2 + np.arange(x.size).reshape(x.shape)), told)
    again = fitted.settings(chosen, other)
    chex.assert_trees_all_close(
        fitted.numbers(again)._replace(birth_share=other.birth_share), other, rtol=1e-15
    )
    assert again.modes["drifting"].drift_std == 0.5 / 3
    assert again.modes["moving"].drift_std == modes[1].drift_std
    assert again.tracker == chosen.tracker
    assert isinstance(again.sensor.noise_std, float)


def test_open_settings_are_no_numbers():
    with pytest.raises(ValueError, match="fill it in with guess.complete"):
        fitted.numbers(reading.parse(SMALL))


@pytest.mark.parametrize("text", ["", SMALL + MODES, reading.text("harbour")])
def test_the_file_that_is_written_tells_the_same_settings(text):
    chosen = reading.parse(text)
    assert reading.parse(fitted.toml(chosen)) == chosen


def test_the_tracker_of_numbers_is_that_of_the_settings():
    table, chosen, scans = case()
    tracker = fitted.tracker(table, chosen)
    plain, params = tracking.make(table, chosen)
    told = tracking.run(tracker, fitted.numbers(chosen), scans, jax.random.key(0))
    expected = tracking.run(plain, params, scans, jax.random.key(0))
    chex.assert_trees_all_close(told, expected, rtol=1e-12)
