# SPDX-License-Identifier: Apache-2.0
"""``needle_sim demo``: the paper's insertion over real ROS 2 topics, in two processes."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from needle_sim_ros.commands.interruption import Interruption
from needle_sim_ros.commands.options import add_json, add_set, load_scene
from needle_sim_ros.commands.output import check_writable, progress, table, write_json
from needle_sim_ros.commands.tables import summary_rows
from needle_sim_ros.errors import NeedleSimError, SessionError

if TYPE_CHECKING:
    from needle_sim_ros.command import BaseCommand
    from needle_sim_ros.ros.driver import Driver

NAME = "demo"
HELP = "the paper's insertion over ROS 2 topics, recorded and drawn"
DESCRIPTION = """Start the node and drive it from another process, over real ROS 2 topics, through a
scene's protocol (60 mm in at 3 mm/s, hold, out); record it, sum it up and draw it. By
default the node is paused and stepped: as fast as it goes and the same each time."""
EXAMPLES = (
    "demo",
    "demo --realtime --output demo",
    "demo --scene gao2016_steel --set solver.dynamics=quasi_static",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--realtime", action="store_true", help="let the node's own clock run")
    parser.add_argument(
        "--output",
        metavar="DIR",
        type=Path,
        default=Path("demo"),
        help="folder for the recording and the plot (default: ./demo)",
    )
    parser.add_argument("--scene", metavar="SCENE", default="gao2016", help="default: gao2016")
    add_set(parser)
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Drive, record, sum up, draw, and say what to try next."""
    if find_spec("rclpy") is None:
        raise NeedleSimError(
            "the demo needs ROS 2 Jazzy: source its setup.bash, or pip install needle_sim_ros[ros]"
        )
    check_writable(args.json)
    output: Path = args.output.resolve()
    check_writable(output / "session.png")
    begin = time.perf_counter()
    with Interruption() as interruption:
        bag = _drive(args, output, interruption)
    took = time.perf_counter() - begin

    from needle_sim_ros.commands.session_plot import plot_session

    plot = output / "session.png"
    summary = plot_session(bag, plot)
    print(table(summary_rows(summary), title="demo", align="<>"))
    print(f"  {summary.duration:.0f} s of insertion over ROS 2 topics in {took:.0f} s")
    shown_bag, shown_plot = _short(bag), _short(plot)
    print(f"bag:  {shown_bag}\nplot: {shown_plot}")
    print(_hints(shown_bag))
    write_json(args.json, {"bag": str(bag), "plot": str(plot), "summary": summary.to_dict()})
    return 0


def _drive(args: argparse.Namespace, output: Path, interruption: Interruption) -> Path:
    """Run node and driver; return the recorded session's folder."""
    scene = load_scene(args.scene, args.overrides)

    from needle_sim_ros.protocol import protocol_commands

    step = scene.solver.time_step
    commands = protocol_commands(scene.protocol, step)
    source = args.scene
    if args.overrides:
        changed = output / "scene.yaml"
        changed.write_text(scene.to_yaml(), encoding="utf-8")
        source = str(changed)
    parameters: dict[str, object] = {"scene": source, "rate": 1.0 / step}
    parameters["record_root"] = str(output)
    if not args.realtime:
        parameters["command_timeout"] = 0.0  # each command is known to have arrived

    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_LOG_DIR", str(output / "log"))
    from needle_sim_ros.ros.domain import free_domain
    from needle_sim_ros.ros.driver import Driver
    from needle_sim_ros.ros.node_process import NodeProcess

    domain = free_domain()

    def check() -> None:
        interruption.check()
        node.check()

    with (
        NodeProcess(parameters, domain, output / "node.log") as node,
        Driver(domain, check) as driver,
    ):
        driver.wait_ready()
        driver.pause(True)
        driver.reset()
        driver.set_parameter("record", str(output))
        bag = Path(driver.record(True))
        follow = _in_real_time if args.realtime else _stepwise
        with progress(len(commands), f"{scene.name} over ROS 2") as bar:
            follow(driver, commands, step, bar.update)
        ended = driver.record(False)
    if " lost: " in ended:
        raise SessionError(f"recording {ended}")
    return bag


def _stepwise(
    driver: Driver, commands: Sequence[BaseCommand], step: float, advance: Callable[[int], object]
) -> None:
    """Step the paused node; a command that changes has arrived before the next tick."""
    last = None
    for command in commands:
        if command is not last:
            driver.deliver(command)
            last = command
        driver.step()
        advance(1)


def _in_real_time(
    driver: Driver, commands: Sequence[BaseCommand], step: float, advance: Callable[[int], object]
) -> None:
    """Let the node's clock run and send what is due at the time that its stamps tell."""
    driver.pause(False)
    done = 0
    while (tick := round(driver.time / step)) < len(commands):
        driver.send(commands[tick])
        advance(tick - done)
        done = tick
        driver.wait_tick()
    driver.pause(True)


def _short(path: Path) -> Path:
    """Return the path as seen from here, where that is shorter."""
    return Path(os.path.relpath(path)) if path.is_relative_to(Path.cwd()) else path


def _hints(bag: Path) -> str:
    needle_sim, sim_node = _program("needle_sim"), _program("sim_node")
    return f"""try next:
  {needle_sim} plot {bag} --output session.svg
  {needle_sim} run gao2016_steel --plot steel.png
  {needle_sim} demo --realtime
  {sim_node} --ros-args -p scene:=gao2016"""


def _program(name: str) -> str:
    """Return how to call a program of this package from here."""
    beside = Path(sys.executable).parent / name
    return str(_short(beside)) if shutil.which(name) is None and beside.exists() else name
