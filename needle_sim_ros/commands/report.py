# SPDX-License-Identifier: Apache-2.0
"""``needle_sim report``: a recorded session as one web page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needle_sim_ros.commands.options import add_bag, add_json
from needle_sim_ros.commands.output import check_writable, progress, write_json
from needle_sim_ros.commands.tables import summary_rows
from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
    from needle_sim_ros.session.reader import Session
    from needle_sim_ros.view.page import Page

NAME = "report"
HELP = "make a web page of a recorded session"
DESCRIPTION = """Make one web page of a recorded session: pictures, statistics, what the node said
of itself, events and scene. The file holds everything: it needs no network and runs no script."""
EXAMPLES = (
    "report demo/gao2016_20260101T120000Z --output report.html",
    "report bags/gao2016 --output report.html --replay",
)

_MOST_EVENTS = 200


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_bag(parser)
    parser.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        required=True,
        help="ends in .html; an existing file is replaced",
    )
    parser.add_argument(
        "--replay", action="store_true", help="simulate the session again and compare"
    )
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Read, draw, compare if asked to, and write the page."""
    check_writable(args.json)
    if args.output.suffix.lower() not in (".html", ".htm"):
        raise NeedleSimError(f"{args.output}: a report's name must end in .html")
    check_writable(args.output)
    from needle_sim_ros.commands.session_plot import (
        figure_of,
        read_drawable,
        sections_of,
        summary_of,
    )
    from needle_sim_ros.view.page import Page

    session = read_drawable(args.bag)
    summary = summary_of(session)
    page = Page(f"{session.metadata.get('scene', 'session')}: recorded session")
    page.table(_about(session))
    if not session.complete:
        page.paragraph("The recording was cut off; this is what comes before that.")
    page.heading("Pictures")
    picture = figure_of(session, *sections_of(session))
    page.figure(
        picture,
        "Force over time and over insertion depth with the processes marked, deformed section"
        " with needle, track and displacement, marker tracks, tick times.",
    )
    page.heading("Statistics")
    page.table([(name, value.strip()) for name, value in summary_rows(summary)])
    _add_health(page, args.bag, session)
    compared = _add_comparison(page, session) if args.replay else None
    _add_events(page, session)
    page.heading("Scene")
    page.paragraph("Lengths in m, forces in N, moduli in Pa, times in s, angles in rad.")
    page.preformatted(session.scene_text, "The scene as recorded (YAML)")
    args.output.write_text(page.html(), encoding="utf-8")
    print(f"report: {args.output}")
    write_json(
        args.json,
        {
            "bag": str(args.bag),
            "report": str(args.output),
            "summary": summary.to_dict(),
            "channels": compared,
        },
    )
    return 0


def _about(session: Session) -> list[tuple[str, str]]:
    """Return what a session says about itself, topics and parameters left out."""
    values = session.metadata
    return [("file", session.path.name)] + [
        (name.replace("_", " "), value)
        for name, value in values.items()
        if "." not in name and name != "scene_sha256"
    ]


def _add_health(page: Page, bag: Path, session: Session) -> None:
    from needle_sim_ros.session.content import read_contents
    from needle_sim_ros.session.health import last_diagnostics
    from needle_sim_ros.session.reader import mcap_files

    parts = last_diagnostics(read_contents(mcap_files(bag)), session.metadata)
    if parts:
        page.heading("The node's last diagnostics")
    for part in parts:
        page.table(list(part.values.items()), f"{part.name}: {part.level}, {part.message}")


def _add_comparison(page: Page, session: Session) -> dict[str, Any]:
    """Simulate the session again; add how far that is from the recording, and return it."""
    from dataclasses import asdict

    from needle_sim_ros.session.compare import compare
    from needle_sim_ros.session.replay import replay, replay_ticks
    from needle_sim_ros.simulator import Simulator
    from needle_sim_ros.view.overlay import overlay_figure

    ticks = replay_ticks(session)
    simulator = Simulator(session.scene())
    with progress(len(ticks), "replaying") as bar:
        done = replay(session.metadata, simulator, ticks, bar.update)
    differences, compared = compare(session.series, done.series)
    page.heading("Replay")
    page.paragraph(
        f"{compared} ticks simulated again from the recorded commands and compared."
        " Same scene, same package and same machine: zero."
    )
    page.table(
        [(name, f"{d.max_abs:.3g}", f"{d.rms:.3g}", d.unit) for name, d in differences.items()],
        header=("channel", "greatest difference", "rms", "unit"),
    )
    page.figure(
        overlay_figure(session.series, done.series, "Recorded and simulated"),
        "Recorded and simulated force, deflection and marker displacement over time.",
    )
    return {name: asdict(difference) for name, difference in differences.items()}


def _add_events(page: Page, session: Session) -> None:
    page.heading("Events")
    if not session.events:
        page.paragraph("None was recorded.")
        return
    rows = [
        (
            f"{time * 1e-9:.3f} s",
            str(event.get("event", "")),
            ", ".join(f"{k}: {v}" for k, v in event.items() if k != "event"),
        )
        for time, event in session.events[:_MOST_EVENTS]
    ]
    page.table(rows, header=("time", "event", "details"))
    if len(session.events) > _MOST_EVENTS:
        page.paragraph(f"and {len(session.events) - _MOST_EVENTS} more")
