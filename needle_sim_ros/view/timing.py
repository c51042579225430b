# SPDX-License-Identifier: Apache-2.0
"""How long the ticks took."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import FuncFormatter

from needle_sim_ros.view.style import BLACK, BLUE, MS, SKY, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

_BINS = 60


def draw_tick_histogram(
    ax: Axes, tick_times: NDArray[np.float64], time_step: float | None = None
) -> None:
    """Draw a histogram of tick times (s) with median and 99th percentile.

    Parameters
    ----------
    ax : Axes
        To draw into.
    tick_times : (n,) array
        Wall-clock time of each tick, s; more than zero.
    time_step : float, optional
        Simulated time of a tick, s: what real time allows.
    """
    times = MS * tick_times
    edges = np.geomspace(times.min() * 0.95, times.max() * 1.05, _BINS)
    ax.hist(times, edges.tolist(), histtype="stepfilled", color=SKY, edgecolor=BLACK, linewidth=0.6)
    marks = [
        (float(np.median(times)), "median", BLUE, "-"),
        (float(np.percentile(times, 99)), "p99", VERMILION, (0, (5, 2))),
    ]
    if time_step is not None:
        marks.append((MS * time_step, "real time", BLACK, (0, (1, 1))))
    for value, name, colour, dashes in marks:
        ax.axvline(value, color=colour, linestyle=dashes, label=f"{name} {value:.3g} ms")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(bottom=0.7)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_xlabel("tick time (ms)")
    ax.set_ylabel("ticks")
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
