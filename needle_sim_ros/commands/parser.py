# SPDX-License-Identifier: Apache-2.0
"""The parser of ``needle_sim`` with all its subcommands."""

from __future__ import annotations

import argparse

from needle_sim_ros import __version__
from needle_sim_ros.commands import Command, load_all
from needle_sim_ros.commands.options import examples

DESCRIPTION = "Simulate a flexible needle entering soft tissue."


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with every registered subcommand."""
    parser = argparse.ArgumentParser(
        prog="needle_sim",
        description=DESCRIPTION,
        epilog="needle_sim COMMAND --help shows each command's options with examples.",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in load_all():
        _add(subparsers, command)
    return parser


def _add(subparsers: argparse._SubParsersAction[argparse.ArgumentParser], command: Command) -> None:
    parser = subparsers.add_parser(
        command.NAME,
        help=command.HELP,
        description=command.DESCRIPTION,
        epilog=examples(command.EXAMPLES),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.configure(parser)
    parser.set_defaults(execute=command.execute)
