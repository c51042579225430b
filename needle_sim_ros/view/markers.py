# SPDX-License-Identifier: Apache-2.0
"""Where the markers went, beside where they started (the paper's Figs. 16 to 18)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from needle_sim_ros.view.bands import process_lines
from needle_sim_ros.view.style import BLACK, MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needle_sim_ros.session.series import Series

    Array = NDArray[np.float64]

_LABEL_SHARE = 0.032  # of the axes: half the size of a number with its distance
_LONGEST = 2.0  # times the spacing of the markers: how long a track may be drawn
_MARGIN = 1.2  # by which a track's box is larger than the track
_FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)

_ENOUGH = 0.65  # of that: from a number's middle to the nearest curve
# Where a number may stand beside its marker, the best first; x > 0 is away from the needle.
_SIDES = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1], [1.3, 0], [-1.3, 0], [0, 1.3], [0, -1.3]])


def exaggeration(reference: Array, displacements: Array) -> int:
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
    fitting = [
        factor
        for factor in _FACTORS
        if factor * longest <= _LONGEST * spacing
        and not _overlap(reference, factor * displacements)
    ]
    return max(fitting, default=1)


def _overlap(reference: Array, displacements: Array) -> bool:
    """Say whether the boxes around any two tracks, starts included, overlap in x and z."""
    low = (reference + _MARGIN * np.minimum(displacements.min(axis=0), 0.0))[:, [0, 2]]
    high = (reference + _MARGIN * np.maximum(displacements.max(axis=0), 0.0))[:, [0, 2]]
    shared = (low[:, None] <= high[None, :]) & (low[None, :] <= high[:, None])
    pairs = shared.all(axis=2)
    np.fill_diagonal(pairs, False)
    return bool(pairs.any())


def draw_marker_tracks(ax: Axes, series: Series) -> None:
    """Draw every marker's start and its track in the x z plane, a line per process."""
    reference, moved = series.marker_reference, series.marker_displacements
    factor = exaggeration(reference, moved)
    drawn = MM * (reference + factor * moved)[:, :, [0, 2]]
    start = MM * reference[:, [0, 2]]
    path = MM * series.tip_position[series.insertion_depth > 0][:, [0, 2]]
    ax.plot(*path.T, color="0.6", linewidth=0.8, linestyle=(0, (6, 3)), label="tip path")
    for rows, style, label in process_lines(series.process):
        curves = drawn[rows]
        look: dict[str, Any] = {"color": style.line, "linestyle": style.dashes, "linewidth": 1.2}
        lines = ax.plot(curves[..., 0], curves[..., 1], **look)
        lines[0].set_label(label or "_")
    ax.plot(
        *start.T, "o", color=BLACK, markersize=4, markerfacecolor="white", label="start", zorder=3
    )
    _frame(ax, start, drawn)
    surface = np.zeros((100, 2))
    surface[:, 0] = np.linspace(*ax.get_xlim(), 100)
    _number(ax, start, np.concatenate([path, surface, start, drawn.reshape(-1, 2)]))
    ax.set_aspect("equal")
    ax.set_anchor("W")
    ax.set_xlabel("x (mm)")
    ax.set_ylabel("z (mm)")
    ax.set_title("Marker tracks" + (f", drawn {factor} times longer" if factor > 1 else ""))
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)


def _number(ax: Axes, start: Array, curves: Array) -> None:
    """Write each marker's number beside its start, clear of the points of ``curves``."""
    spans = np.array([np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())])
    label = _LABEL_SHARE * float(spans.max())  # mm; the axes have equal scales
    for number, place in enumerate(start, start=1):
        outward = 1.0 if place[0] >= 0 else -1.0
        centres = place + label * _SIDES * [outward, 1.0]
        clear = np.abs(curves[None] - centres[:, None]).max(axis=2).min(axis=1)
        x, z = centres[int(np.argmax(np.minimum(clear, _ENOUGH * label)))]
        ax.text(x, z, str(number), fontsize=8, ha="center", va="center")


def track_extent(series: Series) -> tuple[float, float]:
    """Return width and height that the markers span in the x z plane, m."""
    reference = series.marker_reference[:, [0, 2]]
    width, height = np.maximum(np.ptp(reference, axis=0), 0.01)
    return float(width), float(height)


def _frame(ax: Axes, start: Array, drawn: Array) -> None:
    low = np.minimum(start.min(axis=0), drawn.min(axis=(0, 1)))
    high = np.maximum(start.max(axis=0), drawn.max(axis=(0, 1)))
    margin = 0.08 * max(float((high - low).max()), 20.0)
    ax.set_xlim(low[0] - margin, high[0] + margin)
    ax.set_ylim(low[1] - margin, high[1] + margin)
    if high[1] + margin > 0:
        ax.axhline(0.0, color="0.4", linewidth=0.7)
