# SPDX-License-Identifier: Apache-2.0
"""All panels of a run in one figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.view.force import draw_force_over_depth, draw_force_over_time
from needle_sim_ros.view.markers import draw_marker_tracks
from needle_sim_ros.view.section import draw_section
from needle_sim_ros.view.style import styled
from needle_sim_ros.view.timing import draw_tick_histogram

if TYPE_CHECKING:
    import numpy as np
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
        middle = [name for name, shown in (("section", section), ("markers", tracks)) if shown]
        bottom = ["depth"] + (["ticks"] if tick_times is not None else [])
        rows = [(1.0, ["time"])] + ([(1.45, middle)] if middle else []) + [(0.95, bottom)]
        figure.set_size_inches(11.0, 3.0 * sum(height for height, _ in rows))
        axes = _grid(figure, rows)
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


def _grid(figure: Figure, rows: list[tuple[float, list[str]]]) -> dict[str, Axes]:
    outer = figure.add_gridspec(len(rows), 1, height_ratios=[height for height, _ in rows])
    axes: dict[str, Axes] = {}
    for i, (_, names) in enumerate(rows):
        inner = outer[i].subgridspec(1, len(names))
        for j, name in enumerate(names):
            axes[name] = figure.add_subplot(inner[j])
    return axes
