# SPDX-License-Identifier: Apache-2.0
"""A session as a film: the deformed section beside the force so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from PIL import Image

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.view.force import axial_force, draw_force_over_depth, draw_force_over_time
from needle_sim_ros.view.section import draw_section
from needle_sim_ros.view.style import BLACK, COLOUR_MAP, LINE_COLOURS, MM, styled

if TYPE_CHECKING:
    from needle_sim_ros.session.series import Series
    from needle_sim_ros.view.section import Section

_RATE = 12  # frames a second
_DPI = 90
_FROM_MAP = 96  # colours of a GIF's 256
_SIZE = (10.0, 6.8)  # inches; in pixels both are even, as H.264 wants


def film_writer(path: Path) -> AbstractMovieWriter:
    """Return what writes a film of this name.

    Raises
    ------
    NeedleSimError
        When the suffix stands for no format, or the format's program is not installed.
    """
    suffix = path.suffix.lower()
    if suffix == ".gif":
        return _GifWriter(fps=_RATE)
    if suffix != ".mp4":
        raise NeedleSimError(f"{path}: a film's name must end in .gif or .mp4")
    if not FFMpegWriter.isAvailable():
        raise NeedleSimError(f"{path}: an MP4 needs the program ffmpeg; a .gif needs nothing")
    return FFMpegWriter(fps=_RATE, codec="libx264", extra_args=["-pix_fmt", "yuv420p"])


class _GifWriter(PillowWriter):
    """Pillow's, with one palette for all frames: the colour map's and the lines' colours."""

    def finish(self) -> None:
        frames: list[Image.Image] = getattr(self, "_frames", [])
        scale = colormaps[COLOUR_MAP](np.linspace(0, 1, _FROM_MAP))
        exact = np.concatenate([scale, to_rgba_array(["white", *LINE_COLOURS])])[:, :3]
        rest = 256 - len(exact)
        frame = frames[len(frames) // 2].convert("RGB").quantize(rest)
        colours = [*(255 * exact).round().astype(int).ravel().tolist(), *(frame.getpalette() or [])]
        palette = Image.new("P", (1, 1))
        palette.putpalette((colours + 256 * [255, 255, 255])[: 3 * 256])
        self._frames = [
            still.convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE)
            for still in frames
        ]
        super().finish()


def make_film(
    series: Series,
    sections: Sequence[Section],
    title: str,
    path: Path,
    advance: Callable[[], object] = lambda: None,
) -> None:
    """Draw a frame per section and write them.

    Parameters
    ----------
    series : Series
        The whole run.
    sections : sequence of Section
        In the order of time.
    title : str
        Above everything.
    path : Path
        GIF or MP4, by the suffix; an existing file is replaced.
    advance : callable
        Called after each frame.

    Raises
    ------
    NeedleSimError
        As :func:`film_writer`.
    """
    writer = film_writer(path)
    largest = max(_largest(section) for section in sections)
    with styled():
        figure = Figure(figsize=_SIZE)
        FigureCanvasAgg(figure)
        over_time = figure.add_axes((0.07, 0.66, 0.77, 0.21))
        over_depth = figure.add_axes((0.62, 0.12, 0.22, 0.40))
        below = figure.add_axes((0.07, 0.12, 0.45, 0.42))
        draw_force_over_time(over_time, series)
        draw_force_over_depth(over_depth, series)
        dot: dict[str, Any] = {"color": BLACK, "markerfacecolor": "white", "markersize": 6}
        (now,) = over_time.plot([], [], "D", **dot)
        (here,) = over_depth.plot([], [], "D", **dot)
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        force = axial_force(series)
        with writer.saving(figure, str(path), _DPI):
            for section in sections:
                pushed = np.interp(section.time, series.time, force)
                now.set_data([section.time], [pushed])
                here.set_data([MM * section.insertion_depth], [pushed])
                below.clear()
                draw_section(below, section, largest)
                writer.grab_frame()
                advance()


def _largest(section: Section) -> float:
    """Return the greatest displacement, m; at least a micrometre, so that a scale exists."""
    size = np.linalg.norm(section.displacement, axis=2)
    return float(np.nanmax(size, initial=1e-6))
