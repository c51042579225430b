# SPDX-License-Identifier: Apache-2.0
"""``needle_sim replay``: a recorded session simulated again and compared."""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from needle_sim_ros.commands.options import (
    add_json,
    add_mapping,
    add_set,
    load_scene,
    parse_overrides,
)
from needle_sim_ros.commands.output import (
    check_new_folder,
    check_picture,
    check_writable,
    prepared,
    progress,
    table,
    write_json,
)
from needle_sim_ros.errors import SessionError

if TYPE_CHECKING:
    from needle_sim_ros.scene import Scene
    from needle_sim_ros.session.compare import Difference
    from needle_sim_ros.session.content import Content
    from needle_sim_ros.session.reader import Session
    from needle_sim_ros.session.replay import Replay

NAME = "replay"
HELP = "simulate a recorded session again and compare"
DESCRIPTION = """Simulate a session again, tick by tick, from the commands that were applied, and
compare every channel with the recording. Exit status 1 when one differs by more than the
tolerance. With the recorded scene and version all differences are zero. A bag recorded by others
is simulated from the topics that --topic or --mapping name, and compared with what was measured."""
EXAMPLES = (
    "replay demo/gao2016_20260101T120000Z",
    "replay session_0.mcap --scene gao2016_steel --plot overlay.svg --tolerance 0.1",
    "replay session --set tissue.youngs_modulus=12000 --tolerance base_force=0.05",
    "replay experiment --scene gao2016 --topic base_pose:=/robot/ee_pose --topic wrench:=/ati/data",
)


# N, N m, m, 1: far above what another order of sums makes, far below what any sensor shows
_ROUNDING = 1e-9
_OF_ROUNDING = (
    "All differences are of rounding: numpy sums in another order on another kind of processor"
    f" than the session was recorded on. --tolerance {_ROUNDING:g} takes them."
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag's folder or MCAP file")
    add_mapping(parser)
    parser.add_argument("--scene", metavar="SCENE", help="default: the one in the bag")
    parser.add_argument(
        "--tolerance",
        metavar="[CHANNEL=]X",
        action="append",
        default=[],
        help="greatest difference allowed, in the channel's unit; for all channels or one;"
        " may be given several times (default: 0; with measured data none)",
    )
    parser.add_argument(
        "--output",
        metavar="BAG",
        type=Path,
        help="write recorded and simulated channels to this folder, which must not exist",
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="draw both; png, svg or pdf by the suffix"
    )
    add_set(parser)
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Simulate, compare, write what was asked for, and give the verdict."""
    check_writable(args.json)
    check_picture(args.plot)
    check_new_folder(args.output)
    from needle_sim_ros.commands.replay_measured import replay_measured
    from needle_sim_ros.session.compare import beyond, compare, read_tolerances
    from needle_sim_ros.session.content import read_contents
    from needle_sim_ros.session.imported import is_imported
    from needle_sim_ros.session.reader import bag_path, mcap_files, session_of
    from needle_sim_ros.session.replay import replay, replay_ticks

    if args.topics or args.mapping is not None:
        return replay_measured(args)
    begin = time.perf_counter()
    files = mcap_files(args.bag)
    content = read_contents(files)
    if is_imported(content):  # what stands in it was measured, not simulated
        return replay_measured(args)
    _check_ours(args.bag, content)
    tolerances = read_tolerances(args.tolerance)
    session = session_of(bag_path(files), content)
    ticks = replay_ticks(session)
    scene = _scene(args, session)
    preparing = time.perf_counter()
    simulator = prepared(scene)
    preparation = time.perf_counter() - preparing
    with progress(len(ticks), f"replaying {scene.name}") as bar:
        done = replay(
            session.metadata, simulator, ticks, bar.update, messages=args.output is not None
        )
    differences, compared = compare(session.series, done.series)
    took = time.perf_counter() - begin - preparation
    _check_reached(session, done)
    bad = beyond(differences, tolerances)
    factor = done.ticks * float(session.metadata["tick_period"]) / took
    print(table(_rows(differences, bad), title=f"replay of {scene.name}", align="<>><<"))
    notes = _notes(session, done, differences, compared)
    if bad and all(entry.max_abs < _ROUNDING for entry in differences.values()):
        notes.append(_OF_ROUNDING)
    for note in notes:
        print(f"  {note}")
    print(f"  {done.ticks} ticks, {compared} compared, in {took:.1f} s: {factor:.1f} x real time")
    print(f"  (read, simulated and compared; before that the scene took {preparation:.1f} s)")
    if args.output is not None:
        from needle_sim_ros.session.beside import write_beside

        write_beside(args.output, [content], session.metadata, done, scene)
        print(f"bag:  {args.output}")
    if args.plot is not None:
        from needle_sim_ros.view.files import save_figure
        from needle_sim_ros.view.overlay import overlay_figure

        title = f"{session.metadata.get('scene', 'session')}: recorded and simulated"
        figure = overlay_figure(session.series, done.series, title, " ".join(notes))
        save_figure(figure, args.plot)
        print(f"plot: {args.plot}")
    write_json(
        args.json,
        {
            "bag": str(args.bag),
            "scene": scene.name,
            "ticks": done.ticks,
            "ticks_compared": compared,
            "ticks_held": done.held,
            "channels": {name: asdict(entry) for name, entry in differences.items()},
            "beyond_tolerance": bad,
            "notes": notes,
            "preparation_time_s": preparation,
            "wall_time_s": took,
            "real_time_factor": factor,
        },
    )
    return 1 if bad or not compared else 0


def _check_ours(bag: Path, content: Content) -> None:
    """Refuse a whole bag of others, and say how it can be replayed."""
    from needle_sim_ros.session.writer import ABOUT

    if content.messages and content.damage is None and ABOUT not in content.metadata:
        topics = sorted({channel.topic for channel in content.channels.values()})
        raise SessionError(
            f"{bag}: no command topic: it is no session of needle_sim, so say which topic moves"
            f" the base: --topic base_pose:=NAME; its topics: {', '.join(topics)}"
        )


def _scene(args: argparse.Namespace, session: Session) -> Scene:
    if args.scene is not None:
        return load_scene(args.scene, args.overrides)
    scene = session.scene()
    return scene.with_changes(parse_overrides(args.overrides)) if args.overrides else scene


def _check_reached(session: Session, done: Replay) -> None:
    """Refuse a scene that the recorded motion misses."""
    touched = set(session.series.process) - {"free"}
    if touched and set(done.series.process) <= {"free"}:
        raise SessionError(
            "the scene does not fit the commands: the needle never reaches the tissue,"
            f" which it did in {session.path}"
        )


def _rows(differences: dict[str, Difference], bad: list[str]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("channel", "greatest difference", "rms", "unit", "")]
    for name, entry in differences.items():
        verdict = "beyond the tolerance" if name in bad else ""
        rows.append((name, f"{entry.max_abs:.3g}", f"{entry.rms:.3g}", entry.unit, verdict))
    return rows


def _notes(
    session: Session, done: Replay, differences: dict[str, Difference], compared: int
) -> list[str]:
    from needle_sim_ros.session.about import versions
    from needle_sim_ros.session.compare import UNITS

    notes = []
    if not session.complete:
        notes.append("The recording is cut off or damaged; what comes before that was replayed.")
    if done.held:
        notes.append(f"The commands of {done.held} ticks are lost; the one before was held.")
    if not compared:
        notes.append("No tick could be compared: no tick of the recording has all its outputs.")
    missing = [name for name in UNITS if name not in differences]
    if missing:
        notes.append(f"Not compared, as only one has it, or another number: {', '.join(missing)}.")
    if any(entry.max_abs for entry in differences.values()):
        now = versions()
        other = [k for k, v in now.items() if session.metadata.get(k, v) != v]
        changed = [f"{k} {session.metadata[k]}, now {now[k]}" for k in other]
        if changed:
            notes.append(f"Recorded with {'; '.join(changed)}.")
    return notes
