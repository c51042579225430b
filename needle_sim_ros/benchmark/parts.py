# SPDX-License-Identifier: Apache-2.0
"""What each part of a scene costs a tick, and that what nobody reads costs nothing.

The same tick, with the needle all the way in, is repeated from a snapshot for all variants
of a scene in turn; then each member of its observation is read for the first time.
"""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.benchmark.trajectory import driven_in, hurried
from needle_sim_ros.benchmark.variants import method_changes
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator, Snapshot

MEMBERS = (
    "tip_deflection",
    "tip_position",
    "base_force",
    "base_torque",
    "friction_force",
    "tip_force",
    "contact_points",
    "contact_forces",
    "needle_points",
    "marker_displacements",
)
MANY = 200
_HASTE = 8.0
_REST = BaseCommand()
_SECTION = "what a tick costs with the needle all the way in, and reading its members once"


@dataclass
class _Variant:
    name: str
    simulator: Simulator
    start: Snapshot


def costs(scene: Scene, repeats: int = 200) -> BenchmarkResult:
    """Time the parts of a scene.

    Parameters
    ----------
    scene : Scene
        With a protocol that goes in.
    repeats : int
        Ticks of each variant.

    Returns
    -------
    BenchmarkResult
        ``unread_markers_over_none`` is the tick with many markers that nobody reads over
        the tick with none.
    """
    variants = _variants(scene)
    ticks: dict[str, list[float]] = defaultdict(list)
    reads: dict[tuple[str, str], list[float]] = defaultdict(list)
    dt = scene.solver.time_step
    for number in range(repeats):
        first = number % len(variants)
        for variant in variants[first:] + variants[:first]:
            simulator = variant.simulator
            simulator.restore(variant.start)
            began = time.perf_counter()
            seen = simulator.step(_REST, dt)
            ticks[variant.name].append(time.perf_counter() - began)
            for member in MEMBERS:
                began = time.perf_counter()
                getattr(seen, member)
                reads[variant.name, member].append(time.perf_counter() - began)
    tick = {name: 1e6 * float(np.median(times)) for name, times in ticks.items()}
    plain = tick[variants[0].name]
    rows: list[Row] = [_row(f"tick, {name}", value, plain) for name, value in tick.items()]
    for member in MEMBERS[:-1]:
        spent = 1e6 * float(np.median(reads[variants[0].name, member]))
        rows.append(_row(f"reading {member}", spent, plain))
    for variant in variants[:3]:
        spent = 1e6 * float(np.median(reads[variant.name, MEMBERS[-1]]))
        rows.append(_row(f"reading {MEMBERS[-1]}, {variant.name}", spent, plain))
    rows.append(_row("the displacement of any point (a solve)", _solve_time(variants[0]), plain))
    figures: dict[str, float | None] = {
        "unread_markers_over_none": tick[variants[2].name] / tick[variants[1].name]
    }
    return BenchmarkResult("parts", scene.name, figures, rows)


def _row(part: str, microseconds: float, plain: float) -> Row:
    return {
        "section": _SECTION,
        "part": part,
        "microseconds": microseconds,
        "share_of_tick": microseconds / plain,
    }


def _variants(scene: Scene) -> list[_Variant]:
    """Return the scene quasi-static, without and with many markers, and its dynamics."""
    still = method_changes(scene, "quasi_static")
    depth = scene.tissue.size[-1]
    heights = np.linspace(-0.9 * depth, -0.1 * depth, MANY)
    many = [[0.3 * scene.tissue.size[0], 0.0, z] for z in heights.tolist()]
    plan = {
        "quasi-static": still,
        "quasi-static, no markers": still | {"markers": []},
        f"quasi-static, {MANY} markers": still | {"markers": many},
        "reduced Newmark": method_changes(scene, "reduced"),
        "Newmark on every unknown": method_changes(scene, "newmark"),
    }
    made = []
    for name, changes in plan.items():
        changed = scene.with_changes(changes)
        simulator = Simulator(changed)
        driven_in(simulator, hurried(changed, _HASTE))
        made.append(_Variant(name, simulator, simulator.snapshot()))
    return made


def _solve_time(variant: _Variant, repeats: int = 10) -> float:
    simulator, point = variant.simulator, [[0.01, 0.0, -0.01]]
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        simulator.tissue_displacement(point)
        times.append(time.perf_counter() - began)
    return 1e6 * float(np.median(times))
