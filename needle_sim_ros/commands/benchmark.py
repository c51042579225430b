# SPDX-License-Identifier: Apache-2.0
"""``needle_sim benchmark``: how accurate, how fast, how stable."""

from __future__ import annotations

import argparse
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any

import needle_sim_ros
from needle_sim_ros.commands.options import add_json, add_set, load_scene
from needle_sim_ros.commands.output import check_picture, check_writable, progress
from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
    from needle_sim_ros.benchmark.result import BenchmarkResult

NAME = "benchmark"
HELP = "measure accuracy, speed, scaling, stability; soak the node"
DESCRIPTION = """Run one of the package's benchmarks and print its table and figures. Times are
ratios within one run, so that they mean something on any machine."""
EXAMPLES = (
    "benchmark speed --quick",
    "benchmark speed gao2016_steel --json speed.json",
    "benchmark accuracy bevel_gelatin_22g --quick",
    "benchmark tips",
    "benchmark accuracy --quick --plot pareto.png",
    "benchmark accuracy --quick --budget 0.5ms",
    "benchmark accuracy --quick --error 1%",
    "benchmark rollouts --quick",
    "benchmark plan --quick",
    "benchmark soak --minutes 10 --json soak.json",
    "benchmark soak --minutes 1 --dedicated-core 1",
    "benchmark soak --minutes 1 --keep-awake",
)

_PACKAGE = "needle_sim_ros.benchmark"
_KNOWN = (
    "accuracy",
    "speed",
    "scaling",
    "stability",
    "soak",
    "rollouts",
    "plan",
    "identify",
    "tips",
)
_NODE = {
    "speed": ("needle_sim_ros.ros.loop_measurement", "measure_loop"),
    "soak": ("needle_sim_ros.ros.soak.drive", "drive"),
}
_ONLY = {
    "accuracy": ("plot", "budget", "error"),
    "plan": ("targets", "results"),
    "soak": ("minutes", "dedicated_core", "keep_awake"),
}
# what a benchmark runs on unless told: the scene that it is about
_SCENES = {"tips": "bevel_gelatin_22g"}


def available() -> list[str]:
    """Return the benchmarks that this installation has: modules with a function of their name."""
    folder = Path(needle_sim_ros.__file__).parent / "benchmark"
    found = {module.name for module in iter_modules([str(folder)])}
    return [name for name in _KNOWN if name in found]


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    names = available()
    parser.add_argument("benchmark", metavar="NAME", choices=names, help=f"{', '.join(names)}")
    parser.add_argument("positional", metavar="SCENE", nargs="?", help="default: gao2016")
    parser.add_argument("--scene", metavar="SCENE", help="the same")
    parser.add_argument("--quick", action="store_true", help="a smaller version, for a first look")
    add_set(parser)
    add_json(parser)
    accuracy = parser.add_argument_group("accuracy")
    accuracy.add_argument("--plot", metavar="FILE", type=Path, help="picture: error, tick time")
    accuracy.add_argument(
        "--budget",
        metavar="TIME",
        type=_milliseconds,
        help="print the most accurate settings whose tick takes at most this, e.g. 0.5ms",
    )
    accuracy.add_argument(
        "--error",
        metavar="PART",
        type=_fraction,
        help="print the fastest settings with at most this error, e.g. 1%%",
    )

    plan = parser.add_argument_group("plan")
    plan.add_argument("--targets", metavar="N", type=int, help="how many (default: 100, quick 10)")
    plan.add_argument(
        "--results",
        metavar="FILE",
        type=Path,
        help="write each target's result when it is there; go on after those that stand in it",
    )
    soak = parser.add_argument_group("soak")
    soak.add_argument(
        "--minutes",
        metavar="N",
        type=_positive,
        help="minutes of steady load (default: 10, or with --quick a third of one)",
    )
    soak.add_argument(
        "--dedicated-core",
        metavar="N",
        type=int,
        help="processor that the node under load has to itself, as its parameter (default: none)",
    )
    soak.add_argument(
        "--keep-awake",
        action="store_const",
        const=True,
        help="the node under load keeps the processors awake, as its parameter",
    )


def _positive(text: str) -> float:
    return _above_zero(float(text))


def _milliseconds(text: str) -> float:
    """Read a time as ms; without a unit it is in ms."""
    units = {"us": 1e-3, "ms": 1.0, "s": 1e3}
    number = text.rstrip("umsµ")
    unit = text[len(number) :].replace("µ", "u") or "ms"
    if unit not in units:
        raise ValueError
    return _above_zero(float(number) * units[unit])


def _fraction(text: str) -> float:
    """Read ``1%`` or ``0.01`` as a fraction."""
    return _above_zero(float(text[:-1]) / 100 if text.endswith("%") else float(text))


def _above_zero(value: float) -> float:
    if not 0 < value < float("inf"):
        raise ValueError
    return value


def execute(args: argparse.Namespace) -> int:
    """Run the benchmark; print and write its result."""
    check_writable(args.json)
    _check_options(args)
    if args.positional is not None and args.scene is not None:
        raise NeedleSimError(f"--scene {args.scene}: a scene is given already, {args.positional}")
    scene = load_scene(
        args.positional or args.scene or _SCENES.get(args.benchmark, "gao2016"), args.overrides
    )
    benchmark = getattr(import_module(f"{_PACKAGE}.{args.benchmark}"), args.benchmark)
    with progress(1, f"benchmark {args.benchmark}", unit="step") as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = benchmark(scene, quick=args.quick, progress=advance, **_more(args))
    print(result.text(), end="")
    if args.json is not None:
        result.write_json(args.json)
    if args.plot is not None:
        _plot(result, args)
    return _recommend(result, args)


def _check_options(args: argparse.Namespace) -> None:
    for benchmark, options in _ONLY.items():
        given = [name for name in options if getattr(args, name) is not None]
        if given and args.benchmark != benchmark:
            option = given[0].replace("_", "-")
            raise NeedleSimError(f"--{option}: only benchmark {benchmark} has it")
    if args.targets is not None and args.targets < 1:
        raise NeedleSimError(f"--targets {args.targets}: must be at least 1")
    check_picture(args.plot)


def _plot(result: BenchmarkResult, args: argparse.Namespace) -> None:
    from needle_sim_ros.view.files import save_figure
    from needle_sim_ros.view.pareto import pareto_figure

    how = "quick run" if args.quick else "full run"
    rows = [row for row in result.table if row["compared"]]
    save_figure(pareto_figure(rows, f"{result.scene}: error against run time ({how})"), args.plot)
    print(f"plot: {args.plot}")


def _recommend(result: BenchmarkResult, args: argparse.Namespace) -> int:
    """Print the settings for a budget or an error; return 1 when none was found."""
    if args.budget is None and args.error is None:
        return 0
    from needle_sim_ros.benchmark.recommend import recommend

    chosen = recommend(result.table, args.budget, args.error)
    if chosen is None:
        print("no measured setting is as fast and as accurate as that")
        return 1
    print(
        f"{chosen['method']}, {chosen['run']}: error {100 * chosen['max_error']:.2g} %, "
        f"tick {chosen['tick_ms']:.2g} ms; set"
    )
    for setting in chosen["settings"].split():
        print(f"  --set {setting}")
    return 0


def _more(args: argparse.Namespace) -> dict[str, Any]:
    """Return what a benchmark measures the node with, where ROS is installed."""
    more: dict[str, Any] = {}
    if args.benchmark == "soak":
        core = -1 if args.dedicated_core is None else args.dedicated_core
        more = {
            "minutes": args.minutes,
            "dedicated_core": core,
            "keep_awake": bool(args.keep_awake),
        }
    if args.benchmark == "plan":
        more = {"targets": args.targets, "results": args.results}
    if args.benchmark in _NODE and find_spec("rclpy") is not None:
        module, function = _NODE[args.benchmark]
        more["node"] = getattr(import_module(module), function)
    return more
