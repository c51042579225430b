# SPDX-License-Identifier: Apache-2.0
"""``needle_sim run``: a scene's protocol in this process, without ROS."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needle_sim_ros.commands.options import add_json, add_set, load_scene
from needle_sim_ros.commands.output import check_picture, check_writable, progress, table, write_json
from needle_sim_ros.commands.tables import summary_rows

if TYPE_CHECKING:
    from needle_sim_ros.command import BaseCommand
    from needle_sim_ros.session.run import Run
    from needle_sim_ros.simulator import Simulator

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
    scene = load_scene(args.scene, args.overrides)

    from needle_sim_ros.protocol import protocol_commands
    from needle_sim_ros.session.run import run
    from needle_sim_ros.session.summary import summarise
    from needle_sim_ros.simulator import Simulator

    step = scene.solver.time_step
    commands = protocol_commands(scene.protocol, step)
    sim = Simulator(scene)
    with ExitStack() as stack:
        bar = stack.enter_context(progress(len(commands), f"running {scene.name}"))
        watchers: list[Any] = [lambda command, observation: bar.update()]
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
    if args.plot is not None:
        _plot(sim, done, commands, args.plot)
        print(f"plot: {args.plot}")
    return 0


def _plot(sim: Simulator, done: Run, commands: list[BaseCommand], path: Path) -> None:
    from needle_sim_ros.session.run import deepest_tick
    from needle_sim_ros.view.figure import session_figure
    from needle_sim_ros.view.files import save_figure
    from needle_sim_ros.view.section import take_section

    step = sim.scene.solver.time_step
    sim.reset()
    for command in commands[: deepest_tick(done.series) + 1]:
        observation = sim.step(command, step)
    figure = session_figure(
        done.series,
        f"{sim.scene.name}: needle insertion",
        section=take_section(sim, observation),
        tick_times=done.tick_times,
        time_step=step,
    )
    save_figure(figure, path)
