# SPDX-License-Identifier: Apache-2.0
"""``needle_sim run``: a scene's protocol in this process, without ROS."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from needle_sim_ros.commands.options import add_json, add_set, load_scene
from needle_sim_ros.commands.output import (
    check_new_folder,
    check_picture,
    check_writable,
    prepared,
    progress,
    table,
    write_json,
)
from needle_sim_ros.commands.tables import summary_rows
from needle_sim_ros.errors import SessionError

if TYPE_CHECKING:
    from needle_sim_ros.command import BaseCommand
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.session.run import Run, Watcher
    from needle_sim_ros.simulator import Simulator

_QUEUE = 20_000  # messages

NAME = "run"
HELP = "run a scene's protocol"
DESCRIPTION = """Run a scene's protocol in this process, as fast as it goes, and sum it up.
Needs no ROS; recording needs its message definitions."""
EXAMPLES = (
    "run gao2016",
    "run gao2016 --json out.json --plot out.svg",
    "run gao2016 --set solver.dynamics=quasi_static --set solver.time_step=0.05",
    "run my_scene.yaml --realtime --record sessions/first",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("scene", metavar="SCENE", help="a YAML file, or a scene of this package")
    parser.add_argument("--realtime", action="store_true", help="keep to the wall clock")
    parser.add_argument(
        "--record", metavar="BAG", type=Path, help="record to this folder, which must not exist"
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="draw the run; png, svg or pdf by the suffix"
    )
    add_set(parser)
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Run the protocol; print, record, plot and write what was asked for."""
    check_writable(args.json)
    check_picture(args.plot)
    check_new_folder(args.record)
    scene = load_scene(args.scene, args.overrides)

    from needle_sim_ros.protocol import protocol_commands
    from needle_sim_ros.session.run import InsertionEnd, run
    from needle_sim_ros.session.summary import summarise

    step = scene.solver.time_step
    commands = protocol_commands(scene.protocol, step)
    sim = prepared(scene)
    end_of_insertion = InsertionEnd(sim)
    with ExitStack() as stack:
        bar = stack.enter_context(progress(len(commands), f"running {scene.name}"))
        watchers: list[Watcher] = [end_of_insertion, lambda command, observation: bar.update()]
        if args.record is not None:
            watchers.append(stack.enter_context(_recording(args.record, sim, step)))
        done = run(sim, commands, step, realtime=args.realtime, watchers=watchers)
    summary = summarise(done.series, step, done.tick_times, done.wall_time)
    print(table(summary_rows(summary), title=scene.name, align="<>"))
    if args.realtime and done.overruns:
        print(f"  {done.overruns} ticks came too late for real time")
    series = done.series
    write_json(
        args.json,
        {
            "scene": scene.name,
            "ticks": len(series),
            "summary": summary.to_dict(),
            "series": {
                "time": series.time,
                "insertion_depth": series.insertion_depth,
                "base_force": series.base_force,
                "tip_force": series.tip_force,
                "friction_force": series.friction_force,
                "tip_position": series.tip_position,
                "tip_deflection": series.tip_deflection,
                "process": series.process,
                "marker_positions": series.marker_positions,
            },
        },
    )
    if args.record is not None:
        print(f"bag:  {args.record}")
    if args.plot is not None:
        sim.restore(end_of_insertion.snapshot)
        _plot(sim, done, args.plot)
        print(f"plot: {args.plot}")
    return 0


@contextmanager
def _recording(folder: Path, sim: Simulator, time_step: float) -> Iterator[Watcher]:
    """Record every tick; says on stderr what could not be written."""
    from needle_sim_ros.session.motion import Motion
    from needle_sim_ros.session.writer import SessionWriter

    writer = SessionWriter(folder, sim.scene, time_step)

    def watch(command: BaseCommand, observation: Observation) -> None:
        writer.observe(observation, Motion.of(command), sim.statistics.last_tick_time)
        while writer.status.queued > _QUEUE:  # the run is faster than the disk
            time.sleep(0.01)

    try:
        yield watch
    finally:
        status = writer.close()
    if status.lost or status.error:
        raise SessionError(f"{folder}: {status.lost} messages lost: {status.error}")


def _plot(sim: Simulator, done: Run, path: Path) -> None:
    """Draw the run, with the section in the simulator's present state."""
    from needle_sim_ros.view.figure import session_figure
    from needle_sim_ros.view.files import save_figure
    from needle_sim_ros.view.section import take_section

    figure = session_figure(
        done.series,
        sim.scene.name,
        section=take_section(sim, sim.observe()),
        tick_times=done.tick_times,
        time_step=sim.scene.solver.time_step,
    )
    save_figure(figure, path)
