# SPDX-License-Identifier: Apache-2.0
"""Which nodes the planned path will touch, with room for what steers the needle aside."""

from __future__ import annotations

import math

import numpy as np

from needle_sim_ros.geometry import Vector, rotation_matrix
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.mesh import Index, planned_path, spacings, steering
from needle_sim_ros.tissue.model import TissueModel

# unknowns of a plan in 3D whose inverse is made in some ten seconds, and how far from the
# path, m, the base may move or turn the needle then
_AFFORDED = 7_200
_ROOM = (1.5e-3, 3.0e-3, 5.0e-3)


def plane_points(points: Vector, dimension: int) -> Vector:
    """Put world points (n, 3) into the coordinates of the mesh (n, d)."""
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    return points if dimension == 3 else points[:, [0, 2]]


def touched(scene: Scene, model: TissueModel) -> Index:
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
        return _planned(scene, model, center, depths)
    drift = 2 * math.tan(tip.deviation_angle) * math.cos(tip.roll) * depths
    start, end = np.minimum(drift, 0.0) - radius, np.maximum(drift, 0.0) + radius
    across = start[:, None] + np.linspace(0.0, 1.0, 13) * (end - start)[:, None]
    quaternion = np.array(scene.base.orientation)
    turned = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    aside = plane_points(turned[:, 0], scene.dimension)[0]
    places = (center[:, None, :] + across[:, :, None] * aside).reshape(-1, len(direction))
    return _nodes_at(model, places)


def _planned(scene: Scene, model: TissueModel, center: Vector, depths: Vector) -> Index:
    """Return the nodes of the path in 3D, and of as much about it as can be afforded.

    A base that is turned before the insertion steers to the other side, one that spins while it
    drives keeps to the middle, one that is moved aside leaves it by as much: the widest of such
    plans is taken whose block of the inverse is made in seconds.
    """
    own = 1.5 * math.tan(scene.needle.tip.deviation_angle) * depths
    from_file = scene.tissue.mesh.file is not None
    least = scene.solver.track_spacing / 4 if from_file else 0.0
    nodes = _about(scene, model, center, own, least)
    for room in (0.0, *_ROOM):
        wider = [_about(scene, model, center, -own, least)]
        if room:
            wider.append(_about(scene, model, center, 0.0 * own, room))
        more = np.unique(np.concatenate([nodes, *wider]))
        if model.dimension * len(more) > _AFFORDED:
            break
        nodes = more
    return nodes


def _about(scene: Scene, model: TissueModel, center: Vector, drift: Vector, room: float) -> Index:
    """Return the nodes that a disc touches that goes down the path and drifts to a side.

    Parameters
    ----------
    scene : Scene
    model : TissueModel
    center : ndarray, shape (n, 3)
        Places on the path, m.
    drift : ndarray, shape (n,)
        How far the needle may have gone at each to the side to which it steers, m.
    room : float
        How much wider than the needle the disc is, m.
    """
    places = center[:, None, :] + _swept(scene, drift, room)
    return _nodes_at(model, places.reshape(-1, 3))


def _swept(scene: Scene, drift: Vector, room: float) -> Vector:
    """Return what a disc sweeps that moves by drifts (n,) to the steered side, (n, k, 3)."""
    quaternion = np.array(scene.base.orientation)
    turned = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    step = 0.5 * spacings(scene)[0]
    moves = np.linspace(0.0, 1.0, 2 + int(np.abs(drift).max() / step)) if drift.any() else [0.0]
    # cells of any arrangement begin and end anywhere beside the path
    from_file = scene.tissue.mesh.file is not None
    radius = scene.needle.radius * (1 - 1e-9) + room
    rings = 9 if from_file else max(3, 2 + int(radius / step))
    angles = np.linspace(0.0, 2 * np.pi, 32 if from_file else 4 * rings, endpoint=False)
    ring = np.cos(angles)[:, None] * turned[:, 0] + np.sin(angles)[:, None] * turned[:, 1]
    disc = (radius * np.linspace(0.0, 1.0, rings)[:, None, None] * ring).reshape(-1, 3)
    moved = (drift[:, None] * np.asarray(moves))[:, :, None] * steering(scene)
    return np.asarray((moved[:, :, None, :] + disc).reshape(len(drift), -1, 3))


def _nodes_at(model: TissueModel, places: Vector) -> Index:
    """Return the nodes that displacements at places (n, d) are read from."""
    nodes, values, inside = model.shape_functions(places)
    return np.unique(nodes[inside][np.abs(values[inside]) > 1e-12])
