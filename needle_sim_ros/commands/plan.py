# SPDX-License-Identifier: Apache-2.0
"""``needle_sim plan``: the insertion that brings the tip to a target that moves."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needle_sim_ros.commands.options import add_json, add_set, load_scene
from needle_sim_ros.commands.output import (
    check_picture,
    check_writable,
    progress,
    table,
    write_json,
)
from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
    from needle_sim_ros.planning.corrected import VerifiedPlan
    from needle_sim_ros.planning.planner import Plan, Planner
    from needle_sim_ros.planning.task import Task
    from needle_sim_ros.scene import Scene

NAME = "plan"
HELP = "find the insertion that hits a target"
DESCRIPTION = """Find the insertion whose tip reaches a target where the tissue has moved it to,
and show it beside the plain aim. The depth always varies; --vary says what else may. Exit
status 1 when the target cannot be reached within the limits: the nearest miss is shown."""
EXAMPLES = (
    "plan gao2016 --target 3",
    "plan gao2016 --target 0.004,0,-0.05 --vary entry,inclination --output planned.yaml",
    "plan layered_inclusion --target 0.02,0,-0.06 --keep-out inclusion --clearance 1e-3",
    "plan bevel_gelatin_22g --target 0.003,0.002,-0.07 --vary roll,schedule --no-verify",
    "plan gao2016 --target 3 --uncertainty identified.json --samples 200 --study study.jsonl",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("scene", metavar="SCENE", help="a YAML file, or a scene of this package")
    parser.add_argument(
        "--target",
        required=True,
        metavar="ID_or_x,y,z",
        help="a marker's number, from 1, or a place in the undeformed tissue, m;"
        " write --target=-0.01,0,-0.05 if it begins with a minus",
    )
    parser.add_argument(
        "--vary",
        default="entry",
        metavar="NAMES",
        help="of entry, inclination, roll, schedule (a second turn), offset (of the base);"
        " default: entry",
    )
    parser.add_argument("--tolerance", type=float, metavar="M", help="default: 1e-4 (3D: 5e-4)")
    limits = parser.add_argument_group("limits")
    limits.add_argument("--max-force", type=float, metavar="N", default=math.inf)
    limits.add_argument("--max-deflection", type=float, metavar="M", default=math.inf)
    limits.add_argument(
        "--keep-out",
        action="append",
        default=[],
        metavar="REGION",
        help="a region of the scene by name, or as YAML; may be given several times",
    )
    limits.add_argument("--clearance", type=float, metavar="M", default=0.0)
    parser.add_argument("--output", metavar="FILE", type=Path, help="write the planned scene, YAML")
    parser.add_argument("--plot", metavar="FILE", type=Path, help="draw plain aim and plan")
    parser.add_argument("--no-verify", action="store_true", help="no run of the full model")
    _configure_study(parser)
    add_set(parser)
    add_json(parser)


def _configure_study(parser: argparse.ArgumentParser) -> None:
    study = parser.add_argument_group("uncertainty")
    study.add_argument(
        "--uncertainty", metavar="FILE", type=Path, help="parameters with standard errors, JSON"
    )
    study.add_argument("--samples", type=int, default=200, metavar="N", help="default: 200")
    study.add_argument("--radius", type=float, default=1e-3, metavar="M", help="default: 1e-3")
    study.add_argument("--study", metavar="FILE", type=Path, help="keep samples here, and resume")
    study.add_argument("--workers", type=int, metavar="N", help="default: one a core")
    study.add_argument("--dask", metavar="ADDRESS", help="of a Dask scheduler")


def execute(args: argparse.Namespace) -> int:
    """Plan; print and write what was found."""
    for path in (args.json, args.output, args.study):
        check_writable(path)
    check_picture(args.plot)
    scene = load_scene(args.scene, args.overrides)
    task = _task(args, scene)
    _check_study(args, scene)

    from needle_sim_ros.planning.planner import Planner
    from needle_sim_ros.planning.verify import protocol_scene

    with progress(1, f"preparing {scene.name}", unit="part") as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        planner = Planner.towards(scene, task, advance)
    began = time.perf_counter()
    with progress(0, "planning", unit="rollout") as bar:
        plan = planner.plan(task, bar.update)
    seconds = time.perf_counter() - began
    found = None if args.no_verify else _verified(planner, task, plan)
    verified = None
    reachable = plan.reachable
    if found is not None:
        plan, verified, reachable = found.plan, found.verified, found.reachable
    planned = protocol_scene(scene, plan.insertion, task.target)
    figures: dict[str, Any] = {
        "miss_m": plan.outcome.miss if verified is None else verified.miss,
        "peak_force_n": plan.outcome.peak_force if verified is None else verified.peak_force,
        "plain_aim_miss_m": plan.plain.miss,
        "verified_miss_m": None if verified is None else verified.miss,
        "planned_miss_m": plan.outcome.miss,
        "deflection_m": plan.outcome.deflection if verified is None else verified.deflection,
        "clearance_m": _clearance(scene, plan, task),
        "rollouts": plan.rollouts,
        "corrections": None if found is None else found.corrections,
        "planning_s": seconds,
    }
    _print(scene, plan, task, reachable, figures)
    result = {
        "scene": scene.name,
        "target": list(task.target),
        "reachable": reachable,
        "figures_of": "planning model" if verified is None else "full model",
        "figures": figures,
        "insertion": _insertion(plan),
        "base": planned.to_dict()["base"],
        "protocol": planned.to_dict()["protocol"],
    }
    if args.output is not None:
        args.output.write_text(planned.to_yaml(), encoding="utf-8")
        print(f"scene: {args.output}")
    if args.plot is not None:
        from needle_sim_ros.view.files import save_figure
        from needle_sim_ros.view.plan import plan_figure

        save_figure(plan_figure(scene, plan, task.target, task.limits.keep_out), args.plot)
        print(f"plot: {args.plot}")
    if args.uncertainty is not None:
        result["uncertainty"] = _study(args, planner.simulator.scene, plan, task)
    write_json(args.json, result)
    return 0 if reachable else 1


def _task(args: argparse.Namespace, scene: Scene) -> Task:
    from needle_sim_ros.planning.keep_out import find_region
    from needle_sim_ros.planning.task import TOLERANCE, Limits, Task, check, read_target

    regions = tuple(find_region(text, scene) for text in args.keep_out)
    task = Task(
        target=read_target(args.target, scene),
        vary=tuple(dict.fromkeys(name.strip() for name in args.vary.split(","))),
        limits=Limits(args.max_force, args.max_deflection, args.clearance, regions),
        tolerance=TOLERANCE[scene.dimension] if args.tolerance is None else args.tolerance,
    )
    check(task, scene)
    return task


def _check_study(args: argparse.Namespace, scene: Scene) -> None:
    """Refuse, before long work, an uncertainty that cannot be studied."""
    if args.uncertainty is None:
        if args.study is not None:
            raise NeedleSimError("--study: needs --uncertainty FILE")
        return
    from needle_sim_ros.planning.study import check_version
    from needle_sim_ros.planning.uncertainty import Uncertainty

    Uncertainty.load(args.uncertainty, scene)
    if args.samples < 1:
        raise NeedleSimError(f"--samples {args.samples}: must be at least 1")
    if not args.radius > 0:
        raise NeedleSimError(f"--radius {args.radius:g}: must be > 0")
    if args.study is not None:
        check_version(args.study)


def _verified(planner: Planner, task: Task, plan: Plan) -> VerifiedPlan:
    """Run the plan in the full model, and plan again where it misses there."""
    from needle_sim_ros.planning.corrected import plan_verified

    with progress(1, "running the plan in the full model") as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        return plan_verified(planner, task, plan, progress=advance)


def _clearance(scene: Scene, plan: Plan, task: Task) -> float | None:
    from needle_sim_ros.planning.keep_out import clearance

    free = clearance(plan.outcome.track, task.limits.keep_out, scene.needle.radius)
    return free if math.isfinite(free) else None


def _insertion(plan: Plan) -> dict[str, Any]:
    insertion = plan.insertion
    return {
        "entry_m": list(insertion.entry),
        "inclination_rad": list(insertion.inclination),
        "roll_rad": insertion.roll,
        "second_turn_rad": insertion.turn,
        "second_turn_at_m": insertion.turn_at,
        "offset_m": list(insertion.offset),
        "offset_at_m": insertion.reference,
        "depth_m": insertion.travel,
    }


def _print(scene: Scene, plan: Plan, task: Task, reachable: bool, figures: dict[str, Any]) -> None:
    def mm(value: float | None) -> str:
        return "-" if value is None else f"{1e3 * value:.3f} mm"

    insertion = plan.insertion
    degrees = [f"{math.degrees(angle):.2f}" for angle in insertion.inclination]
    rows = [
        ("target", ", ".join(f"{1e3 * x:g}" for x in task.target) + " mm"),
        ("moves to", ", ".join(f"{1e3 * x:.2f}" for x in plan.outcome.target + plan.bias) + " mm"),
        ("entry", ", ".join(f"{1e3 * x:.3f}" for x in insertion.entry) + " mm"),
        ("inclination", ", ".join(degrees) + " deg"),
        ("depth", mm(insertion.travel)),
        ("miss of the plain aim", mm(figures["plain_aim_miss_m"])),
        ("miss in the planning model", mm(figures["planned_miss_m"])),
        ("miss in the full model", mm(figures["verified_miss_m"])),
        ("peak force", f"{figures['peak_force_n']:.3f} N"),
        ("largest deflection", mm(figures["deflection_m"])),
        ("rollouts", f"{figures['rollouts']}, found in {figures['planning_s']:.2f} s"),
    ]
    if figures["corrections"]:
        rows.append(("corrections by the full model", str(figures["corrections"])))
    if scene.dimension == 3:
        turn = f"{math.degrees(insertion.roll):.1f} deg"
        if insertion.turn:
            turn += f", {math.degrees(insertion.turn):.1f} deg more at {mm(insertion.turn_at)}"
        rows.insert(4, ("roll", turn))
    if any(insertion.offset):
        offset = ", ".join(f"{1e3 * x:.3f}" for x in insertion.offset)
        rows.insert(
            4, ("sideways motion of the base", f"{offset} mm over {mm(insertion.reference)}")
        )
    print(table(rows, title=scene.name, align="<<"))
    if not reachable:
        why = (
            f", and a limit is exceeded by {100 * plan.violations:.2g} %" if plan.violations else ""
        )
        why = f": {plan.outcome.stopped}" if plan.outcome.stopped else why
        print(f"  not reachable: the nearest miss is {mm(figures['miss_m'])}{why}")


def _study(args: argparse.Namespace, scene: Scene, plan: Plan, task: Task) -> dict[str, Any]:
    """Roll the plan out under uncertain parameters; print and return the figures."""
    from needle_sim_ros.parallel import executor
    from needle_sim_ros.planning.study import Study, run_study
    from needle_sim_ros.planning.uncertainty import Uncertainty

    uncertainty = Uncertainty.load(args.uncertainty, scene)
    # a corrected plan aims beside the target in the planning model, by its known bias
    place = [float(x) for x in plan.aimed_at(task.target)]
    study = Study(scene, plan.insertion, tuple(place), uncertainty)
    with (
        executor(args.workers, args.dask) as pool,
        progress(args.samples, "samples", unit="sample") as bar,
    ):
        spread = run_study(
            study, args.samples, pool, args.study, lambda done: bar.update(done - bar.n)
        )
    figures = spread.figures(args.radius)
    rows = [(name, "-" if v is None else f"{v:.4g}") for name, v in figures.items()]
    print(table(rows, title="under uncertainty", align="<>"))
    return {**figures, "misses_m": spread.misses.tolist()}
