# SPDX-License-Identifier: Apache-2.0
"""Where the markers went, beside where they started (the paper's Figs. 16 to 18)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.view.bands import bands
from needle_sim_ros.view.style import BLACK, MM, PROCESSES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needle_sim_ros.session.series import Series

_FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_REACH = 0.5  # of the spacing of the markers: how far the longest track is drawn


def exaggeration(reference: NDArray[np.float64], displacements: NDArray[np.float64]) -> int:
    """Return the factor to draw tracks with: the largest that keeps neighbours apart.

    Parameters
    ----------
    reference : (m, 3) array
        Markers in the undeformed tissue, m.
    displacements : (n, m, 3) array
        m.
    """
    longest = float(np.linalg.norm(displacements, axis=2).max(initial=0.0))
    if longest == 0.0:
        return 1
    apart = np.linalg.norm(reference[:, None] - reference[None, :], axis=2)
    apart = apart[apart > 0]
    spacing = float(apart.min()) if apart.size else float(np.abs(reference).max())
    return max((f for f in _FACTORS if f * longest <= _REACH * spacing), default=1)


def draw_marker_tracks(ax: Axes, series: Series) -> None:
    """Draw every marker's start and its track in the x z plane, a line per process."""
    reference, moved = series.marker_reference, series.marker_displacements
    factor = exaggeration(reference, moved)
    drawn = MM * (reference + factor * moved)[:, :, [0, 2]]
    start = MM * reference[:, [0, 2]]
    path = MM * series.tip_position[series.insertion_depth > 0][:, [0, 2]]
    ax.plot(*path.T, color="0.6", linewidth=0.8, linestyle=(0, (6, 3)), label="tip path")
    named: set[str] = set()
    for band in bands(series.process):
        if band.process == "free":
            continue
        rows = slice(max(band.first - 1, 0), band.last + 1)
        style = PROCESSES[band.process]
        for marker in range(len(reference)):
            label = None if band.process in named else band.process
            named.add(band.process)
            x, z = drawn[rows, marker].T
            ax.plot(x, z, color=style.line, linestyle=style.dashes, linewidth=1.2, label=label)
    ax.plot(
        *start.T, "o", color=BLACK, markersize=4, markerfacecolor="white", label="start", zorder=3
    )
    _number(ax, start, drawn)
    _frame(ax, start, drawn)
    ax.set_aspect("equal")
    ax.set_xlabel("x (mm)")
    ax.set_ylabel("z (mm)")
    ax.set_title("Marker tracks" + (f", displacements {factor} times larger" if factor > 1 else ""))
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=6, borderaxespad=0.0)


def _number(ax: Axes, start: NDArray[np.float64], drawn: NDArray[np.float64]) -> None:
    """Write each marker's number on the side that its track leaves free."""
    away = start - (drawn.min(axis=0) + drawn.max(axis=0)) / 2
    for number, ((x, z), (dx, dz)) in enumerate(zip(start, away, strict=True), start=1):
        right, up = dx >= 0, dz >= 0
        ax.annotate(
            str(number),
            (x, z),
            xytext=(4 if right else -4, 3 if up else -3),
            textcoords="offset points",
            fontsize=8,
            ha="left" if right else "right",
            va="bottom" if up else "top",
        )


def _frame(ax: Axes, start: NDArray[np.float64], drawn: NDArray[np.float64]) -> None:
    low = np.minimum(start.min(axis=0), drawn.min(axis=(0, 1)))
    high = np.maximum(start.max(axis=0), drawn.max(axis=(0, 1)))
    margin = 0.08 * max(float((high - low).max()), 20.0)
    ax.set_xlim(low[0] - margin, high[0] + margin)
    ax.set_ylim(low[1] - margin, high[1] + margin)
    if high[1] + margin > 0:
        ax.axhline(0.0, color="0.4", linewidth=0.7)
