# SPDX-License-Identifier: Apache-2.0
"""A recording and its simulation over each other, and what is left between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.view.force import FORCE_LABEL, axial_force
from needle_sim_ros.view.style import BLACK, MM, ORANGE, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needle_sim_ros.session.series import Series

    Curve = NDArray[np.float64]


def overlay_figure(recorded: Series, simulated: Series, title: str, notes: str = "") -> Figure:
    """Draw force, deflection and the greatest marker displacement of both over time.

    Parameters
    ----------
    recorded, simulated : Series
        With the same clock.
    title, notes : str
        Above and below everything.

    Raises
    ------
    NeedleSimError
        When there is no tick in one of them.
    """
    if not len(recorded) or not len(simulated):
        raise NeedleSimError("nothing to plot: no tick was recorded")
    both = (recorded, simulated)
    curves = [
        (FORCE_LABEL, [axial_force(series) for series in both]),
        ("tip deflection (mm)", [_length(series.tip_deflection) for series in both]),
    ]
    if all(len(series.marker_reference) for series in both):
        moved = [_length(series.marker_displacements).max(axis=1) for series in both]
        curves.append(("greatest marker\ndisplacement (mm)", moved))
    with styled():
        figure = Figure(figsize=(11.0, 2.6 * len(curves)), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(len(curves), 1, sharex=True, squeeze=False)[:, 0]
        for ax, (label, (a, b)) in zip(axes, curves, strict=True):
            _draw(ax, both, a, b)
            ax.set_ylabel(label)
        axes[0].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
        axes[-1].set_xlabel("time (s)")
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        if notes:
            figure.supxlabel(notes, x=0.01, ha="left", fontsize=8.5, color="0.25")
    return figure


def _length(vectors: Curve) -> Curve:
    length: Curve = MM * np.linalg.norm(vectors, axis=-1)
    return length


def _draw(ax: Axes, both: tuple[Series, Series], a: Curve, b: Curve) -> None:
    recorded, simulated = both
    ax.axhline(0.0, color="0.4", linewidth=0.7)
    # The recording is wide and light, so that it shows under a curve that covers it.
    ax.plot(recorded.time, a, color=ORANGE, linewidth=4.0, alpha=0.6, label="recorded")
    ax.plot(simulated.time, b, color=BLACK, linewidth=1.2, label="simulated")
    _, left, right = np.intersect1d(recorded.time, simulated.time, return_indices=True)
    ax.plot(
        recorded.time[left],
        b[right] - a[left],
        color="0.35",
        linestyle=(0, (1, 1)),
        label="simulated - recorded",
    )
