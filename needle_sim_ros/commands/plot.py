# SPDX-License-Identifier: Apache-2.0
"""``needle_sim plot``: a recorded session as a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from needle_sim_ros.commands.options import add_json
from needle_sim_ros.commands.output import check_picture, check_writable, write_json

NAME = "plot"
HELP = "draw a recorded session"
DESCRIPTION = """Draw a recorded session: force over time and depth, marker tracks, the deformed
section. The section is simulated again from the recorded scene and motion."""
EXAMPLES = (
    "plot demo/gao2016_20260101T120000Z --output session.png",
    "plot session_0.mcap --output session.svg",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a session's folder or MCAP file")
    parser.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        required=True,
        help="png, svg or pdf by the suffix; an existing file is replaced",
    )
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Read, draw, and sum up."""
    check_writable(args.json)
    check_picture(args.output)
    from needle_sim_ros.commands.session_plot import plot_session

    summary = plot_session(args.bag, args.output)
    print(f"plot: {args.output}")
    write_json(
        args.json,
        {"bag": str(args.bag), "plot": str(args.output), "summary": summary.to_dict()},
    )
    return 0
