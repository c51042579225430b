# SPDX-License-Identifier: Apache-2.0
"""How far a 3D scene is from its limit under refinement, over its protocol.

A reference in 3D that is as fine as one in 2D would take more memory than there is. So the
mesh and the track are refined together, level by level; from the two finest ones and the
observed order the limit is extrapolated, and the scene is compared with that.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from needle_sim_ros.benchmark.accuracy import Measured, Runs, row_of
from needle_sim_ros.benchmark.result import BenchmarkResult
from needle_sim_ros.benchmark.trajectory import Trajectory, errors, hurried
from needle_sim_ros.benchmark.variants import Changes, Variant, method_changes, refined
from needle_sim_ros.errors import SceneError
from needle_sim_ros.scene import Scene

Progress = Callable[[int, int], None]

_HASTE, _QUICK_HASTE = 4.0, 16.0
# the observed order counts within these: first where loads are not smooth, second of the
# elements; beyond them two levels are not yet in the range where an order shows
_ORDERS = (1.0, 2.0)


def accuracy_3d(
    scene: Scene, quick: bool = False, progress: Progress | None = None
) -> BenchmarkResult:
    """Compare a 3D scene with its limit under refinement.

    Parameters
    ----------
    scene : Scene
        Three-dimensional, meshed in lines; taken quasi-static.
    quick : bool
        The protocol sixteen times as fast instead of four, and no single refinements.
    progress : callable, optional
        Called with (done, total) runs.

    Returns
    -------
    BenchmarkResult
        Figures ``<scene>.quasi_static.max_error`` against the extrapolated limit, where what
        jumps may do so a tick early or late: a needle that breaks the surface snaps in, and
        when it does hangs on the dent; ``.at_equal_times`` without that. ``.to_reference``
        against the finest run itself, ``.reference_error`` of that run against the limit,
        and ``.order``, as observed.

    Raises
    ------
    SceneError
        When the mesh is from a file: there is nothing to refine it with.
    """
    if scene.tissue.mesh.file is not None:
        raise SceneError(
            "tissue.mesh.file", scene.tissue.mesh.file, "cannot be refined for this benchmark"
        )
    haste = _QUICK_HASTE if quick else _HASTE
    scene = hurried(scene, haste)
    own = method_changes(scene, "quasi_static")
    growth = scene.tissue.mesh.growth
    levels: dict[str, Changes] = {
        "one level coarser": refined(scene, 1.5, 2.0, 2.0, growth),
        "default": {},
        "reference": refined(scene, 0.7, 0.5, 0.5, growth),
    }
    singles: dict[str, Changes] = {
        "mesh across x 0.7": refined(scene, 0.7, 1.0, 1.0, growth),
        "mesh along x 1/2": refined(scene, 1.0, 0.5, 1.0, growth),
        "growth 1.5": {"tissue.mesh.growth": 1.5},
    }
    runs = Runs(scene, None, progress, len(levels) + (0 if quick else len(singles)))
    made = {name: runs.measure({**own, **changes}) for name, changes in levels.items()}
    order = _order(*(run.trajectory for run in made.values()))
    limit = _limit(made["default"].trajectory, made["reference"].trajectory, order)
    if not quick:
        made |= {name: runs.measure({**own, **changes}) for name, changes in singles.items()}
    section = (
        "runs, errors as fractions of the largest magnitude in the limit; "
        f"the protocol {haste:g} times as fast"
    )
    result = BenchmarkResult("accuracy", scene.name)
    for name, run in made.items():
        changes = levels.get(name, singles.get(name, {}))
        variant = Variant("quasi_static", name, {**own, **changes})
        result.table.append(row_of(section, variant, run, errors(run.trajectory, limit)))
    result.figures = _figures(scene.name, made, limit, order)
    return result


def _figures(
    name: str, made: dict[str, Measured], limit: Trajectory, order: float
) -> dict[str, float | None]:
    default, finest = made["default"].trajectory, made["reference"].trajectory
    found = errors(default, limit)
    prefix = f"{name}.quasi_static"
    return {
        f"{prefix}.max_error": max(found.late.values()),
        **{f"{prefix}.{quantity}": value for quantity, value in found.late.items()},
        f"{prefix}.at_equal_times": found.worst,
        f"{prefix}.to_reference": max(errors(default, finest).late.values()),
        f"{prefix}.reference_error": max(errors(finest, limit).late.values()),
        f"{prefix}.order": order,
    }


def _order(coarse: Trajectory, default: Trajectory, fine: Trajectory) -> float:
    """Return the order in the spacing at which the tip's path converges, within bounds."""
    steps = []
    for one, other in ((coarse, default), (default, fine)):
        off = one.values["tip_deflection"] - other.at(one.time).values["tip_deflection"]
        steps.append(float(np.linalg.norm(off)))
    ratio = steps[0] / max(steps[1], 1e-300)
    return min(max(math.log2(max(ratio, 1e-12)), _ORDERS[0]), _ORDERS[1])


def _limit(default: Trajectory, fine: Trajectory, order: float) -> Trajectory:
    """Return the fine run and what halving the spacing again and again would add (Richardson)."""
    here = default.at(fine.time)
    share = 1.0 / (2.0**order - 1.0)
    values = {name: v + share * (v - here.values[name]) for name, v in fine.values.items()}
    return Trajectory(fine.time, values)
