# SPDX-License-Identifier: Apache-2.0
"""Colours and line styles, readable in grey and with any kind of colour vision."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl

# Okabe and Ito (2008), Color Universal Design.
BLACK = "#000000"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"

LINE_COLOURS = (BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE)

COLOUR_MAP = "cividis"

MM = 1e3  # mm per m
MS = 1e3  # ms per s


@dataclass(frozen=True)
class ProcessStyle:
    """How one process is drawn: band colour, line colour, line style."""

    band: str
    line: str
    dashes: str | tuple[int, tuple[float, ...]]


# Neighbouring bands differ in lightness; lines differ in dashes as well as in colour.
PROCESSES = {
    "free": ProcessStyle("#ffffff", "#7f7f7f", (0, (1, 2))),
    "contact": ProcessStyle("#d9d9d9", BLACK, (0, (1, 1))),
    "insertion": ProcessStyle("#e8f2fb", BLUE, "-"),
    "hold": ProcessStyle("#cfe3d8", GREEN, (0, (4, 1.5, 1, 1.5))),
    "retraction": ProcessStyle("#fdf1dc", VERMILION, (0, (5, 2))),
}

_SETTINGS: Any = {
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.grid": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "svg.hashsalt": "needle_sim_ros",  # the same data gives the same file
}


def styled() -> AbstractContextManager[None]:
    """Return a context with this package's matplotlib settings."""
    context: AbstractContextManager[None] = mpl.rc_context(_SETTINGS)
    return context
