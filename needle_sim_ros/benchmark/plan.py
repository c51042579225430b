# SPDX-License-Identifier: Apache-2.0
"""How often and how quickly a plan hits: random reachable targets, beside the plain aim."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.planning.corrected import plan_verified
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.planner import Plan, Planner
from needle_sim_ros.planning.task import TOLERANCE, Task
from needle_sim_ros.planning.verify import protocol_scene, verify
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

Progress = Callable[[int, int], None]

_TARGETS, _QUICK_TARGETS = 100, 10
# in 2D only so many are run in the full model; in 3D all
_VERIFIED, _QUICK_VERIFIED = 5, 2
# seconds within which a plan counts, by dimension
_TIME = {2: 2.0, 3: 30.0}
_SEED = 6


def plan(scene: Scene, quick: bool = False, progress: Progress | None = None) -> BenchmarkResult:
    """Plan for random targets that can be reached.

    In 2D they are spread over the middle of the tissue, and the entry may vary. In 3D they
    are where insertions with random rolls, second turns and depths end in the scene's own
    model, in the undeformed tissue; roll and second turn may vary, and every plan is verified
    and corrected in the scene's own model.

    Parameters
    ----------
    scene : Scene
    quick : bool
        A tenth of the targets.
    progress : callable, optional
        Called with (done, total) targets.

    Returns
    -------
    BenchmarkResult
        ``hit_fraction`` counts misses within the tolerance (in 3D: in the full model) found
        within ``time_limit_s``, the preparation of the planning tissue not included, in 3D
        the runs of the full model included. Times are processor time of this process: of
        one core, whatever else the machine does.
    """
    count = _QUICK_TARGETS if quick else _TARGETS
    verified = _QUICK_VERIFIED if quick else _VERIFIED
    generator = np.random.default_rng(_SEED)
    shared = Planner.all_round(scene, Insertion.of(scene)) if scene.dimension == 3 else None
    rows: list[Row] = []
    for number in range(count):
        if shared is None:
            task = _planar_task(scene, generator)
            began = time.process_time()
            planner = Planner.towards(scene, task)
            setup = time.process_time() - began
        else:
            planner, task, setup = shared, _spatial_task(scene, generator), 0.0
        began = time.process_time()
        found, full, reachable = planner.plan(task), None, None
        searched = time.process_time() - began
        if shared is not None:
            checked = plan_verified(planner, task, found)
            found, full, reachable = checked.plan, checked.verified.miss, checked.reachable
        seconds = time.process_time() - began
        if shared is None and number < verified:
            full = verify(protocol_scene(scene, found.insertion, task.target)).miss
        row = _row(task, found, setup, seconds, full)
        row["search_s"] = searched
        if reachable is not None:
            row["reachable"] = reachable
        rows.append(row)
        if progress is not None:
            progress(number + 1, count)
    return BenchmarkResult("plan", scene.name, _figures(scene, rows), rows)


def _planar_task(scene: Scene, generator: np.random.Generator) -> Task:
    width, depth = scene.tissue.size[0], min(scene.tissue.size[-1], scene.needle.length)
    x = generator.uniform(-width / 6, width / 6)
    z = generator.uniform(-0.75 * depth, -0.25 * depth)
    return Task((float(x), 0.0, float(z)), ("entry",), tolerance=TOLERANCE[2])


def _spatial_task(scene: Scene, generator: np.random.Generator) -> Task:
    straight = Insertion.of(scene)
    while True:
        travel = float(generator.uniform(0.5, 0.95)) * straight.travel
        insertion = replace(
            straight,
            roll=float(generator.uniform(-math.pi, math.pi)),
            turn=float(generator.uniform(-math.pi, math.pi)),
            turn_at=float(generator.uniform(0.2, 0.8)) * travel,
            travel=travel,
        )
        made, step = insertion.scene_of(scene), scene.solver.time_step
        simulator = Simulator(made)
        try:
            for command in protocol_commands(made.protocol, step):
                seen = simulator.step(command, step)
        except NeedleSimError:
            continue
        x, y, z = seen.contact_points[-1].tolist()
        return Task((x, y, z), ("roll", "schedule"), tolerance=TOLERANCE[3])


def _row(task: Task, found: Plan, setup: float, seconds: float, full: float | None) -> Row:
    x, y, z = (1e3 * value for value in task.target)
    return {
        "x_mm": x,
        "y_mm": y,
        "z_mm": z,
        "setup_s": setup,
        "plan_s": seconds,
        "rollouts": found.rollouts,
        "miss_mm": 1e3 * found.outcome.miss,
        "plain_aim_miss_mm": 1e3 * found.plain.miss,
        "full_model_miss_mm": None if full is None else 1e3 * full,
        "reachable": found.reachable,
    }


def _figures(scene: Scene, rows: list[Row]) -> dict[str, float | None]:
    limit = _TIME[scene.dimension]
    hits = [row["reachable"] and row["plan_s"] <= limit for row in rows]
    full = [row["full_model_miss_mm"] for row in rows if row["full_model_miss_mm"] is not None]
    return {
        "hit_fraction": float(np.mean(hits)),
        "tolerance_m": TOLERANCE[scene.dimension],
        "time_limit_s": limit,
        "targets": len(rows),
        "miss_median_m": 1e-3 * float(np.median([row["miss_mm"] for row in rows])),
        "miss_p95_m": 1e-3 * float(np.quantile([row["miss_mm"] for row in rows], 0.95)),
        "plain_aim_miss_median_m": 1e-3
        * float(np.median([row["plain_aim_miss_mm"] for row in rows])),
        "full_model_miss_median_m": 1e-3 * float(np.median(full)) if full else None,
        "full_model_miss_max_m": 1e-3 * max(full) if full else None,
        "search_median_s": float(np.median([row["search_s"] for row in rows])),
        "plan_median_s": float(np.median([row["plan_s"] for row in rows])),
        "plan_max_s": max(row["plan_s"] for row in rows),
    }
