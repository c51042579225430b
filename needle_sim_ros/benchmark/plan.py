# SPDX-License-Identifier: Apache-2.0
"""How often and how quickly a plan hits: random reachable targets, beside the plain aim."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.plain import plain
from needle_sim_ros.planning.corrected import plan_verified
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.planner import Plan, Planner
from needle_sim_ros.planning.task import TOLERANCE, Task
from needle_sim_ros.planning.verify import protocol_scene, verify
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.results_file import ResultsFile
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

Progress = Callable[[int, int], None]

_TARGETS, _QUICK_TARGETS = 100, 10
# in 2D only so many are run in the full model; in 3D all
_VERIFIED, _QUICK_VERIFIED = 5, 2
# seconds within which a plan counts, by dimension
_TIME = {2: 2.0, 3: 30.0}
_SEED = 6


def plan(
    scene: Scene,
    quick: bool = False,
    progress: Progress | None = None,
    targets: int | None = None,
    results: Path | None = None,
) -> BenchmarkResult:
    """Plan for random targets that can be reached.

    In 2D they are spread over the middle of the tissue, and the entry may vary. In 3D they
    are where insertions with random rolls, second turns and depths end in the scene's own
    model, its mesh as fine to all sides, in the undeformed tissue; roll and second turn may
    vary, and every plan is verified and corrected in the scene's own model.

    Parameters
    ----------
    scene : Scene
    quick : bool
        A tenth of the targets.
    progress : callable, optional
        Called with (done, total) targets.
    targets : int, optional
        How many; the first ones are the same whatever the number.
    results : Path, optional
        Every target is written to this file when it is done; those that are in it from
        before are not planned for again.

    Returns
    -------
    BenchmarkResult
        ``hit_fraction`` counts misses within the tolerance (in 3D: in the full model) found
        within ``time_limit_s``, the preparation of the planning tissue not included, in 3D
        the runs of the full model included. Times are processor time of this process: of
        one core, whatever else the machine does.

    Raises
    ------
    NeedleSimError
        When the file holds results of another kind, version or scene.
    """
    count = targets or (_QUICK_TARGETS if quick else _TARGETS)
    verified = _QUICK_VERIFIED if quick else _VERIFIED
    file = None if results is None else _opened(results, scene, verified)
    rows = [] if file is None else file.entries[:count]
    case: _Case | None = None
    for number in range(len(rows), count):
        if progress is not None:
            progress(number, count)
        if case is None:
            case = (_Spatial if scene.dimension == 3 else _Planar)(scene)
        row = case.row(np.random.default_rng([_SEED, number]), number < verified)
        if file is not None:
            file.append(row)
        rows.append(row)
    if progress is not None:
        progress(count, count)
    return BenchmarkResult("plan", scene.name, _figures(scene, rows), rows)


def _opened(path: Path, scene: Scene, verified: int) -> ResultsFile:
    text = json.dumps(plain([scene.to_dict(), verified]), sort_keys=True)
    of = hashlib.sha256(text.encode()).hexdigest()[:16]
    return ResultsFile(path, "plan_benchmark", 1, of, "scene, or with --quick")


class _Case(Protocol):
    """Targets of one dimension."""

    def row(self, generator: np.random.Generator, verified: bool) -> Row:
        """Draw a target, plan for it, and say how that went."""


class _Planar:
    """In the middle of the tissue, each with a mesh about its plain aim."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def row(self, generator: np.random.Generator, verified: bool) -> Row:
        task = _planar_task(self._scene, generator)
        began = time.process_time()
        planner = Planner.towards(self._scene, task)
        setup = time.process_time() - began
        began = time.process_time()
        found = planner.plan(task)
        seconds = time.process_time() - began
        row = _row(task, found, setup, seconds, seconds)
        if verified:
            planned = protocol_scene(self._scene, found.insertion, task.target)
            row["full_model_miss_mm"] = 1e3 * verify(planned).miss
        return row


class _Spatial:
    """Where a bevel gets to; one mesh for all."""

    def __init__(self, scene: Scene) -> None:
        self._planner = Planner.all_round(scene, Insertion.of(scene))
        # as fine as the scene's own mesh, to whatever side a bevel leads
        self._simulator = Simulator(
            scene.with_changes({"tissue.mesh.band": self._planner.reach, "markers": []})
        )

    def row(self, generator: np.random.Generator, verified: bool) -> Row:
        task = _spatial_task(self._simulator, generator)
        began = time.process_time()
        found = self._planner.plan(task)
        searched = time.process_time() - began
        checked = plan_verified(self._planner, task, found)
        seconds = time.process_time() - began
        row = _row(task, checked.plan, 0.0, searched, seconds)
        row["full_model_miss_mm"] = 1e3 * checked.verified.miss
        row["reachable"], row["corrections"] = checked.reachable, checked.corrections
        return row


def _planar_task(scene: Scene, generator: np.random.Generator) -> Task:
    width, depth = scene.tissue.size[0], min(scene.tissue.size[-1], scene.needle.length)
    x = generator.uniform(-width / 6, width / 6)
    z = generator.uniform(-0.75 * depth, -0.25 * depth)
    return Task((float(x), 0.0, float(z)), ("entry",), tolerance=TOLERANCE[2])


def _spatial_task(model: Simulator, generator: np.random.Generator) -> Task:
    scene = model.scene
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
        simulator = model.variant(made)
        try:
            for command in protocol_commands(made.protocol, step):
                seen = simulator.step(command, step)
        except NeedleSimError:
            continue
        x, y, z = seen.contact_points[-1].tolist()
        return Task((x, y, z), ("roll", "schedule"), tolerance=TOLERANCE[3])


def _row(task: Task, found: Plan, setup: float, searched: float, seconds: float) -> Row:
    x, y, z = (1e3 * value for value in task.target)
    return {
        "x_mm": x,
        "y_mm": y,
        "z_mm": z,
        "setup_s": setup,
        "search_s": searched,
        "plan_s": seconds,
        "rollouts": found.rollouts,
        "miss_mm": 1e3 * found.outcome.miss,
        "plain_aim_miss_mm": 1e3 * found.plain.miss,
        "full_model_miss_mm": None,
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
