# SPDX-License-Identifier: Apache-2.0
"""Figures as files. Cheap to import: matplotlib comes with the first figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
_UNDATED: dict[str, dict[str, None]] = {
    "png": {},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}


def picture_format(path: Path) -> str:
    """Return the format that the suffix of a picture's file name stands for.

    Raises
    ------
    NeedleSimError
        When it stands for none, with those that exist.
    """
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        raise NeedleSimError(f"{path}: a picture's name must end in .{', .'.join(FORMATS)}")
    return suffix


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure; the same figure gives the same bytes."""
    from needle_sim_ros.view.style import styled

    suffix = picture_format(path)
    with styled():
        figure.savefig(path, format=suffix, metadata=_UNDATED[suffix])
