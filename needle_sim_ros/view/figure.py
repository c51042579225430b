# SPDX-License-Identifier: Apache-2.0
"""All panels of a run in one figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.view.force import draw_force_over_depth, draw_force_over_time
from needle_sim_ros.view.markers import draw_marker_tracks, track_extent
from needle_sim_ros.view.section import draw_section
from needle_sim_ros.view.style import styled
from needle_sim_ros.view.timing import draw_tick_histogram

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needle_sim_ros.session.series import Series
    from needle_sim_ros.view.section import Section

_FORCE_NOTE = "Axial force: what the base pushes with, positive into the tissue."
_SECTION_NOTE = (
    "Section at true scale; its white lines were straight and 10 mm apart in the undeformed tissue."
)


def session_figure(
    series: Series,
    title: str,
    *,
    section: Section | None = None,
    tick_times: NDArray[np.float64] | None = None,
    time_step: float | None = None,
    notes: str = "",
) -> Figure:
    """Draw what is known of a run: one figure, a panel per view.

    Parameters
    ----------
    series : Series
        At least one tick.
    title : str
        Above everything.
    section : Section, optional
        Drawn if given.
    tick_times : (n,) array, optional
        Wall-clock time of each tick, s; a histogram if given.
    time_step : float, optional
        Simulated time of a tick, s, marked in the histogram.
    notes : str
        Below everything, after what the panels need to be understood.

    Raises
    ------
    NeedleSimError
        When the series is empty.
    """
    if not len(series):
        raise NeedleSimError("nothing to plot: the run has no ticks")
    tracks = len(series.marker_reference) > 0
    with styled():
        figure = Figure(layout="constrained")
        FigureCanvasAgg(figure)
        shown = {
            "section": section is not None,
            "markers": tracks,
            "depth": True,
            "ticks": tick_times is not None,
        }
        panels = [name for name, is_shown in shown.items() if is_shown]
        rows = [["time"], *(panels[i : i + 2] for i in range(0, len(panels), 2))]
        heights = [_height(row) for row in rows]
        figure.set_size_inches(11.0, 3.0 * sum(heights))
        axes = _grid(figure, rows, heights, _marker_width(series) if tracks else 1.0)
        draw_force_over_time(axes["time"], series, section.time if section else None)
        axes["depth"].set_title("Force over depth")
        draw_force_over_depth(axes["depth"], series)
        if section is not None:
            draw_section(axes["section"], section)
        if tracks:
            draw_marker_tracks(axes["markers"], series)
        if tick_times is not None:
            axes["ticks"].set_title("Tick times")
            draw_tick_histogram(axes["ticks"], tick_times, time_step)
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        text = [_FORCE_NOTE, _SECTION_NOTE] if section is not None else [_FORCE_NOTE]
        below = "\n".join([" ".join(text), *([notes] if notes else [])])
        figure.supxlabel(below, x=0.01, ha="left", fontsize=8.5, color="0.25")
    return figure


def _height(row: list[str]) -> float:
    """Return the height of a row of panels beside the others: maps need more than curves."""
    return 1.45 if {"section", "markers"} & set(row) else 1.0


def _marker_width(series: Series) -> float:
    """Return the width of the marker panel beside the section's, by the markers' extent."""
    width, height = track_extent(series)
    return float(np.clip(0.3 + 0.7 * width / height, 0.6, 1.0))


def _grid(
    figure: Figure, rows: list[list[str]], heights: list[float], marker_width: float
) -> dict[str, Axes]:
    outer = figure.add_gridspec(len(rows), 1, height_ratios=heights)
    axes: dict[str, Axes] = {}
    for i, names in enumerate(rows):
        widths = [1.0] * len(names)
        if names == ["section", "markers"]:
            widths[1] = marker_width
        inner = outer[i].subgridspec(1, len(names), width_ratios=widths)
        for j, name in enumerate(names):
            axes[name] = figure.add_subplot(inner[j])
    return axes
