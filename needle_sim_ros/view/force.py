# SPDX-License-Identifier: Apache-2.0
"""The axial force at the needle base, over time and over depth (the paper's Fig. 3)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.view.bands import draw_bands, process_lines
from needle_sim_ros.view.style import BLACK, BLUE, MM, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needle_sim_ros.session.series import Series

FORCE_LABEL = "axial force (N)"
_LATE = 0.05  # of the last time: what begins after that is drawn from where it begins


def axial_force(series: Series) -> NDArray[np.float64]:
    """Return the force with which the base pushes the needle in, N; shape (n,).

    Minus the z component of the base force, so that pushing in is positive as in the
    paper, and the sum of friction and tip force.
    """
    force: NDArray[np.float64] = -series.base_force[:, 2]
    return force


def draw_force_over_time(ax: Axes, series: Series, instant: float | None = None) -> None:
    """Draw the base force, and its friction and tip parts if they are known.

    Parameters
    ----------
    ax : Axes
        To draw into.
    series : Series
        What to draw.
    instant : float, optional
        Time of the section that is drawn elsewhere, s; marked on the curve.
    """
    first, last = series.time[0], series.time[-1]
    ax.set_xlim(first if first > _LATE * last else 0.0, last)
    ax.axhline(0.0, color="0.4", linewidth=0.7)
    ax.plot(series.time, axial_force(series), color=BLACK, label="base (total)")
    if series.friction_force is not None:
        ax.plot(
            series.time, series.friction_force, color=BLUE, linestyle=(0, (5, 2)), label="friction"
        )
    if series.tip_force is not None:
        ax.plot(series.time, series.tip_force, color=VERMILION, linestyle=(0, (1, 1)), label="tip")
    if instant is not None:
        force = np.interp(instant, series.time, axial_force(series))
        ax.plot(
            [instant],
            [force],
            "D",
            color=BLACK,
            markerfacecolor="white",
            markersize=5,
            linestyle="none",
            label="section below",
        )
    ax.set_xlabel("time (s)")
    ax.set_ylabel(FORCE_LABEL)
    draw_bands(ax, series.time, series.process)
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)


def draw_force_over_depth(ax: Axes, series: Series) -> None:
    """Draw the base force over the insertion depth, a line per process."""
    ax.axhline(0.0, color="0.4", linewidth=0.7)
    force, depth = axial_force(series), MM * series.insertion_depth
    named = False
    for rows, style, label in process_lines(series.process):
        ax.plot(depth[rows], force[rows], color=style.line, linestyle=style.dashes, label=label)
        named = True
    ax.set_xlabel("insertion depth (mm)")
    ax.set_ylabel(FORCE_LABEL)
    if named:
        ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
