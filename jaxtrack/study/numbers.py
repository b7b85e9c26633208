"""A picture of how many targets each tracker believes in, and how sure it is.

>>> import numpy as np, xarray
>>> from jaxtrack.study import numbers
>>> dims = "setting", "tracker", "run", "time"
>>> scores = {name: (dims, np.ones((1, 2, 3, 4)))
...           for name in ("num_true", "num_expected", "num_std")}
>>> coords = {"setting": ["-"], "tracker": ["phd", "cphd"], "time": np.arange(4.0)}
>>> study = xarray.Dataset(scores, coords)
>>> len(numbers.numbers_chart(study).axes)
2

Reference: Yuan, Lian and Han, "Multiple-model cardinality balanced multitarget multi-
Bernoulli filter for tracking maneuvering targets", 2013, Figures 2 and 4.
"""

import math
from typing import TYPE_CHECKING

import matplotlib
from matplotlib.figure import Figure

from jaxtrack.plot import COLORS, INK, STYLE

if TYPE_CHECKING:
    import xarray


def numbers_chart(dataset: "xarray.Dataset", setting: int = 0) -> Figure:
    """Draws the mean over runs of the expected number, a panel for each tracker.

    About it a band of one standard deviation of the number, as the tracker itself sees
    it, also the mean over runs; and the true number.

    Args:
        dataset: Of `engine.monte_carlo`.
        setting: Which of the settings.
    """
    one = dataset.isel(setting=setting)
    one = one.dropna("time", how="all", subset=["num_true"])
    names, time = one["tracker"].values, one["time"].values
    columns = min(len(names), 3)
    rows = math.ceil(len(names) / columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4 * columns, 2.6 * rows + 0.5), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes in grid.flat[len(names) :]:
            axes.remove()
        for axes, name in zip(grid.flat, names, strict=False):
            told = one.sel(tracker=name).mean("run")
            mean, std = told["num_expected"].values, told["num_std"].values
            true = told["num_true"].values
            axes.step(time, true, where="mid", color=INK, lw=1.2, label="true number")
            axes.plot(time, mean, color=COLORS[0], lw=1.6, label="expected")
            band = {"color": COLORS[0], "alpha": 0.22, "lw": 0}
            label = "one standard deviation"
            axes.fill_between(time, mean - std, mean + std, label=label, **band)
            axes.set(title=str(name), ylim=(0, None))
            axes.margins(x=0.01)
        for axes in grid.flat[max(len(names) - columns, 0) : len(names)]:
            axes.set_xlabel("time (s)")
            axes.tick_params(labelbottom=True)
        for axes in grid[:, 0]:
            axes.set_ylabel("targets")
        handles, _ = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure
