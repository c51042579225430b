# SPDX-License-Identifier: Apache-2.0
"""The tick of a 3D scene with over 100 000 unknowns beside that of the same scene, coarser.

Both have the same track and the same mesh about the path; what differs is how finely the rest
of the tissue is divided, so the ratio shows what a tick takes of the number of unknowns alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from needle_sim_ros.benchmark.result import Row
from needle_sim_ros.benchmark.trajectory import Recorded, hurried
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

SCENE = "layered_inclusion_3d"
_HASTE = 8.0
_TRACK: dict[str, Any] = {"tissue.mesh.spacing_along": 4e-3, "solver.track_spacing": 4e-3}
SIZES: dict[str, dict[str, Any]] = {
    "small": _TRACK,
    "over 100 000 unknowns": _TRACK | {"tissue.mesh.growth": 1.2, "tissue.mesh.largest": 2.4e-3},
}


def scaling_3d(
    peak: Callable[[], float],
    advance: Callable[[], None],
    sizes: dict[str, dict[str, Any]] | None = None,
) -> tuple[list[Row], dict[str, float | None]]:
    """Run both sizes side by side.

    Parameters
    ----------
    peak : callable
        Returns the process's high-water mark, GiB.
    advance : callable
        Called after each tick.
    sizes : dict, optional
        Other keys of the scene by name of the size; the small one first, two in all.

    Returns
    -------
    rows, figures
    """
    made = {}
    for name, changes in (sizes or SIZES).items():
        scene = hurried(Scene.load(SCENE, changes), _HASTE)
        began = time.perf_counter()
        simulator = Simulator(scene)
        made[name] = (Recorded(simulator), simulator, time.perf_counter() - began, peak())
    runs = [run for run, *_ in made.values()]
    step = scene.solver.time_step
    for number, command in enumerate(protocol_commands(scene.protocol, step)):
        for run in runs if number % 2 else runs[::-1]:
            run.tick(command, step)
        advance()
    small = runs[0].median_inserted
    rows: list[Row] = []
    for name, (run, simulator, setup, memory) in made.items():
        times = 1e3 * np.array(run.tick_times)
        rows.append(
            {
                "section": f"{SCENE}, the same track, the rest of the tissue finer",
                "size": name,
                "nodes": simulator.nodes,
                "unknowns": simulator.unknowns,
                "library": str(simulator.preparation.library),
                "setup_s": setup,
                "tick_ms": 1e3 * run.median_inserted,
                "over_small": run.median_inserted / small,
                "p99_ms": float(np.percentile(times, 99)),
                "max_ms": float(times.max()),
                "peak_gib": memory,
            }
        )
    large = rows[-1]
    figures: dict[str, float | None] = {
        "tick_3d_100k_over_small": large["over_small"],
        "tick_3d_100k_unknowns": float(large["unknowns"]),
        "tick_3d_100k_setup_s": large["setup_s"],
        "tick_3d_small_setup_s": rows[0]["setup_s"],
        "tick_3d_100k_peak_gib": large["peak_gib"],
        "tick_3d_small_peak_gib": rows[0]["peak_gib"],
    }
    return rows, figures


def ticks() -> int:
    """Return how many ticks the runs take."""
    scene = hurried(Scene.load(SCENE), _HASTE)
    return len(protocol_commands(scene.protocol, scene.solver.time_step))
