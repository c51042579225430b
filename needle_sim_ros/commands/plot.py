# SPDX-License-Identifier: Apache-2.0
"""``needle_sim plot``: a recorded session as a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from needle_sim_ros.commands.options import add_bag, add_json
from needle_sim_ros.commands.output import check_picture, check_writable, write_json
from needle_sim_ros.errors import NeedleSimError

NAME = "plot"
HELP = "draw a recorded session"
DESCRIPTION = """Draw a recorded session: force over time and depth, marker tracks, the deformed
section, tick times. The section is simulated again from the recorded scene and motion; in 3D it
is the cut y = 0, with needle, track and markers seen along y."""
EXAMPLES = (
    "plot demo/gao2016_20260101T120000Z --output session.png",
    "plot session_0.mcap --output session.svg",
    "plot bags/gao2016 --output session.png --animate insertion.gif",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_bag(parser)
    parser.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        required=True,
        help="png, svg or pdf by the suffix; an existing file is replaced",
    )
    parser.add_argument(
        "--animate",
        metavar="FILE",
        type=Path,
        help="make a film of the session: gif, or mp4 where ffmpeg is installed",
    )
    parser.add_argument(
        "--frames", metavar="N", type=int, default=120, help="of the film (default: 120)"
    )
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Read, draw, and sum up."""
    check_writable(args.json)
    check_picture(args.output)
    from needle_sim_ros.commands.session_plot import plot_session

    if args.animate is not None:
        from needle_sim_ros.view.film import film_writer

        if args.frames < 2:
            raise NeedleSimError(f"--frames {args.frames}: must be 2 or more")
        film_writer(args.animate)
        check_writable(args.animate)
    summary = plot_session(args.bag, args.output, args.animate, args.frames)
    print(f"plot: {args.output}")
    if args.animate is not None:
        print(f"film: {args.animate}")
    write_json(
        args.json,
        {
            "bag": str(args.bag),
            "plot": str(args.output),
            "film": None if args.animate is None else str(args.animate),
            "summary": summary.to_dict(),
        },
    )
    return 0
