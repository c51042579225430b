# SPDX-License-Identifier: Apache-2.0
"""The processes of a run as labelled bands behind a curve over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.view.style import PROCESSES, ProcessStyle

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

LABEL_SIZE = 8.5  # points
_CHARACTER = 0.62  # mean width of a character over its size
_NARROWEST_LABEL = 0.01  # of the axes' width; what is narrower goes unlabelled


@dataclass(frozen=True)
class Band:
    """A stretch of one process: ticks ``first`` to ``last``, both included."""

    process: str
    first: int
    last: int


def bands(process: Sequence[str]) -> list[Band]:
    """Return the runs of equal process labels, in order."""
    found: list[Band] = []
    first = 0
    for i in range(1, len(process) + 1):
        if i == len(process) or process[i] != process[first]:
            found.append(Band(process[first], first, i - 1))
            first = i
    return found


def process_lines(process: Sequence[str]) -> Iterator[tuple[slice, ProcessStyle, str | None]]:
    """Yield how to draw a curve process by process, where the needle is not free.

    Yields
    ------
    slice, ProcessStyle, str or None
        Rows of a stretch, from the last one before it, so that stretches join; its style;
        its name the first time.
    """
    named: set[str] = set()
    for band in bands(process):
        if band.process != "free":
            label = None if band.process in named else band.process
            named.add(band.process)
            rows = slice(max(band.first - 1, 0), band.last + 1)
            yield rows, PROCESSES[band.process], label


def draw_bands(ax: Axes, time: NDArray[np.float64], process: Sequence[str]) -> None:
    """Shade the processes over ``time`` (s) and write their names above the axes.

    Set the limits of the time axis before. A name that is wider than its band is
    written at a slant; neighbours are far enough apart for that in any protocol
    whose short processes are not next to each other.
    """
    left, right = ax.get_xlim()
    width = ax.get_window_extent().width / ax.figure.dpi * 72  # points
    edges: dict[str, list[float]] = {}
    for band in bands(process):
        start = time[band.first - 1] if band.first else min(left, time[0])
        end = time[band.last]
        edges.setdefault(band.process, []).extend((start, end, np.nan))
        share = (end - start) / (right - left)
        if share < _NARROWEST_LABEL:
            continue
        fits = len(band.process) * _CHARACTER * LABEL_SIZE < share * width
        ax.text(
            (start + end) / 2,
            1.02,
            band.process,
            transform=ax.get_xaxis_transform(),
            fontsize=LABEL_SIZE,
            ha="center" if fits else "left",
            va="bottom",
            rotation=0 if fits else 40,
            rotation_mode="anchor",
        )
    for name, x in edges.items():
        ax.fill_between(
            x,
            0.0,
            1.0,
            where=np.isfinite(x).tolist(),
            transform=ax.get_xaxis_transform(),
            facecolor=PROCESSES[name].band,
            edgecolor="0.6",
            linewidth=0.6,
            zorder=0,
        )
