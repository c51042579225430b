# SPDX-License-Identifier: Apache-2.0
"""How far a 3D scene is from a converged reference, over its protocol.

A reference in 3D that is as fine as one in 2D would take more memory than there is. The finest
run that two cores can wait for stands for it, with smaller cells everywhere, and how far a run
one level coarser is from that says how converged it is.
"""

from __future__ import annotations

from collections.abc import Callable

from needle_sim_ros.benchmark.accuracy import Measured, Runs, row_of
from needle_sim_ros.benchmark.result import BenchmarkResult
from needle_sim_ros.benchmark.trajectory import errors, hurried
from needle_sim_ros.benchmark.variants import (
    Changes,
    Variant,
    admissible,
    method_changes,
    refined,
)
from needle_sim_ros.errors import SceneError
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.mesh import spacings

Progress = Callable[[int, int], None]

_HASTE, _QUICK_HASTE = 4.0, 16.0
_NEXT, _REFERENCE = "reference, one level coarser", "reference"
# growth of the cells away from the needle: where markers are, these decide; and of a track that
# is finer than the cells
_FINE_GROWTH, _FINE_GROWTH_THIN = 1.2, 1.3
# spacings of the reference where the track is finer than the cells, as parts of the scene's
_THIN_QUICK, _THIN = 0.75, 0.65


def accuracy_3d(
    scene: Scene, quick: bool = False, progress: Progress | None = None
) -> BenchmarkResult:
    """Compare a 3D scene with a reference that is finer in everything.

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
        Figures ``<scene>.quasi_static.max_error`` against the reference, where what jumps may
        do so a tick early or late: a needle that breaks the surface snaps in, and when it does
        hangs on the dent; ``.at_equal_times`` without that; ``.reference_error``, how far the
        run one level coarser than the reference is from it.

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
    singles: dict[str, Changes] = {
        "mesh across x 0.7": refined(scene, 0.7, 1.0, 1.0, growth),
        "mesh along x 1/2": refined(scene, 1.0, 0.5, 1.0, growth),
        "track x 1/2": refined(scene, 1.0, 1.0, 0.5, growth),
        "growth 1.2": {"tissue.mesh.growth": _FINE_GROWTH},
    }
    allowed = {name: each for name, each in singles.items() if admissible(scene, each)}
    chosen = levels(scene, quick) | ({} if quick else allowed)
    runs = Runs(scene, None, progress, len(chosen))
    made = {name: runs.measure({**own, **changes}) for name, changes in chosen.items()}
    section = (
        "runs, errors as fractions of the largest magnitude in the reference; "
        f"the protocol {haste:g} times as fast"
    )
    result = BenchmarkResult("accuracy", scene.name)
    reference = made[_REFERENCE].trajectory
    for name, run in made.items():
        variant = Variant("quasi_static", name, {**own, **chosen[name]})
        result.table.append(row_of(section, variant, run, errors(run.trajectory, reference)))
    result.figures = _figures(scene.name, made)
    return result


def levels(scene: Scene, quick: bool) -> dict[str, Changes]:
    """Return the settings of the runs that are refined together, by name, the reference last.

    Parameters
    ----------
    scene : Scene
    quick : bool
        As of :func:`accuracy_3d`.
    """
    growth = scene.tissue.mesh.growth
    _, along, _ = spacings(scene)
    if scene.solver.track_spacing < along:
        # the cells matter less than the track, and the responses between the many nodes about
        # a path that bends take memory with the sixth power of their size
        least = _THIN_QUICK if quick else _THIN
        between, finest = (0.5 * (1 + least),) * 3, (least,) * 3
        fine_growth = min(growth, _FINE_GROWTH_THIN)
    else:
        between, finest = (0.7, 0.5, 0.5), (0.55, 0.5, 0.5)
        fine_growth = min(growth, _FINE_GROWTH)
    return {
        "one level coarser": refined(scene, 1.5, 1.5, 1.5, growth),
        "default": {},
        _NEXT: refined(scene, *between, fine_growth),
        _REFERENCE: refined(scene, *finest, fine_growth),
    }


def _figures(name: str, made: dict[str, Measured]) -> dict[str, float | None]:
    reference = made[_REFERENCE].trajectory
    found = errors(made["default"].trajectory, reference)
    prefix = f"{name}.quasi_static"
    return {
        f"{prefix}.max_error": max(found.late.values()),
        **{f"{prefix}.{quantity}": value for quantity, value in found.late.items()},
        f"{prefix}.at_equal_times": found.worst,
        f"{prefix}.reference_error": max(errors(made[_NEXT].trajectory, reference).late.values()),
    }
