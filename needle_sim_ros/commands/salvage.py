# SPDX-License-Identifier: Apache-2.0
"""``needle_sim salvage``: a damaged session's readable part as a new session."""

from __future__ import annotations

import argparse
import itertools
from dataclasses import asdict
from pathlib import Path

from needle_sim_ros.commands.options import add_bag, add_json
from needle_sim_ros.commands.output import check_new_folder, check_writable, write_json

NAME = "salvage"
HELP = "recover a truncated or damaged session"
DESCRIPTION = """Write everything readable of a truncated or damaged session into a new one, and say
what was lost and why. The source is only read. The new session is read again, by another
reader, before success is reported."""
EXAMPLES = (
    "salvage demo/gao2016_20260101T120000Z",
    "salvage broken.mcap --output recovered --json losses.json",
)
_SHOWN = 20


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_bag(parser)
    parser.add_argument(
        "--output",
        metavar="DIR",
        type=Path,
        help="new folder, which must not exist (default: beside the source, named _salvaged)",
    )
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Salvage, and say what was lost."""
    check_writable(args.json)
    check_new_folder(args.output)
    from needle_sim_ros.session.reader import mcap_files
    from needle_sim_ros.session.salvage import Loss, salvage

    files = mcap_files(args.bag)
    source = files[0] if len(files) == 1 else args.bag
    folder = args.output or _beside(args.bag.absolute())
    result = salvage(files, folder)

    def line(loss: Loss) -> str:
        count = "" if loss.messages is None else f", {loss.messages} messages"
        extent = f"{loss.length} bytes{count} lost" if loss.length else "nothing lost here"
        where = "" if len(files) == 1 else f"{loss.file} "
        return f"  {where}at byte {loss.offset}: {loss.reason} ({extent})"

    total = sum(result.messages.values())
    print(f"{total} messages on {len(result.messages)} topics salvaged from {source}")
    for loss in result.losses[:_SHOWN]:
        print(line(loss))
    if len(result.losses) > _SHOWN:
        print(f"  and {len(result.losses) - _SHOWN} more places")
    for note in result.notes:
        print(f"  {note}")
    if not result.losses and not result.notes:
        print("  nothing was damaged")
    print(f"bag:  {folder}")
    write_json(
        args.json,
        {
            "source": str(source),
            "bag": str(folder),
            "messages": total,
            "topics": result.messages,
            "losses": [asdict(loss) for loss in result.losses],
            "notes": result.notes,
            "has_scene": result.has_scene,
        },
    )
    return 0


def _beside(source: Path) -> Path:
    """Return a new folder's name beside the source."""
    base = source if source.is_dir() else source.with_suffix("")
    for number in itertools.count(1):
        tail = "" if number == 1 else f"_{number}"
        folder = base.with_name(f"{base.name}_salvaged{tail}")
        if not folder.exists():
            return folder
    raise AssertionError
