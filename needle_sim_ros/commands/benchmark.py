# SPDX-License-Identifier: Apache-2.0
"""``needle_sim benchmark``: how accurate, how fast, how stable."""

from __future__ import annotations

import argparse
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import needle_sim_ros
from needle_sim_ros.commands.options import add_json, add_set, load_scene
from needle_sim_ros.commands.output import check_writable, progress

NAME = "benchmark"
HELP = "measure accuracy, speed, scaling, stability"
DESCRIPTION = """Run one of the package's benchmarks and print its table and figures. Times are
ratios within one run, so that they mean something on any machine."""
EXAMPLES = (
    "benchmark speed --quick",
    "benchmark speed --scene gao2016_steel --json speed.json",
)

_PACKAGE = "needle_sim_ros.benchmark"
_KNOWN = ("accuracy", "speed", "scaling", "stability", "soak")


def available() -> list[str]:
    """Return the benchmarks that this installation has: modules with a function of their name."""
    folder = Path(needle_sim_ros.__file__).parent / "benchmark"
    found = {module.name for module in iter_modules([str(folder)])}
    return [name for name in _KNOWN if name in found]


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    names = available()
    parser.add_argument("benchmark", metavar="NAME", choices=names, help=f"{', '.join(names)}")
    parser.add_argument("--scene", metavar="SCENE", default="gao2016", help="default: gao2016")
    parser.add_argument("--quick", action="store_true", help="a smaller version, for a first look")
    add_set(parser)
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Run the benchmark; print and write its result."""
    check_writable(args.json)
    scene = load_scene(args.scene, args.overrides)
    benchmark = getattr(import_module(f"{_PACKAGE}.{args.benchmark}"), args.benchmark)
    with progress(1, f"benchmark {args.benchmark}", unit="step") as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = benchmark(scene, quick=args.quick, progress=advance, **_node(args.benchmark))
    print(result.text(), end="")
    if args.json is not None:
        result.write_json(args.json)
    return 0


def _node(name: str) -> dict[str, Any]:
    """Return what `speed` measures the node's loop with, where ROS is installed."""
    if name != "speed" or find_spec("rclpy") is None:
        return {}
    return {"node": import_module("needle_sim_ros.ros.loop_measurement").measure_loop}
