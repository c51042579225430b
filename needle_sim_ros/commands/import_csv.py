# SPDX-License-Identifier: Apache-2.0
"""``needle_sim import``: a CSV file of an experiment becomes a session."""

from __future__ import annotations

import argparse
from pathlib import Path

from needle_sim_ros.commands.options import add_json, add_set, load_scene
from needle_sim_ros.commands.output import check_new_folder, check_writable, table, write_json
from needle_sim_ros.errors import NeedleSimError

NAME = "import"
HELP = "turn a CSV file of an experiment into a session"
DESCRIPTION = """Write a CSV file of time and columns as a session that replay and identify read.
Columns are named by --column or --columns, else by headings like "base_force.z [mN]". Quantities:
time, base_position.x .y .z, base_orientation.x to .w, base_force, base_torque, tip_position,
marker.1.x and so on."""
EXAMPLES = (
    "import table.csv --scene gao2016 --output session",
    "import table.csv --scene gao2016 --output session --column time=t:ms"
    " --column base_position.z=stage:mm --column base_force.z=Fz:N",
    "import table.csv --columns columns.yaml --output session",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("file", metavar="FILE", type=Path, help="CSV with a line of headings")
    parser.add_argument(
        "--output", metavar="BAG", type=Path, required=True, help="folder, which must not exist"
    )
    parser.add_argument("--scene", metavar="SCENE", help="scene to keep in the session")
    parser.add_argument(
        "--column",
        metavar="QUANTITY=HEADING[:UNIT]",
        action="append",
        default=[],
        help="column of a quantity; may be given several times",
    )
    parser.add_argument("--columns", metavar="FILE", type=Path, help="the same as YAML")
    parser.add_argument(
        "--rate",
        metavar="HZ",
        type=float,
        help="ticks per second of the commands (default: the scene's time step, else 100)",
    )
    add_set(parser)
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Read the table and write the session."""
    check_writable(args.json)
    check_new_folder(args.output)
    from needle_sim_ros.session.csv_table import read_columns, read_table
    from needle_sim_ros.session.imported import write_imported

    if args.rate is not None and not 0.1 <= args.rate <= 1e4:
        raise NeedleSimError(f"--rate {args.rate:g}: must be 0.1 to 10000 Hz")
    scene = None if args.scene is None else load_scene(args.scene, args.overrides)
    found = read_table(args.file, read_columns(args.columns, args.column))
    step = 0.01 if scene is None else scene.solver.time_step
    period = step if args.rate is None else 1.0 / args.rate
    counts = write_imported(args.output, found, scene, period)
    rows = [(topic, str(count)) for topic, count in counts.items()]
    print(table(rows, title=f"{args.file}: messages", align="<>"))
    if scene is None:
        print("  It holds no scene: replay and identify need --scene.")
    print(f"bag:  {args.output}")
    duration = float(found["time"][-1] - found["time"][0])
    write_json(
        args.json,
        {"bag": str(args.output), "messages": counts, "duration_s": duration},
    )
    return 0
