"""Pictures of trackers that were told their targets: errors, and whose detections.

>>> import numpy as np
>>> from jaxtrack.metrics.errors import Errors
>>> from jaxtrack.study import chart
>>> from jaxtrack.study.follow import Followed
>>> one = Errors(*np.ones((2, 9, 5, 2)), np.ones((9, 5, 2), bool))
>>> share = np.tile(np.eye(2, 3), (9, 5, 1, 1))
>>> followed = {"jpda": Followed(one, share, np.ones((9, 5, 2), int))}
>>> len(chart.errors_chart(followed, np.arange(5.0)).axes)
4
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from jaxtrack.metrics import errors
from jaxtrack.plot import COLORS, DASHES, STYLE
from jaxtrack.study.follow import Followed

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def errors_chart(followed: Mapping[str, Followed], time: np.ndarray) -> Figure:
    """Draws RMS errors of position and velocity, a column for each target.

    Args:
        followed: By the tracker's name.
        time: Seconds, [T].
    """
    num = next(iter(followed.values())).errors.tracked.shape[2]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.2 * num, 5.6), layout="constrained")
        axes = figure.subplots(2, num, squeeze=False, sharex=True, sharey="row")
        for target in range(num):
            for row, field in enumerate(("position", "velocity")):
                for which, (name, one) in enumerate(followed.items()):
                    values = getattr(one.errors, field)
                    error = np.asarray(errors.rms(values, one.errors.tracked))
                    _line(axes[row, target], which, time, error[:, target], name)
            axes[0, target].set_title(f"target {target + 1}")
            axes[1, target].set_xlabel("time (s)")
        axes[0, 0].set_ylabel("RMS position error (m)")
        axes[1, 0].set_ylabel("RMS velocity error (m/s)")
        for axis in axes.flat:
            axis.set_ylim(bottom=0)
        axes[0, 0].legend()
        return figure


def association_chart(followed: Mapping[str, Followed], time: np.ndarray) -> Figure:
    """Draws mean association probabilities, a column for each target.

    Where everything is detected, detection n is target n's: the probabilities of the
    first N detections are drawn, the target's own in full and the others fainter.

    Args:
        followed: By the tracker's name.
        time: Seconds, [T].
    """
    num = next(iter(followed.values())).errors.tracked.shape[2]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.2 * num, 3.4), layout="constrained")
        axes = figure.subplots(1, num, squeeze=False, sharey=True)[0]
        for target in range(num):
            for which, (name, one) in enumerate(followed.items()):
                share = np.asarray(one.association_prob).mean(0)[:, target]
                _line(axes[target], which, time, share[:, target], name)
                for other in set(range(num)) - {target}:
                    _line(axes[target], which, time, share[:, other], None)
            axes[target].set_title(f"target {target + 1}")
            axes[target].set_xlabel("time (s)")
            axes[target].set_ylim(-0.02, 1.02)
        axes[0].set_ylabel("mean probability of a detection\n(faint: of the other's)")
        axes[-1].legend(loc="center right")
        return figure


def _line(
    axis: "Axes", which: int, time: np.ndarray, values: np.ndarray, name: str | None
) -> None:
    dash = "-" if which < len(COLORS) else DASHES[which % len(DASHES)]
    color, alpha = COLORS[which % len(COLORS)], 1.0 if name else 0.35
    axis.plot(time, values, color=color, linestyle=dash, alpha=alpha, label=name)
