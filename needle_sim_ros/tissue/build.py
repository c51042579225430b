# SPDX-License-Identifier: Apache-2.0
"""From a scene to a tissue that answers: assemble, factorise once, prepare the path."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Region, Scene
from needle_sim_ros.tissue.beside import Beside
from needle_sim_ros.tissue.cache import Cache, key_of
from needle_sim_ros.tissue.compliance import NodalCompliance
from needle_sim_ros.tissue.direct import DirectCompliance
from needle_sim_ros.tissue.dynamics import Dynamics, QuasiStatic
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.libraries import Choice, choose
from needle_sim_ros.tissue.mesh import Index, planned_path, spacings
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.near_field import disc_radius
from needle_sim_ros.tissue.newmark import FullNewmark, NewmarkRule, effective_matrix
from needle_sim_ros.tissue.ordering import unknowns_order
from needle_sim_ros.tissue.plan import plane_points as plane_points
from needle_sim_ros.tissue.plan import prepared
from needle_sim_ros.tissue.reduced import ReducedNewmark, lowest_modes
from needle_sim_ros.tissue.tiles import Tiles

Progress = Callable[[int, int], None]

# Unknowns of a uniform grid from which nested dissection is faster, with less fill: at
# 44 000 it factorises in half the time of minimum degree, at 178 000 in a quarter.
_LARGE_GRID = 20_000
# Unknowns of the path whose responses are kept, a square of numbers: 1.2 GB. A uniform grid
# is as fine everywhere as on the path: there it is the numbers solved for, half a minute.
_MOST_KEPT = 12_000
_MOST_WORK = 5e7
# s; what was prepared sooner is not worth a file
_WORTH_A_FILE = 2.0


@dataclass(frozen=True)
class Preparation:
    """How a tissue was prepared.

    Attributes
    ----------
    library : Choice
        What factorises.
    unknowns : int
        Displacements that are not fixed.
    cached : bool
        Whether the responses came from the disk; nothing is factorised then until the
        needle leaves them.
    seconds : float
        What it took, the mesh included.
    """

    library: Choice
    unknowns: int
    cached: bool
    seconds: float

    def __str__(self) -> str:
        how = "read from the cache" if self.cached else self.library.reason
        return f"{self.unknowns} unknowns, {self.library}: {how}; {self.seconds:.1f} s"


@dataclass(frozen=True)
class BuiltTissue:
    """The tissue of a scene, ready for ticks."""

    model: TissueModel
    factor: Factor
    dynamics: Dynamics
    preparation: Preparation
    beside: Beside


def fixed_parts(scene: Scene) -> dict[str, object]:
    """Return what of a scene the factorised tissue and its readers hang on, by key."""
    tissue = scene.tissue
    stiff = [(r, r.youngs_modulus, r.poisson_ratio, r.density) for r in tissue.regions]
    regions = tuple(
        Region(r.name, r.shape, r.center, r.size, r.axis, *material)
        for r, *material in stiff
        if any(value is not None for value in material)
    )
    return {
        "dimension": scene.dimension,
        "tissue": replace(tissue, regions=regions),
        "needle.radius": scene.needle.radius,
        "markers": scene.markers,
        "solver": scene.solver,
    }


def build_tissue(scene: Scene, progress: Progress | None = None) -> BuiltTissue:
    """Assemble and factorise the tissue of a scene and prepare its planned path.

    Parameters
    ----------
    scene : Scene
    progress : callable, optional
        Called with (done, total) while the path is prepared.
    """
    began = time.perf_counter()
    library = choose(scene.solver.factorization, scene.dimension)
    model = TissueModel(scene)
    rule = NewmarkRule.of(scene)
    full = scene.solver.dynamics == "newmark" and scene.solver.modes == 0
    matrix = effective_matrix(model, rule) if full else model.stiffness
    factor = Factor(matrix, _order(model), library)
    markers = plane_points(np.array(scene.markers).reshape(-1, 3), scene.dimension)
    empty = sp.csr_array((0, len(model.free)))
    readers = model.sampling(markers) if len(markers) else empty
    _, along, _ = spacings(scene)
    tile = (2.2 * disc_radius(scene),) * (scene.dimension - 1) + (4 * along,)
    center = plane_points(planned_path(scene).entry, scene.dimension)[0]
    tiles = Tiles(model, tile, center)
    planned, groups = prepared(scene, model, tiles)
    kind = NodalCompliance if _worth_keeping(model, planned) else DirectCompliance
    compliance = kind(model, factor, readers, tiles)
    modes, cached = _prepared(model, factor, compliance, planned, began, progress)
    kept = not isinstance(compliance, DirectCompliance)
    about = Beside(compliance, groups if kept else [])
    dynamics: Dynamics
    if full:
        dynamics = FullNewmark(model, factor, compliance, rule)
    elif modes is not None:
        dynamics = ReducedNewmark(model, factor, compliance, rule, modes)
    else:
        dynamics = QuasiStatic(model, factor, compliance)
    spent = time.perf_counter() - began
    preparation = Preparation(library, len(model.free), cached, spent)
    return BuiltTissue(model, factor, dynamics, preparation, about)


def _prepared(
    model: TissueModel,
    factor: Factor,
    compliance: NodalCompliance,
    planned: Index,
    began: float,
    progress: Progress | None,
) -> tuple[tuple[Vector, Vector] | None, bool]:
    """Prepare the path and the modes, from the cache if they are there."""
    solver = model.scene.solver
    count = solver.modes if solver.dynamics == "newmark" else 0
    cache = Cache.of_environment()
    direct = isinstance(compliance, DirectCompliance)
    key = "" if direct else key_of(model, factor, compliance, planned, count)
    found = None if direct else cache.load(key)
    if found is not None and compliance.adopt(planned, found["blocks"], found["read"]):
        modes = (found["eigenvalues"], found["shapes"]) if count else None
        return modes, True
    compliance.prepare(planned, progress)
    factor.factorise()
    modes = lowest_modes(model, factor, count) if count else None
    if not direct and time.perf_counter() - began > _WORTH_A_FILE:
        blocks, read = compliance.prepared()
        values, shapes = modes or (np.zeros(0), np.zeros((0, 0)))
        cache.store(key, {"blocks": blocks, "read": read, "eigenvalues": values, "shapes": shapes})
    return modes, False


def _order(model: TissueModel) -> Index | None:
    """Return an elimination order where minimum degree fills: large uniform grids, and 3D."""
    if model.scene.dimension == 3:
        return model.elimination_order
    if not model.scene.tissue.mesh.uniform or len(model.free) < _LARGE_GRID:
        return None
    return unknowns_order(model.stiffness, model.coordinates[:, model.free // model.dimension])


def _worth_keeping(model: TissueModel, planned: Index) -> bool:
    """Whether to prepare the responses of the nodes of the path before the first tick."""
    count = model.dimension * len(planned)
    work = count * len(model.free) if model.scene.tissue.mesh.uniform else 0
    return count <= _MOST_KEPT and work <= _MOST_WORK
