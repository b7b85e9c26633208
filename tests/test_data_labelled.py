"""Estimates and scans in labelled arrays: exact round trips, names, messages."""

import sys
import types

import numpy as np
import pytest
import xarray

from jaxtrack.data import labelled
from jaxtrack.data.errors import DataError
from jaxtrack.trackers.bernoulli import Estimate
from jaxtrack.types import Scan

START = "2020-06-30T23:59:58.500"
TIME = np.array([0.5, 0.7, 3.0])
STATES = {"x": "m", "vx": "m/s", "y": "m", "vy": "m/s"}


def some_estimates(*lead):
    """Estimates of 5 slots and 2 modes, in numbers that all differ."""
    rng = np.random.default_rng(9)

    def draw(*shape):
        return rng.normal(size=(*lead, *shape))

    return Estimate(
        mean=draw(5, 4).astype(np.float32),
        cov=draw(5, 4, 4),
        label=rng.integers(0, 99, (*lead, 5)),
        exists=draw(5) > 0.0,
        existence_prob=draw(5),
        mode_prob=draw(5, 2),
        effective_size=draw(5),
        num_mean=draw(),
        num_var=draw(),
        log_evidence=np.where(draw() > 1.0, -np.inf, draw()),
        dropped=draw(),
    )


def some_scans(*lead):
    rng = np.random.default_rng(10)
    valid = rng.uniform(size=(*lead, 4)) < 0.6
    valid[..., 1, :] = False  # an empty scan
    detections = np.where(valid[..., None], rng.normal(size=(*lead, 4, 2)), 0.0)
    return Scan(detections, valid, rng.uniform(size=lead))


def assert_same(got, expected):
    assert type(got) is type(expected)
    for name, one in expected._asdict().items():
        np.testing.assert_array_equal(getattr(got, name), one, err_msg=name)
        assert getattr(got, name).dtype == one.dtype


@pytest.mark.parametrize("start", [None, START])
@pytest.mark.parametrize("lead", [(3,), (2, 3)])
def test_estimates_and_scans_come_back(lead, start):
    data = labelled.estimates_to_dataset(some_estimates(*lead), TIME, STATES, start)
    reordered = data.transpose(*reversed(list(data.dims)))
    for one in (data, reordered):
        estimates, time, began = labelled.estimates_from_dataset(one)
        assert_same(estimates, some_estimates(*lead))
        np.testing.assert_array_equal(time, TIME)
        assert began == start
    units = {"range": "m", "bearing": "rad"}
    data = labelled.scans_to_dataset(some_scans(*lead), TIME, units, start)
    scans, time, began = labelled.scans_from_dataset(data)
    assert_same(scans, some_scans(*lead))
    np.testing.assert_array_equal(time, TIME)
    assert began == start


@pytest.mark.parametrize("start", [None, START])
def test_datasets_come_back_from_a_file(tmp_path, start):
    data = labelled.estimates_to_dataset(some_estimates(2, 3), TIME, STATES, start)
    data.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as file:
        estimates, time, began = labelled.estimates_from_dataset(file)
    assert_same(estimates, some_estimates(2, 3))
    np.testing.assert_array_equal(time, TIME)
    assert began == start


def test_names_and_units_find_what_they_say():
    estimates = some_estimates(2, 3)
    data = labelled.estimates_to_dataset(estimates, TIME, STATES)
    speed = data["mean"].sel(run=1, time=0.7, state="vy")
    np.testing.assert_array_equal(speed, estimates.mean[1, 1, :, 3])
    assert str(speed.unit.to_numpy()) == "m/s"
    assert data["time"].attrs["units"] == "s"
    np.testing.assert_array_equal(
        data["cov"][1, 2, 3, 0, 2], estimates.cov[1, 2, 3, 0, 2]
    )
    named = labelled.estimates_to_dataset(estimates, TIME, STATES, START)
    moment = named["mean"].sel(time="2020-06-30T23:59:59.200")
    np.testing.assert_array_equal(moment, estimates.mean[:, 1])


def test_states_are_named_by_the_model():
    turning = types.SimpleNamespace(position_index=(0, 2), velocity_index=(1, 3))
    names = {"x": "m", "vx": "m/s", "y": "m", "vy": "m/s", "state4": ""}
    made = labelled.states_of(turning, 5)
    assert list(made.items()) == list(names.items())


def test_what_a_tracker_lacks_is_none():
    few = types.SimpleNamespace(mean=np.zeros((3, 1, 4)), exists=np.ones((3, 1), bool))
    data = labelled.estimates_to_dataset(few, TIME, STATES)
    estimates, _, _ = labelled.estimates_from_dataset(data)
    assert estimates.cov is None
    np.testing.assert_array_equal(estimates.exists, few.exists)


def test_wrong_arrays_and_datasets_get_one_sentence():
    estimates = some_estimates(3)
    with pytest.raises(ValueError, match=r"mean has shape \(3, 5, 4\) and time \(2,\)"):
        labelled.estimates_to_dataset(estimates, TIME[:2], STATES)
    with pytest.raises(
        ValueError, match="state is named x, but there are 4 components"
    ):
        labelled.estimates_to_dataset(estimates, TIME, {"x": "m"})
    data = labelled.estimates_to_dataset(estimates, TIME, STATES)
    with pytest.raises(DataError, match="has no variable 'detections'; it has .*mean"):
        labelled.scans_from_dataset(data)
    with pytest.raises(DataError, match="'mean' has the dimensions .*slot.* rename"):
        labelled.estimates_from_dataset(data.rename(track="slot"))


def test_xarray_is_asked_for_by_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(DataError, match=r'need xarray: pip install "jaxtrack\[io\]"'):
        labelled.scans_to_dataset(some_scans(3), TIME, {"x": "m", "y": "m"})
