# SPDX-License-Identifier: Apache-2.0
"""How often and how quickly a plan hits: random reachable targets, beside the plain aim."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.planner import Plan, Planner
from needle_sim_ros.planning.rollout import roll_out
from needle_sim_ros.planning.task import TOLERANCE, Task
from needle_sim_ros.planning.verify import protocol_scene, verify
from needle_sim_ros.scene import Scene

Progress = Callable[[int, int], None]

_TARGETS, _QUICK_TARGETS = 100, 10
_VERIFIED, _QUICK_VERIFIED = 5, 2
# seconds within which a plan counts, by dimension
_TIME = {2: 2.0, 3: 30.0}
_SEED = 6


def plan(scene: Scene, quick: bool = False, progress: Progress | None = None) -> BenchmarkResult:
    """Plan for random targets that can be reached.

    In 2D they are spread over the middle of the tissue, and the entry may vary. In 3D they
    are where insertions with random rolls, second turns and depths end, in the undeformed
    tissue; roll and second turn may vary.

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
        ``hit_fraction`` counts misses within the tolerance found within ``time_limit_s``, the
        preparation of the tissue not included. Times are processor time of this process: of
        one core, whatever else the machine does.
    """
    count = _QUICK_TARGETS if quick else _TARGETS
    verified = _QUICK_VERIFIED if quick else _VERIFIED
    generator = np.random.default_rng(_SEED)
    shared = Planner.all_round(scene, Insertion.of(scene)) if scene.dimension == 3 else None
    rows: list[Row] = []
    for number in range(count):
        began = time.process_time()
        if shared is None:
            task = _planar_task(scene, generator)
            planner = Planner.towards(scene, task)
        else:
            planner, task = shared, _spatial_task(scene, shared, generator)
        setup, began = time.process_time() - began, time.process_time()
        found = planner.plan(task)
        seconds = time.process_time() - began
        full = None
        if number < verified and scene.dimension == 2:
            full = verify(protocol_scene(scene, found.insertion, task.target)).miss
        rows.append(_row(task, found, setup, seconds, full))
        if progress is not None:
            progress(number + 1, count)
    return BenchmarkResult("plan", scene.name, _figures(scene, rows), rows)


def _planar_task(scene: Scene, generator: np.random.Generator) -> Task:
    width, depth = scene.tissue.size[0], min(scene.tissue.size[-1], scene.needle.length)
    x = generator.uniform(-width / 6, width / 6)
    z = generator.uniform(-0.75 * depth, -0.25 * depth)
    return Task((float(x), 0.0, float(z)), ("entry",), tolerance=TOLERANCE[2])


def _spatial_task(scene: Scene, planner: Planner, generator: np.random.Generator) -> Task:
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
        outcome = roll_out(planner.simulator, insertion)
        if not outcome.stopped:
            x, y, z = outcome.track[-1].tolist()
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
        "full_model_miss_max_m": 1e-3 * max(full) if full else None,
        "plan_median_s": float(np.median([row["plan_s"] for row in rows])),
        "plan_max_s": max(row["plan_s"] for row in rows),
    }
