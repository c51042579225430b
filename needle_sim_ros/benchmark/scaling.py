# SPDX-License-Identifier: Apache-2.0
"""Tick, set-up and memory against the number of unknowns, and the tick against the track.

The paper's section 4 ends with a grid of 1061 x 1061 nodes; its measured mesh has about
1061 nodes. Both are run here, of bilinear elements and quasi-static, with what lies
between, each side by side with the 1061-node one, so that ratios of ticks mean something.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from needle_sim_ros.benchmark import scaling_3d
from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.benchmark.trajectory import Recorded, hurried
from needle_sim_ros.errors import SceneError
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

Progress = Callable[[int, int], None]

LITERAL = 1061
# Nodes along each side; 33 x 33 is the paper's 1061, 1061 x 1061 its literal grid.
_SIDES = (23, 33, 81, 150, 223, 530, LITERAL)
_QUICK_SIDES = (23, 33, 81, 150, 223)
_SMALL = 33
_HASTE = 8.0
_GROUP = 10  # track points in one row of the second table


@dataclass
class _Grid:
    """A grid's simulation and what it cost to make."""

    side: int
    run: Recorded
    setup: float
    unknowns: int


def scaling(
    scene: Scene,
    quick: bool = False,
    progress: Progress | None = None,
    sides: Sequence[int] | None = None,
    sizes_3d: dict[str, dict[str, Any]] | None = None,
) -> BenchmarkResult:
    """Measure a scene on uniform grids of growing size.

    Parameters
    ----------
    scene : Scene
        Two-dimensional; its protocol is moved eight times as fast. What grows in 3D is the
        mesh of a scene of its own.
    quick : bool
        Stop at 100 000 unknowns: the literal grid's figures are None.
    progress : callable, optional
        Called with (done, total) ticks and set-ups, all together.
    sides : sequence of int, optional
        Nodes along each side of the grids instead of the usual ones; ascending.
    sizes_3d : dict, optional
        See :func:`~needle_sim_ros.benchmark.scaling_3d.scaling_3d`.

    Returns
    -------
    BenchmarkResult
        Memory is the process's high-water mark after each grid, in GiB; with another
        benchmark before it in the same process it is not the grid's own.

    Raises
    ------
    SceneError
        When the scene is not two-dimensional.
    """
    if scene.dimension != 2:
        raise SceneError("dimension", scene.dimension, "must be 2 for this benchmark")
    sides = sides or (_QUICK_SIDES if quick else _SIDES)
    scene = hurried(scene.with_changes({"solver.dynamics": "quasi_static"}), _HASTE)
    commands = protocol_commands(scene.protocol, scene.solver.time_step)
    steps = _Steps(progress, (len(sides) + 1) * len(commands) + scaling_3d.ticks())
    small = _made(scene, _SMALL)
    result = BenchmarkResult("scaling", scene.name)
    names = ("literal_grid_over_1061_nodes", "literal_grid_setup_s", "literal_grid_peak_gib")
    result.figures = dict.fromkeys(names)
    for side in sides:
        grid = _made(scene, side)
        row = _measured(scene, grid, small, steps)
        result.table.append(row)
        if side == LITERAL:
            values = row["over_1061_nodes"], row["setup_s"], row["peak_gib"]
            result.figures |= dict(zip(names, values, strict=True))
        del grid
    result.figures["largest_grid_unknowns"] = result.table[-1]["unknowns"]
    result.figures["largest_grid_over_1061_nodes"] = result.table[-1]["over_1061_nodes"]
    result.table += _against_track(scene, steps)
    rows, figures = scaling_3d.scaling_3d(_peak_gib, steps.one, sizes_3d)
    result.table += rows
    result.figures |= figures
    return result


class _Steps:
    """Counts ticks for the progress bar."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def one(self) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)


def _made(scene: Scene, side: int) -> _Grid:
    """Set up a uniform grid; a track finer than its nodes would over-constrain it."""
    width, depth = scene.tissue.size
    across, along = width / (side - 1), depth / (side - 1)
    changes = {
        "tissue.mesh.uniform": True,
        "tissue.mesh.element": "quad1",
        "tissue.mesh.spacing_across": across,
        "tissue.mesh.spacing_along": along,
        "solver.track_spacing": max(along, depth / (_SMALL - 1)),
    }
    began = time.perf_counter()
    simulator = Simulator(scene.with_changes(changes))
    setup = time.perf_counter() - began
    return _Grid(side, Recorded(simulator), setup, simulator.unknowns)


def _measured(scene: Scene, grid: _Grid, small: _Grid, steps: _Steps) -> Row:
    """Move the grid through the protocol beside the small one, ticks in turn."""
    dt = scene.solver.time_step
    assert isinstance(small.run.simulator, Simulator)
    small.run.simulator.reset()
    beside = Recorded(small.run.simulator)
    for number, command in enumerate(protocol_commands(scene.protocol, dt)):
        turn = (grid.run, beside) if number % 2 else (beside, grid.run)
        for run in turn:
            run.tick(command, dt)
        steps.one()
    times = 1e3 * np.array(grid.run.tick_times)
    return {
        "section": "uniform grids of bilinear elements, quasi-static",
        "grid": f"{grid.side} x {grid.side}",
        "nodes": grid.side**2,
        "unknowns": grid.unknowns,
        "setup_s": grid.setup,
        "tick_ms": 1e3 * grid.run.median_inserted,
        "over_1061_nodes": grid.run.median_inserted / beside.median_inserted,
        "p99_ms": float(np.percentile(times, 99)),
        "max_ms": float(times.max()),
        "peak_gib": _peak_gib(),
    }


def _peak_gib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # from KiB


def _against_track(scene: Scene, steps: _Steps) -> list[Row]:
    """Return the tick against the number of inserted track points, on the scene's own mesh."""
    dt = scene.solver.time_step
    simulator = Simulator(scene)
    times: dict[int, list[float]] = {}
    for command in protocol_commands(scene.protocol, dt):
        began = time.perf_counter()
        seen = simulator.step(command, dt)
        spent = time.perf_counter() - began
        points = int(seen.insertion_depth / scene.solver.track_spacing)
        times.setdefault(points // _GROUP, []).append(1e3 * spent)
        steps.one()
    return [
        {
            "section": "tick against inserted track points, the scene's own mesh, quasi-static",
            "track_points": f"{_GROUP * group} to {_GROUP * group + _GROUP - 1}",
            "ticks": len(spent),
            "tick_ms": float(np.median(spent)),
            "p90_ms": float(np.percentile(spent, 90)),
        }
        for group, spent in sorted(times.items())
    ]
