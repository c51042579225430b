# SPDX-License-Identifier: Apache-2.0
"""From a scene to a tissue that answers: assemble, factorise once, prepare the path."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from needle_sim_ros.geometry import Vector, rotation_matrix
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.compliance import NodalCompliance
from needle_sim_ros.tissue.direct import DirectCompliance
from needle_sim_ros.tissue.dynamics import Dynamics, QuasiStatic
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.mesh import Index, planned_path, spacings, steering
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.newmark import FullNewmark, NewmarkRule, effective_matrix
from needle_sim_ros.tissue.ordering import unknowns_order
from needle_sim_ros.tissue.reduced import ReducedNewmark

Progress = Callable[[int, int], None]

# Unknowns of a uniform grid from which nested dissection is faster, with less fill: at
# 44 000 it factorises in half the time of minimum degree, at 178 000 in a quarter.
_LARGE_GRID = 20_000
# Unknowns of the path whose responses are kept, a square of numbers: 1.2 GB. A uniform grid
# is as fine everywhere as on the path: there it is the numbers solved for, half a minute.
_MOST_KEPT = 12_000
_MOST_WORK = 5e7


@dataclass(frozen=True)
class BuiltTissue:
    """The tissue of a scene, ready for ticks."""

    model: TissueModel
    factor: Factor
    dynamics: Dynamics


def plane_points(points: Vector, dimension: int) -> Vector:
    """Put world points (n, 3) into the coordinates of the mesh (n, d)."""
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    return points if dimension == 3 else points[:, [0, 2]]


def build_tissue(scene: Scene, progress: Progress | None = None) -> BuiltTissue:
    """Assemble and factorise the tissue of a scene and prepare its planned path.

    Parameters
    ----------
    scene : Scene
    progress : callable, optional
        Called with (done, total) while the path is prepared.
    """
    model = TissueModel(scene)
    rule = NewmarkRule.of(scene)
    full = scene.solver.dynamics == "newmark" and scene.solver.modes == 0
    matrix = effective_matrix(model, rule) if full else model.stiffness
    factor = Factor(matrix, _order(model))
    markers = plane_points(np.array(scene.markers).reshape(-1, 3), scene.dimension)
    empty = sp.csr_array((0, len(model.free)))
    readers = model.sampling(markers) if len(markers) else empty
    path = planned_path(scene)
    _, along, _ = spacings(scene)
    tile = (2.2 * scene.needle.radius,) * (scene.dimension - 1) + (4 * along,)
    center = plane_points(path.entry, scene.dimension)[0]
    touched = _touched(scene, model)
    kind = NodalCompliance if _worth_keeping(model, touched) else DirectCompliance
    compliance = kind(model, factor, readers, tile, center)
    dynamics: Dynamics
    if full:
        dynamics = FullNewmark(model, factor, compliance, rule)
    elif scene.solver.dynamics == "newmark":
        dynamics = ReducedNewmark(model, factor, compliance, rule, scene.solver.modes)
    else:
        dynamics = QuasiStatic(model, factor, compliance)
    compliance.prepare(touched, progress)
    return BuiltTissue(model, factor, dynamics)


def _order(model: TissueModel) -> Index | None:
    """Return an elimination order where minimum degree fills: large uniform grids, and 3D."""
    if model.scene.dimension == 3:
        return model.elimination_order
    if not model.scene.tissue.mesh.uniform or len(model.free) < _LARGE_GRID:
        return None
    return unknowns_order(model.stiffness, model.coordinates[:, model.free // model.dimension])


def _worth_keeping(model: TissueModel, touched: Index) -> bool:
    """Whether to prepare the responses of the nodes of the path before the first tick."""
    count = model.dimension * len(touched)
    work = count * len(model.free) if model.scene.tissue.mesh.uniform else 0
    return count <= _MOST_KEPT and work <= _MOST_WORK


def _touched(scene: Scene, model: TissueModel) -> Index:
    """Return the nodes along the planned path: ticks on it shall wait for no solve."""
    path = planned_path(scene)
    if path.depth <= 0:
        return np.empty(0, dtype=np.intp)
    spacing = scene.solver.track_spacing
    depths = np.arange(0.0, path.depth + 2 * spacing, spacing / 2)
    direction = plane_points(path.direction, scene.dimension)[0]
    center = plane_points(path.entry, scene.dimension)[0] + depths[:, None] * direction
    radius = scene.needle.radius * (1 - 1e-9)
    # to the side to which the bevel steers, with room for what the tissue adds
    tip = scene.needle.tip
    if scene.dimension == 3:
        # less room than in 2D: solves are dear, and the worker foresees what leaves the plan
        places = center[:, None, :] + _swept(scene, 1.5 * math.tan(tip.deviation_angle) * depths)
        return _nodes_at(model, places.reshape(-1, 3))
    drift = 2 * math.tan(tip.deviation_angle) * math.cos(tip.roll) * depths
    start, end = np.minimum(drift, 0.0) - radius, np.maximum(drift, 0.0) + radius
    across = start[:, None] + np.linspace(0.0, 1.0, 13) * (end - start)[:, None]
    quaternion = np.array(scene.base.orientation)
    turned = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    aside = plane_points(turned[:, 0], scene.dimension)[0]
    places = (center[:, None, :] + across[:, :, None] * aside).reshape(-1, len(direction))
    return _nodes_at(model, places)


def _swept(scene: Scene, drift: Vector) -> Vector:
    """Return what a disc sweeps that moves by drifts (n,) to the steered side, (n, k, 3)."""
    quaternion = np.array(scene.base.orientation)
    turned = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    step = 0.5 * spacings(scene)[0]
    moves = np.linspace(0.0, 1.0, 2 + int(np.abs(drift).max() / step))
    angles = np.arange(8) * (np.pi / 4)
    ring = np.cos(angles)[:, None] * turned[:, 0] + np.sin(angles)[:, None] * turned[:, 1]
    radii = scene.needle.radius * (1 - 1e-9) * np.array([0.0, 0.5, 1.0])
    disc = (radii[:, None, None] * ring).reshape(-1, 3)
    moved = (drift[:, None] * moves)[:, :, None] * steering(scene)
    return np.asarray((moved[:, :, None, :] + disc).reshape(len(drift), -1, 3))


def _nodes_at(model: TissueModel, places: Vector) -> Index:
    """Return the nodes that displacements at places (n, d) are read from."""
    nodes, values, inside = model.shape_functions(places)
    return np.unique(nodes[inside][np.abs(values[inside]) > 1e-12])
