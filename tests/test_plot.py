"""Tests of `jaxtrack.plot`: what is drawn where, on numbers made by hand."""

import types

import matplotlib.patches
import numpy as np
import pytest
import xarray
from matplotlib.backends.backend_agg import FigureCanvasAgg

from jaxtrack import plot
from jaxtrack.models.motion import ConstantVelocity
from jaxtrack.models.sensor import RangeBearing

MOTION = ConstantVelocity(np.ones(2))
T = 6


def make_truth(scale=1.0):
    """One target at (t, 10 t) throughout, one that is there in scans 2 to 4."""
    t = np.arange(T) * 1.0
    first = np.stack([t, 0 * t, 10 * t, 0 * t], 1)
    second = np.stack([20 + t, 0 * t, 5 + 0 * t, 0 * t], 1)
    exists = np.stack([np.ones(T, bool), (t >= 2) & (t <= 4)], 1)
    state = scale * np.stack([first, second], 1)
    return types.SimpleNamespace(state=state, exists=exists, time=t)


def make_scans():
    detections = np.arange(T * 3 * 2.0).reshape(T, 3, 2)
    valid = np.zeros((T, 3), bool)
    valid[1, 2] = valid[4, 0] = True
    return types.SimpleNamespace(detections=detections, valid=valid)


def make_estimates():
    """Label 7 in slot 0, then, after a gap at scan 3, in slot 1; label 2 at scan 5."""
    mean = np.random.default_rng(0).normal(size=(T, 2, 4))
    exists = np.array([[1, 0], [1, 0], [1, 0], [0, 0], [0, 1], [1, 1]], bool)
    label = np.array([[7, 2], [7, 2], [7, 2], [7, 2], [2, 7], [2, 7]])
    cov = np.zeros((T, 2, 4, 4))
    cov[..., [1, 3], [1, 3]] = 77.0
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    place = turn @ np.diag([9.0, 4.0]) @ turn.T  # 3 m along 0.5 rad, 2 m across
    cov[..., np.ix_([0, 2], [0, 2])[0], np.ix_([0, 2], [0, 2])[1]] = place
    return types.SimpleNamespace(mean=mean, cov=cov, label=label, exists=exists)


def lines(axes, style):
    found = [line for line in axes.lines if line.get_linestyle() == style]
    return [line.get_xydata() for line in found if len(line.get_xydata()) > 1]


def texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_truth_is_solid_from_ring_to_cross():
    axes = plot.tracks(make_truth(), make_scans(), None, MOTION).axes[0]
    first, second = lines(axes, "-")
    np.testing.assert_array_equal(first[:, 1], 10 * np.arange(T))
    np.testing.assert_array_equal(second, [[22, 5], [23, 5], [24, 5]])
    rings = [x.get_xydata()[0].tolist() for x in axes.lines if x.get_marker() == "o"]
    crosses = [x.get_xydata()[0].tolist() for x in axes.lines if x.get_marker() == "x"]
    assert rings == [[0, 0], [22, 5]]
    assert crosses == [[5, 50], [24, 5]]


def test_tracks_are_dashed_in_the_order_of_labels_and_broken_at_gaps():
    estimates = make_estimates()
    axes = plot.tracks(make_truth(), make_scans(), estimates, MOTION).axes[0]
    late, early = lines(axes, "--")
    slots = np.array([0, 0, 0, 0, 1, 1])
    expected = estimates.mean[np.arange(T), slots][:, [0, 2]]
    expected[3] = np.nan
    np.testing.assert_array_equal(early, expected)
    assert np.isnan(late[:5]).all()
    np.testing.assert_array_equal(late[5], estimates.mean[5, 0, [0, 2]])
    colors = {line.get_color() for line in axes.lines if line.get_linestyle() == "--"}
    assert colors == set(plot.COLORS[:2])


def test_ellipses_hold_2_sigma_and_keep_their_distance():
    estimates = make_estimates()
    figure = plot.tracks(None, make_scans(), estimates, MOTION, every=3)
    found = [
        x for x in figure.axes[0].patches if isinstance(x, matplotlib.patches.Ellipse)
    ]
    centres = [x.get_center() for x in found]
    wanted = [(5, 0), (0, 0), (4, 1)]  # label 2 once; label 7 at its scans 0 and 3
    expected = [estimates.mean[t, slot, [0, 2]] for t, slot in wanted]
    np.testing.assert_array_equal(centres, expected)
    for ellipse in found:
        half = np.array([ellipse.get_width(), ellipse.get_height()]) / 2
        np.testing.assert_allclose(half, [4, 6], rtol=1e-12)  # eigenvalues ascend
        across = np.degrees(0.5) + 90
        assert (ellipse.get_angle() - across) % 180 == pytest.approx(0, abs=1e-9)


def test_only_valid_detections_are_drawn_and_a_sensor_places_them():
    scans = make_scans()
    axes = plot.tracks(make_truth(), scans, None, MOTION).axes[0]
    dots = axes.lines[0].get_xydata()
    np.testing.assert_array_equal(
        dots, [scans.detections[1, 2], scans.detections[4, 0]]
    )
    sensor = RangeBearing(np.ones(2), np.array([100.0, 0.0]), np.array(0.0))
    scans.detections[1, 2] = [5.0, np.pi / 2]
    axes = plot.tracks(make_truth(), scans, None, MOTION, sensor).axes[0]
    np.testing.assert_allclose(axes.lines[0].get_xydata()[0], [100, 5], atol=1e-9)


def test_map_has_units_equal_axes_and_a_legend_outside():
    figure = plot.tracks(make_truth(), make_scans(), make_estimates(), MOTION)
    axes = figure.axes[0]
    assert axes.get_xlabel() == "x (m)"
    assert axes.get_ylabel() == "y (m)"
    assert axes.get_aspect() == 1
    FigureCanvasAgg(figure).draw()
    below = figure.legends[0].get_window_extent()
    assert below.y1 <= axes.get_window_extent().y0
    assert below.x0 >= 0
    assert below.x1 <= figure.bbox.x1
    assert texts(figure)[1:3] == ["truth", "born"]
    bare = plot.tracks(None, make_scans(), None, MOTION)
    assert texts(bare) == ["detections"]


def test_wide_map_is_in_kilometres():
    figure = plot.tracks(make_truth(1e3), make_scans(), None, MOTION)
    axes = figure.axes[0]
    assert axes.get_xlabel() == "x (km)"
    np.testing.assert_allclose(lines(axes, "-")[1][0], [22, 5])


def test_map_of_nothing_is_empty():
    scans = make_scans()
    scans.valid[:] = False
    estimates = make_estimates()
    estimates.exists[:] = False
    figure = plot.tracks(None, scans, estimates, MOTION)
    FigureCanvasAgg(figure).draw()


@pytest.fixture(scope="module")
def dataset():
    rng = np.random.default_rng(1)
    dims = ("setting", "tracker", "run", "time")
    shape = (2, 3, 8, T)
    columns = {"ospa": (dims, rng.gamma(2.0, 10.0, shape), {"units": "m"})}
    columns["num_reported"] = (dims, rng.integers(0, 5, shape))
    true = np.broadcast_to(np.array([1, 1, 2, 3, 3, 2]), shape)
    columns["num_true"] = (dims, true)
    columns["seconds"] = (dims[:2], np.ones(shape[:2]))
    coords = {
        "setting": ["a=1", "a=2"],
        "tracker": list("xyz"),
        "time": 3 * np.arange(T),
    }
    return xarray.Dataset(columns, coords, {"scenario": "small"})


@pytest.mark.parametrize("band", ["error", "quantiles"])
def test_curves_are_means_over_runs_with_a_band(dataset, band):
    figure = plot.over_time(dataset, "ospa", band)
    assert [axes.get_title("left") for axes in figure.axes] == ["a=1", "a=2"]
    runs = dataset.ospa.values[1, 2]
    axes = figure.axes[1]
    curve = axes.lines[2]
    np.testing.assert_array_equal(curve.get_xdata(), 3 * np.arange(T))
    np.testing.assert_allclose(curve.get_ydata(), runs.mean(0))
    error = runs.std(0, ddof=1) / np.sqrt(8)
    low, high = runs.mean(0) - 2 * error, runs.mean(0) + 2 * error
    if band == "quantiles":
        low, high = np.quantile(runs, [0.1, 0.9], axis=0)
    outline = axes.collections[2].get_paths()[0].vertices
    at = outline[outline[:, 0] == 6][:, 1]
    np.testing.assert_allclose([at.min(), at.max()], [low[2], high[2]])
    assert figure.axes[0].get_ylabel() == "ospa (m)"
    assert axes.get_xlabel() == "time (s)"
    assert texts(figure) == ["x", "y", "z", plot.BANDS[band]]


def test_numbers_of_targets_come_with_the_true_number(dataset):
    figure = plot.over_time(dataset, "num_reported")
    true = figure.axes[0].lines[0]
    np.testing.assert_array_equal(true.get_ydata(), [1, 1, 2, 3, 3, 2])
    assert texts(figure)[0] == "true number"
    FigureCanvasAgg(figure).draw()
    lowest = min(axes.get_window_extent().y0 for axes in figure.axes)
    assert figure.legends[0].get_window_extent().y1 <= lowest


def test_single_run_has_no_band(dataset):
    figure = plot.over_time(dataset.isel(run=[0], setting=[0]))
    outline = figure.axes[0].collections[0].get_paths()[0].vertices
    at = outline[outline[:, 0] == 6][:, 1]
    assert at.min() == at.max()


def test_what_cannot_be_drawn_is_named(dataset):
    with pytest.raises(
        ValueError, match="'opsa' is no score; give one of ospa, num_rep"
    ):
        plot.over_time(dataset, "opsa")
    with pytest.raises(ValueError, match="'seconds' is no score"):
        plot.over_time(dataset, "seconds")
    with pytest.raises(ValueError, match="band is 'std'; give one of error, quantiles"):
        plot.over_time(dataset, band="std")
