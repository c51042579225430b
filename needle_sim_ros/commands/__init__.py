# SPDX-License-Identifier: Apache-2.0
"""The subcommands of ``needle_sim``, one module each.

A new subcommand is a module in this folder with the members of :class:`Command`, and its
name in ``NAMES``. Modules import what is heavy (matplotlib, scikit-fem, rclpy) inside
``execute``: every start of the program imports all of them to build its help.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import Protocol, cast

NAMES = (
    "run",
    "demo",
    "plan",
    "plot",
    "replay",
    "salvage",
    "import_csv",
    "identify",
    "scene",
    "benchmark",
)


class Command(Protocol):
    """What a subcommand's module offers.

    Attributes
    ----------
    NAME : str
        As typed after ``needle_sim``.
    HELP : str
        One line in the list of commands.
    DESCRIPTION : str
        A few lines at the top of ``needle_sim NAME --help``.
    EXAMPLES : tuple of str
        Complete calls without the leading ``needle_sim``.
    """

    NAME: str
    HELP: str
    DESCRIPTION: str
    EXAMPLES: tuple[str, ...]

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the subcommand's arguments."""
        ...

    def execute(self, args: argparse.Namespace) -> int:
        """Do the work and return the exit status; raise ``NeedleSimError`` where it cannot."""
        ...


def load_all() -> list[Command]:
    """Import every subcommand, in the order of the help."""
    return [cast(Command, import_module(f"{__name__}.{name}")) for name in NAMES]
